"""A camera that watches a folder: the next file that is whole after the question is the frame.

Another program takes the pictures. A file counts when it came, or was written anew, after `expose` was
called, its size and time have stayed the same for one look, and it can be read as a frame. What was there
before never counts.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

from mountnav.errors import BadFrame, Busy, Cancelled, DeviceMissing, DeviceSilent
from mountnav.frames import Frame
from mountnav.reading import read_frame

_State = tuple[int, int, int]


class FolderCamera:
    """A `mountnav.navigation.devices.Camera` over a folder.

    Parameters
    ----------
    folder : Path
        Where the files appear.
    pattern : str
        Which files count, as a glob.
    timeout_s : float
        How long after the end of the exposure a file is awaited.
    poll_s : float
        Between two looks into the folder; a file is whole when two looks see the same.
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
            How long the other program exposes; only lengthens the wait, the file's header tells the truth.

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
            If no file came in time.
        BadFrame
            If the only new files can't be read, or the header of one tells no time of exposure.
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
        old = await asyncio.to_thread(self._files)
        seen = old
        unreadable: BadFrame | None = None
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
            seen = now
            for path in sorted(fresh, key=lambda path: now[path][1]):
                if (path, now[path]) in tried:
                    continue
                tried.add((path, now[path]))
                try:
                    return self._timed(await asyncio.to_thread(read_frame, path, raw=True))
                except BadFrame as cause:
                    # maybe still being written: it is tried again when it has changed
                    unreadable = cause
        if unreadable is not None:
            raise unreadable
        raise DeviceSilent(
            f"no new file {self._pattern} came within {exposure_s + self._timeout_s:.0f} s",
            device=self._name,
            advice="check that the capture program runs and saves into this folder",
        )

    def _timed(self, frame: Frame) -> Frame:
        if frame.mid_exposure_utc is None:
            raise BadFrame(
                f"{frame.source} tells no time of exposure",
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
            found: dict[Path, _State] = {}
            for path in self._folder.glob(self._pattern):
                try:
                    facts = path.stat()
                except FileNotFoundError:
                    # renamed or removed between listing and looking
                    continue
                if facts.st_size and path.is_file():
                    found[path] = (facts.st_size, facts.st_mtime_ns, facts.st_ino)
        except OSError as cause:
            raise DeviceMissing(f"the folder can't be read: {cause}", device=self._name) from cause
        return found
