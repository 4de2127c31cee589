"""A watched folder: each new file is reported once, when it is complete; files of before never count.

Made for folders that other programs write into, also over a network: it relies on listings and times only,
not on notifications of the system. When a folder vanishes and comes back, files that came meanwhile count.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from mountnav.clock import Clock, SystemClock
from mountnav.files import open_buffered

_log = logging.getLogger(__name__)
_State = tuple[int, int]
"""Size in bytes and time in ns: what changes when a file is written again."""
BLOCK = 1 << 20
"""Bytes that are read at once for the digest: 1 MB. Doubled or halved, it takes as long."""
NAMES_KEPT = 200_000
"""How many names of files that are gone are kept, the latest ones, besides those that are there. A name takes
some 300 bytes: doubled, 60 MB more; halved, files of a share that was unmounted longer count as new."""


def matching_files(folder: Path, pattern: str) -> dict[Path, os.stat_result]:
    """The files of a pattern that are not empty, with their status; a folder that is gone has none."""
    found: dict[Path, os.stat_result] = {}
    for path in folder.glob(pattern):
        try:
            facts = path.stat()
            plain = path.is_file()
        except FileNotFoundError:
            # renamed or removed since it was listed
            continue
        if facts.st_size and plain:
            found[path] = facts
    return found


@dataclass(frozen=True, slots=True)
class NewFile:
    """A file that is complete.

    Attributes
    ----------
    digest : str
        SHA-256 of its content, hexadecimal.
    written_utc : datetime
        When it was last written, by the clock of the file system.
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
        Needn't exist yet.
    pattern : str
        Which files count, as a glob; ``**/`` for files in folders below.
    poll_s : float
        Between two listings; a file is complete when two listings show the same size and time.
    tell : callable, optional
        Called with a message when the folder vanishes, and when it is back.

    Attributes
    ----------
    problem : str
        Why the folder can't be read; empty while it can.
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
        self._reported: dict[Path, _State] = {}
        self._seen: dict[Path, _State] = {}
        self._first = True
        self.problem = ""

    async def begin(self) -> None:
        """List the folder now: what is there counts as old. Without it, the first listing does that."""
        await self._complete()

    async def files(self) -> AsyncIterator[NewFile]:
        """Yield new files when they are complete, oldest first, until closed."""
        while True:
            for path, state in await self._complete():
                new = await asyncio.to_thread(self._read, path, state)
                if new is not None:
                    self._reported[path] = state
                    yield new
            await self._clock.sleep(self._poll_s)

    async def _complete(self) -> list[tuple[Path, _State]]:
        """List once; return the files that are complete now and were not reported yet, oldest first."""
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
        if self._first:
            # what the first listing shows is old; files of a folder that was away are not
            self._first, self._reported, self._seen = False, dict(now), now
            return []
        whole = [
            (path, state)
            for path, state in now.items()
            if self._seen.get(path) == state and self._reported.get(path) != state
        ]
        self._seen = now
        # names of files that are gone are kept: an unmounted share looks empty, and its files come back
        if len(self._reported) - len(now) > NAMES_KEPT:
            gone = [path for path in self._reported if path not in now]
            for path in gone[:-NAMES_KEPT]:
                del self._reported[path]
        return sorted(whole, key=lambda entry: (entry[1][1], entry[0]))

    def _listed(self) -> dict[Path, _State]:
        """Size and time of each file of the pattern; runs in a thread."""
        # a glob over a folder that is gone finds nothing and doesn't complain
        next(iter(self._folder.iterdir()), None)
        files = matching_files(self._folder, self._pattern)
        return {path: (facts.st_size, facts.st_mtime_ns) for path, facts in files.items()}

    def _read(self, path: Path, state: _State) -> NewFile | None:
        """Read a file for its digest; None if it changed meanwhile or is gone: it is reported later then."""
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
