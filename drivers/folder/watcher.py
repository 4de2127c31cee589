"""A watched folder: each new file is told once, when it is whole; what was there before never counts.

Made for folders that other programs write into, also over a network: nothing but listings and times is relied
on, no notices of the system. A folder that vanishes and comes back is taken up where it was left: files that
came meanwhile count.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from mountnav.clock import Clock, SystemClock
from mountnav.files import open_buffered

_log = logging.getLogger(__name__)
_State = tuple[int, int]
BLOCK = 1 << 20
NAMES_KEPT = 200_000
"""So many names of files that are gone are kept, the latest; those that are there all are. A name takes some
300 bytes: doubled, 60 MB more."""


@dataclass(frozen=True, slots=True)
class NewFile:
    """A file that is whole.

    Attributes
    ----------
    path : Path
    digest : str
        SHA-256 of its content, hexadecimal.
    size_bytes : int
    written_utc : datetime
        When it was last written, by the folder's own clock.
    """

    path: Path
    digest: str
    size_bytes: int
    written_utc: datetime


class FolderWatcher:
    """Watches one folder.

    Parameters
    ----------
    folder : Path
        Needn't be there yet.
    pattern : str
        Which files count, as a glob; ``**/`` for those in folders below.
    poll_s : float
        Between two looks; a file is whole when two looks see the same size and time.
    clock : Clock, optional
    tell : callable, optional
        Told in words when the folder vanishes, and when it is back.
    """

    def __init__(
        self,
        folder: Path,
        pattern: str = "*.fit*",
        poll_s: float = 1.0,
        *,
        clock: Clock | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self._folder = folder
        self._pattern = pattern
        self._poll_s = poll_s
        self._clock = clock or SystemClock()
        self._tell = tell or _log.warning
        self._told: dict[Path, _State] = {}
        self._seen: dict[Path, _State] = {}
        self._old: bool = True
        self.problem = ""

    async def begin(self) -> None:
        """Take note of what is there already. Without it, the first look does."""
        await self._look()

    async def files(self) -> AsyncIterator[NewFile]:
        """Yield new files as they become whole, the oldest first, until closed."""
        while True:
            for path, state in await self._look():
                new = await asyncio.to_thread(self._read, path, state)
                if new is not None:
                    self._told[path] = state
                    yield new
            await self._clock.sleep(self._poll_s)

    async def _look(self) -> list[tuple[Path, _State]]:
        """Look once; files that are whole by now and weren't told, oldest first."""
        try:
            now = await asyncio.to_thread(self._listed)
        except OSError as trouble:
            if not self.problem:
                self.problem = f"{self._folder} can't be read: {trouble.strerror or trouble}"
                self._tell(self.problem)
            return []
        if self.problem:
            self._tell(f"{self._folder} is back")
            self.problem = ""
        if self._old:
            # what is there at the first look is old; of what was away, nothing is
            self._old, self._told, self._seen = False, dict(now), now
            return []
        whole = [
            (path, state)
            for path, state in now.items()
            if self._seen.get(path) == state and self._told.get(path) != state
        ]
        self._seen = now
        # kept though they are gone: an unmounted folder is an empty one, and all of it comes back
        if len(self._told) - len(now) > NAMES_KEPT:
            gone = [path for path in self._told if path not in now]
            for path in gone[:-NAMES_KEPT]:
                del self._told[path]
        return sorted(whole, key=lambda one: (one[1][1], one[0]))

    def _listed(self) -> dict[Path, _State]:
        """Size and time of each file of the pattern; runs in a thread."""
        # a glob over a folder that is gone finds nothing and doesn't complain
        next(iter(self._folder.iterdir()), None)
        found: dict[Path, _State] = {}
        for path in self._folder.glob(self._pattern):
            try:
                facts = path.stat()
                plain = path.is_file()
            except FileNotFoundError:
                # renamed or removed between listing and looking
                continue
            if facts.st_size and plain:
                found[path] = (facts.st_size, facts.st_mtime_ns)
        return found

    def _read(self, path: Path, state: _State) -> NewFile | None:
        """Read a file through; None if it changes while it is read, or is gone: it comes again then."""
        digest = hashlib.sha256()
        try:
            with open_buffered(path) as file:
                while block := file.read(BLOCK):
                    digest.update(block)
            facts = path.stat()
        except OSError as trouble:
            _log.info("%s: %s", path, trouble)
            return None
        if (facts.st_size, facts.st_mtime_ns) != state:
            return None
        written = datetime.fromtimestamp(state[1] / 1e9, UTC)
        return NewFile(path, digest.hexdigest(), state[0], written)
