"""Bytes over a line - serial port, pseudo-terminal or TCP - and nothing about what they mean.

pyserial blocks, so a line owns threads: one reads whatever comes and hands it to the event loop, one
writes what is asked, and one writes stops. Writers share a lock that is held for a single write only,
so a stop goes out at once, whole, whatever else is going on.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial
from serial.tools import list_ports

from drivers.wire.incoming import Incoming
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing, DeviceSilent

_GLANCE_S = 0.05
_WRITE_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class ControlLines:
    """What DTR and RTS of a serial port are while it is open.

    Both asserted is what cables that live on these lines need, and what keeps the reset circuit of an ESP32
    at rest. Many Arduino boards start anew when DTR is asserted: those want it left alone.

    Attributes
    ----------
    dtr, rts : bool
    """

    dtr: bool = True
    rts: bool = True


class ByteLine(Protocol):
    """A line that bytes go out on and come in from; loss shows as `DeviceMissing`."""

    @property
    def address(self) -> str:
        """Device path or ``socket://host:port``, for messages."""
        ...

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        ...

    async def open(self) -> None:
        """Open it, exclusively where that is possible."""
        ...

    async def close(self) -> None:
        """Close it; closing twice is fine."""
        ...

    async def write(self, data: bytes) -> None:
        """Write all bytes."""
        ...

    async def write_now(self, data: bytes) -> None:
        """Write all bytes, ahead of every `write` that waits."""
        ...

    async def read(self, timeout_s: float) -> bytes:
        """Return what has come, waiting for the first byte; empty when none came in time."""
        ...

    def drain(self) -> bytes:
        """Throw away what has come so far, and return it for the log."""
        ...

    async def lost(self) -> str:
        """Wait until the open line is lost, and tell why."""
        ...


def existing_ports() -> list[str]:
    """List the serial ports of this machine, stable names (``/dev/serial/by-id``) first."""
    stable = sorted(str(entry) for entry in Path("/dev/serial/by-id").glob("*"))
    return stable + sorted(port.device for port in list_ports.comports())


class SerialLine:
    """A `ByteLine` over pyserial: a serial port, a pseudo-terminal, or ``socket://host:port``.

    Parameters
    ----------
    address : str
        Device path or pyserial URL.
    baud : int
        Speed; ignored on TCP.
    log : WireLog, optional
        Where all bytes are noted, both ways.
    control : ControlLines, optional
        Of a serial port.
    """

    def __init__(
        self,
        address: str,
        *,
        baud: int = 9600,
        log: WireLog | None = None,
        control: ControlLines | None = None,
    ) -> None:
        self._address = address
        self._baud = baud
        self._control = control or ControlLines()
        self._log = log or WireLog(kept=1)
        self._port: serial.Serial | None = None
        self._threads: list[ThreadPoolExecutor] = []
        self._reading: threading.Thread | None = None
        self._closing = threading.Event()
        self._writing = threading.Lock()
        self._incoming = Incoming(address, self._advice, self._log)
        self._changing = asyncio.Lock()
        """Held while it is opened or closed: a port that is just being closed is still locked."""

    @property
    def address(self) -> str:
        """Device path or URL."""
        return self._address

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._incoming.usable

    async def open(self) -> None:
        """Open the port, exclusively where that is possible.

        Raises
        ------
        DeviceMissing
            If there is no such port or it can't be opened; the advice lists the ports that exist.
        """
        async with self._changing:
            await self._close()
            await self._open()

    async def _open(self) -> None:
        loop = asyncio.get_running_loop()
        threads = [ThreadPoolExecutor(1, "line-write"), ThreadPoolExecutor(1, "line-stop")]
        try:
            port = await loop.run_in_executor(threads[0], self._opened)
        except (serial.SerialException, OSError, ValueError) as cause:
            for thread in threads:
                thread.shutdown(wait=False)
            raise DeviceMissing(
                f"can't be opened: {cause}", device=self._address, advice=self._advice()
            ) from cause
        self._port, self._threads = port, threads
        self._incoming.opened()
        self._closing = threading.Event()
        self._reading = threading.Thread(
            target=self._listen, args=(port, loop, self._closing), name="line-read", daemon=True
        )
        self._reading.start()

    def _opened(self) -> serial.Serial:
        port: serial.Serial = serial.serial_for_url(
            self._address,
            baudrate=self._baud,
            timeout=_GLANCE_S,
            write_timeout=_WRITE_TIMEOUT_S,
            exclusive=True,
            do_not_open=True,
        )
        # set before it is opened: pyserial asserts both otherwise, and the reset has begun
        port.dtr, port.rts = self._control.dtr, self._control.rts
        port.open()
        return port

    def _advice(self) -> str:
        if "://" in self._address:
            return "check host, port, and that the mount's network link is on"
        ports = existing_ports()
        return (
            "ports that exist: " + ", ".join(ports) if ports else "there are no serial ports on this machine"
        )

    async def close(self) -> None:
        """Close the port and end its threads; closing twice is fine."""
        async with self._changing:
            await self._close()

    async def _close(self) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        self._incoming.closed()
        self._closing.set()
        threads, self._threads = self._threads, []
        reading, self._reading = self._reading, None

        def end() -> None:
            if reading is not None:
                reading.join()
            # pyserial leaves the socket of a cut connection open: its shutdown fails before its close
            link = getattr(port, "_socket", None)
            # a port that is already gone has nothing left to close
            with contextlib.suppress(OSError):
                port.close()
            if link is not None:
                link.close()

        await asyncio.get_running_loop().run_in_executor(threads[0], end)
        for thread in threads:
            thread.shutdown(wait=False)

    async def write(self, data: bytes) -> None:
        """Write all bytes.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost.
        DeviceSilent
            If the other end takes nothing.
        """
        await self._write_by(0, data)

    async def write_now(self, data: bytes) -> None:
        """Write all bytes, ahead of every `write` that waits; raises as `write` does."""
        await self._write_by(1, data)

    async def _write_by(self, which: int, data: bytes) -> None:
        port = self._usable_port()
        try:
            await asyncio.get_running_loop().run_in_executor(
                self._threads[which], self._write_whole, port, data
            )
        except serial.SerialTimeoutException as cause:
            raise DeviceSilent(
                "takes no more bytes", device=self._address, advice="check cable and power"
            ) from cause
        except OSError as cause:
            self._incoming.lose(str(cause))
            raise self._incoming.missing() from cause

    def _write_whole(self, port: serial.Serial, data: bytes) -> None:
        with self._writing:
            # noted first: the answer may be read before this thread goes on
            self._log.note("driver->mount", data)
            port.write(data)

    async def read(self, timeout_s: float) -> bytes:
        """Return what has come, waiting up to `timeout_s` for the first byte; empty when none came.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost, and nothing is left to read.
        """
        return await self._incoming.read(timeout_s)

    def drain(self) -> bytes:
        """Throw away what has come so far, and return it."""
        return self._incoming.drain()

    def _usable_port(self) -> serial.Serial:
        self._incoming.require()
        assert self._port is not None
        return self._port

    async def lost(self) -> str:
        """Wait until the open line is lost, and tell why."""
        return await self._incoming.lost()

    def _listen(self, port: serial.Serial, loop: asyncio.AbstractEventLoop, closing: threading.Event) -> None:
        """Hand whatever comes to the event loop, until closing or loss; runs in the reading thread."""
        # the loop may be closed while a byte is on its way: then nobody is left to be told
        with contextlib.suppress(RuntimeError):
            while not closing.is_set():
                try:
                    data = port.read(1)
                    if data and port.in_waiting:
                        data += port.read(port.in_waiting)
                except OSError as cause:
                    if not closing.is_set():
                        loop.call_soon_threadsafe(self._incoming.lose, str(cause))
                    return
                if data:
                    self._log.note("mount->driver", data)
                    loop.call_soon_threadsafe(self._incoming.arrived, data)
