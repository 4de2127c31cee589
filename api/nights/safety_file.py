"""The file by which a weather station, a roof or a script says whether it is safe."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

from mountnav.files import read_bytes
from mountnav.tasks import fault_words

_log = logging.getLogger(__name__)

LOOK_S = 10.0
"""So long the file may take to be read, s: one on a share that is gone takes for ever. Doubled, rain is
noticed so much later."""
_AHEAD_S = 5.0
"""A file may be newer than our clock by so much, s: two machines that both keep time by NTP are nearer. One
that was written by a clock far ahead would never become old."""
_MOST_BYTES = 65_536
"""Its first word counts; a log that somebody names by mistake is told as too long."""


class SafetyFile:
    """Reads the file, however long that takes, and has an answer in time.

    Parameters
    ----------
    max_age_s : float
        An older one means that it isn't safe: its writer has stopped. By the machine's clock, as
        files have it.
    look_s : float, optional
        How long a look waits for the file, in seconds of the machine.
    """

    def __init__(self, file: Path, max_age_s: float, *, look_s: float = LOOK_S) -> None:
        self.file = file
        self._max_age_s = max_age_s
        self._look_s = look_s
        self._reading: asyncio.Future[str] | None = None
        self._since_s = 0.0

    async def look(self) -> str:
        """Why it isn't safe; empty when it is. Raises nothing, and waits `look_s` at most."""
        if self._reading is None:
            self._reading, self._since_s = self._begun(), time.monotonic()
        reading = self._reading
        await asyncio.wait({reading}, timeout=self._look_s)
        if not reading.done():
            return f"the safety file gives no answer for {time.monotonic() - self._since_s:.0f} s"
        self._reading = None
        if (fault := reading.exception()) is not None:
            _log.error("the safety file %s failed unexpectedly", self.file, exc_info=fault)
            return f"the safety file can't be read: {fault_words(fault)}"
        return reading.result()

    def _begun(self) -> asyncio.Future[str]:
        """Read it in a thread of its own: one that hangs keeps neither other work nor the service's end."""
        loop = asyncio.get_running_loop()
        told: asyncio.Future[str] = loop.create_future()

        def tell(why: str | None, fault: Exception | None) -> None:
            if told.done():
                return
            if fault is not None:
                told.set_exception(fault)
            else:
                told.set_result(why or "")

        def read() -> None:
            why, trouble = None, None
            try:
                why = unsafe_by_file(self.file, self._max_age_s, time.time)
            except Exception as fault:  # it belongs to the one who looks
                trouble = fault
            with contextlib.suppress(RuntimeError):  # the service has ended meanwhile
                loop.call_soon_threadsafe(tell, why, trouble)

        threading.Thread(target=read, name="safety file", daemon=True).start()
        return told


def unsafe_by_file(file: Path, max_age_s: float, now_s: Callable[[], float]) -> str:
    """Why a safety file says that it is not safe; empty when it is safe. Blocks.

    Parameters
    ----------
    now_s : callable
        Seconds since 1970.
    """
    try:
        written_s = os.stat(file).st_mtime
        words = read_bytes(file, _MOST_BYTES).decode("utf-8-sig", errors="replace").split()
    except OSError as trouble:
        return f"the safety file can't be read: {trouble.strerror or trouble}"
    # reading may have taken long
    age_s = now_s() - written_s
    if age_s > max_age_s:
        return f"the safety file is {age_s:.0f} s old"
    if age_s < -_AHEAD_S:
        return f"the safety file was written {-age_s:.0f} s after now: a clock is wrong"
    word = words[0].strip(":;,.").lower() if words else ""
    if word in ("safe", "1", "true", "yes", "ok"):
        return ""
    return f"the safety file says {word!r}" if word else "the safety file is empty"


__all__ = ["LOOK_S", "SafetyFile", "unsafe_by_file"]
