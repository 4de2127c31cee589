"""A fake on a pseudo-terminal, as if on a serial port that may be pulled and come back elsewhere."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path

from drivers.fakes.bench.thread import Bench, Fake


class FakeOnPty(Bench):
    """A fake on a pseudo-terminal.

    Parameters
    ----------
    fake : Fake
    link : Path, optional
        A symlink that points at the pseudo-terminal, for a stable name: as in ``/dev/serial/by-id``, it goes
        and comes with the device, and the device returns under another name.
    baud : int, optional
        Bytes take their time.
    """

    def __init__(self, fake: Fake, link: Path | None = None, *, baud: int | None = None) -> None:
        super().__init__(fake, baud=baud)
        self._link = link
        self._master = self._slave = -1
        self._device = ""

    @property
    def address(self) -> str:
        """The device path to open: the stable name if there is one."""
        return self._device if self._link is None else str(self._link)

    @property
    def device(self) -> str:
        """The present name of the pseudo-terminal itself."""
        return self._device

    def _open(self) -> None:
        # the slave is kept open here, so that the master lives on between two clients
        pairs = [os.openpty()]
        while os.ttyname(pairs[-1][1]) == self._device:
            # a device comes back under another name
            pairs.append(os.openpty())
        self._master, self._slave = pairs.pop()
        for ends in pairs:
            for end in ends:
                os.close(end)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._device = os.ttyname(self._slave)
        if self._link is not None:
            # made beside it and put in its place: nobody sees it missing
            fresh = self._link.with_name(f"{self._link.name}.new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self._device)
            fresh.replace(self._link)

    def _close(self) -> None:
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        os.close(self._master)
        os.close(self._slave)

    def _hang_up(self) -> None:
        self._close()
        self._open()

    def _ends(self) -> list[int]:
        return [self._master]

    def _hear(self, end: int) -> None:
        with contextlib.suppress(BlockingIOError):
            self._tell(os.read(end, 4096))

    def _say(self, data: bytes) -> None:
        # nobody reads and the terminal's buffer is full: a real cable loses the bytes as well
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)
