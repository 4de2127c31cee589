"""A camera that watches a folder: the next file that is complete after `expose` was called is the frame.

Another program takes the images. A file counts if it appeared or was rewritten after `expose` was called, its
size and time are the same in two listings, and it can be read as a frame. Files of before never count.
"""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta
from pathlib import Path

from drivers.folder.watcher import matching_files
from mountnav.clock import utc_now
from mountnav.errors import BadFrame, Busy, Cancelled, DeviceError, DeviceMissing, DeviceSilent
from mountnav.frames import Frame
from mountnav.reading import read_frame

_State = tuple[int, int, int]
"""Size in bytes, time in ns, inode: what changes when a file is written again."""
_MOST_CAUSES = 3
"""How many reasons a message gives, the first ones: a folder may hold a thousand files that are no frames.
Doubled, the message fills a screen."""
_WITH_CAUSES = (
    "check that the capture program exposes after it is asked, with the right clock, and saves whole files "
    "of this pattern into this folder"
)
_OLD_S = 2.0
"""A frame whose exposure ended more than this (s) before it was asked for is an older one, or the camera's
clock is off. Doubled, one from before a short slew isn't mentioned."""


def _age(frame: Frame, asked_utc: datetime) -> str:
    """Words for a frame that was exposed before it was asked for; empty if it was not."""
    assert frame.mid_exposure_utc is not None
    ended = frame.mid_exposure_utc + timedelta(seconds=0.5 * (frame.exposure_s or 0.0))
    early_s = (asked_utc - ended).total_seconds()
    if early_s <= _OLD_S:
        return ""
    return (
        f"the last one, {frame.source}, was exposed {early_s:.0f} s before it was asked for, by its DATE-OBS"
    )


def _listed(causes: list[str]) -> str:
    more = f"; and {len(causes) - _MOST_CAUSES} more" if len(causes) > _MOST_CAUSES else ""
    return "; ".join(causes[:_MOST_CAUSES]) + more


def _among_the_old(
    old: dict[Path, _State], last: dict[Path, _State] | None, asked_utc: datetime
) -> list[str]:
    """Words for files of before the exposure was asked for: never taken, and often what the user meant."""
    causes = [
        f"{path.name} came before the exposure was asked for"
        for path in sorted(old)
        if last is not None and last.get(path) != old[path]
    ]
    if not causes and old:
        newest = max(old, key=lambda path: old[path][1])
        age_s = asked_utc.timestamp() - old[newest][1] / 1e9
        causes.append(f"the newest there, {newest.name}, was written {age_s:.0f} s before it was asked for")
    return causes


class FolderCamera:
    """A `mountnav.devices.Camera` over a folder.

    Parameters
    ----------
    folder : Path
        Where the files appear.
    pattern : str
        Which files count, as a glob.
    timeout_s : float
        How long after the end of the exposure a file is awaited.
    poll_s : float
        Between two listings of the folder; a file is complete when two listings show the same.
    name : str, optional
        For messages; the folder by default.
    """

    def __init__(
        self,
        folder: Path,
        pattern: str = "*.fit*",
        timeout_s: float = 60.0,
        *,
        poll_s: float = 0.25,
        name: str | None = None,
    ) -> None:
        self._folder = folder
        self._pattern = pattern
        self._timeout_s = timeout_s
        self._poll_s = poll_s
        self._name = name or str(folder)
        self._abort: asyncio.Event | None = None
        self._last: dict[Path, _State] | None = None
        """The last listing."""
        self._doubt = ""
        """What spoke against the last frame that was returned: the caller may have refused it for that."""

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._name

    async def open(self) -> None:
        """Check that the folder is there.

        Raises
        ------
        DeviceMissing
            If it is not, or can't be read.
        """
        await asyncio.to_thread(self._files)

    async def close(self) -> None:
        """Release: a running `expose` ends as after `abort`."""
        await self.abort()

    async def abort(self) -> None:
        """End a running `expose`; it raises `Cancelled`."""
        if self._abort is not None:
            self._abort.set()

    async def expose(self, exposure_s: float) -> Frame:
        """Wait for the next whole file and read it.

        Parameters
        ----------
        exposure_s : float
            How long the other program exposes; it only lengthens the wait, the header has the true value.

        Returns
        -------
        Frame
            With `mid_exposure_utc` from its header.

        Raises
        ------
        Busy
            If another `expose` waits.
        Cancelled
            After `abort`.
        DeviceSilent
            If no file came in time; the message says which files came and why they don't count.
        BadFrame
            If the only new files can't be read, or have no time of exposure in their headers.
        DeviceMissing
            If the folder is gone.
        """
        if self._abort is not None:
            raise Busy("an exposure is awaited", device=self._name, advice="abort it first")
        self._abort = abort = asyncio.Event()
        try:
            return await self._next(exposure_s, abort)
        finally:
            self._abort = None

    async def _next(self, exposure_s: float, abort: asyncio.Event) -> Frame:
        loop = asyncio.get_running_loop()
        until = loop.time() + exposure_s + self._timeout_s
        asked_utc = utc_now()
        strange = await asyncio.to_thread(self._others)
        old = await asyncio.to_thread(self._files)
        seen, last = old, self._last
        unusable: dict[Path, BadFrame] = {}
        tried: set[tuple[Path, _State]] = set()
        while loop.time() < until:
            try:
                async with asyncio.timeout(self._poll_s):
                    await abort.wait()
            except TimeoutError:
                pass
            else:
                raise Cancelled("the exposure was aborted", device=self._name)
            now = await asyncio.to_thread(self._files)
            fresh = [
                path for path, state in now.items() if old.get(path) != state and seen.get(path) == state
            ]
            seen = self._last = now
            for path in sorted(fresh, key=lambda path: now[path][1]):
                if (path, now[path]) in tried:
                    continue
                tried.add((path, now[path]))
                try:
                    frame = self._timed(await asyncio.to_thread(read_frame, path, raw=True))
                except BadFrame as cause:
                    # perhaps it is still being written: it is tried again when it has changed
                    unusable[path] = cause
                else:
                    self._doubt = _age(frame, asked_utc)
                    return frame
        causes = [f"{path.name} came and can't be used: {cause.what}" for path, cause in unusable.items()]
        causes += [
            f"{path.name} came and was still being written"
            for path in sorted(set(seen) - set(unusable))
            if old.get(path) != seen[path]
        ]
        causes += await asyncio.to_thread(self._ignored, strange)
        causes = causes or _among_the_old(old, last, asked_utc)
        if self._doubt:
            causes.append(self._doubt)
        raise self._none_came(exposure_s + self._timeout_s, causes, list(unusable.values()))

    def _none_came(
        self, waited_s: float, causes: list[str], unusable: list[BadFrame]
    ) -> DeviceError | BadFrame:
        """The error for a wait without a frame, with the causes that are known."""
        waited = f"no new file {self._pattern} came within {waited_s:.0f} s"
        if unusable:
            return BadFrame(
                f"no usable {waited.removeprefix('no new ')}: {_listed(causes)}",
                device=self._name,
                advice=unusable[-1].advice or "check what the capture program writes",
            )
        return DeviceSilent(
            f"{waited}: {_listed(causes)}" if causes else waited,
            device=self._name,
            advice=_WITH_CAUSES
            if causes
            else "check that the capture program runs and saves into this folder",
        )

    def _others(self) -> set[Path]:
        """All files in the folder, whatever their names; runs in a thread."""
        try:
            return set(self._folder.iterdir())
        except OSError:
            return set()

    def _ignored(self, before: set[Path]) -> list[str]:
        """Words for files that came and don't count; runs in a thread."""
        found = []
        matching = set(self._folder.glob(self._pattern))
        for path in sorted(self._others() - before):
            try:
                if not path.is_file():
                    continue
                if path not in matching:
                    found.append(f"{path.name} came, which is none of {self._pattern}")
                elif not path.stat().st_size:
                    found.append(f"{path.name} came and is empty")
            except OSError:
                # removed meanwhile
                continue
        return found

    def _timed(self, frame: Frame) -> Frame:
        if frame.mid_exposure_utc is None:
            raise BadFrame(
                f"{frame.source} gives no time of exposure (DATE-OBS)",
                device=self._name,
                advice="have the capture program write DATE-OBS and EXPTIME",
            )
        return frame

    def _files(self) -> dict[Path, _State]:
        """Size, time and inode of each file of the pattern; runs in a thread, as folders may be remote."""
        try:
            if not self._folder.is_dir():
                raise DeviceMissing(
                    "the folder is not there", device=self._name, advice=f"make or mount {self._folder}"
                )
            files = matching_files(self._folder, self._pattern)
        except OSError as cause:
            raise DeviceMissing(f"the folder can't be read: {cause}", device=self._name) from cause
        return {path: (facts.st_size, facts.st_mtime_ns, facts.st_ino) for path, facts in files.items()}
