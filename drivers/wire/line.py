"""Bytes over a line (serial port, pseudo-terminal, TCP, UDP), and nothing about what they mean.

pyserial blocks, so a serial line owns threads: one reads whatever comes and hands it to the event loop, one
writes what is asked, and one writes stops. Writers share a lock that is held for a single write only,
so a stop goes out at once, whole, whatever else is going on.

Over UDP datagrams get lost, come twice and come late; what reads them must ask again and never take an old
one for new. A port that nobody listens on says so on most networks; that counts as a lost line. Silence
doesn't.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial
from serial.tools import list_ports

from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing, DeviceSilent

_CLOSED = "closed"
"""Why a line is lost that was closed by us."""
_MOST_UNREAD_BYTES = 1 << 16
"""How much may wait for its reader: six seconds at 115,200 baud. Doubled, 64 kB more memory; halved, three
seconds."""


class Incoming:
    """The reading half of a line: bytes that came and are not yet read, and why the line was lost.

    Used from the event loop's thread alone.

    Parameters
    ----------
    address : str
        Of the line, for messages.
    advice : callable
        Gives what a user can do when the line is lost.
    log : WireLog
        Where the line's opening and loss are noted.
    """

    def __init__(self, address: str, advice: Callable[[], str], log: WireLog) -> None:
        self._address = address
        self._advice = advice
        self._log = log
        self._came = bytearray()
        self._news = asyncio.Event()
        self._gone = asyncio.Event()
        self._open = False
        self._lost: str | None = None

    @property
    def usable(self) -> bool:
        """Whether the line is open and not lost."""
        return self._open and self._lost is None

    def opened(self) -> None:
        """Start again: drop what came while it was open before."""
        self._open, self._lost = True, None
        self._came.clear()
        self._news.clear()
        self._gone.clear()
        self._log.note("event", meaning=f"opened {self._address}")

    def closed(self) -> None:
        """End it: a reader that still waits must not get bytes of the next opening."""
        if self._open:
            self._open = False
            self._lost = self._lost or _CLOSED
            self._news.set()

    def arrived(self, data: bytes) -> None:
        """Add bytes that came."""
        self._came += data
        # perhaps nobody reads: of a line that is never quiet only the latest bytes are kept
        del self._came[:-_MOST_UNREAD_BYTES]
        self._news.set()

    def lose(self, why: str) -> None:
        """Count the line as lost; the first reason is kept."""
        if self._open and self._lost is None:
            self._lost = why
            self._log.note("event", meaning=f"lost {self._address}: {why}")
        self._news.set()
        self._gone.set()

    async def lost(self) -> str:
        """Wait until the open line is lost, and return why."""
        await self._gone.wait()
        return self._lost or _CLOSED

    async def read(self, timeout_s: float) -> bytes:
        """Return what has come, waiting up to `timeout_s` for the first byte; empty when none came.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost, and nothing is left to read.
        """
        if not self._came:
            self.require()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(timeout_s, 0.0)):
                    await self._news.wait()
        came = self.drain()
        if not came and self._lost is not None:
            raise self.missing()
        return came

    def drain(self) -> bytes:
        """Drop what has come so far, and return it."""
        came = bytes(self._came)
        self._came.clear()
        if self._lost is None:
            self._news.clear()
        return came

    def require(self) -> None:
        """Raise `DeviceMissing` unless the line is open and not lost."""
        if not self.usable:
            raise self.missing()

    def missing(self) -> DeviceMissing:
        """The error for a line that is not open, or was lost."""
        if self._lost in (None, _CLOSED):
            return DeviceMissing("the line is not open", device=self._address, advice="connect first")
        return DeviceMissing(f"the line was lost: {self._lost}", device=self._address, advice=self._advice())


_READ_S = 0.05
"""How long the reading thread blocks (s) before it looks whether the line is being closed. Chosen by hand.
Doubled, closing takes 0.05 s longer; halved, an idle line wakes the processor 40 times a second."""
_WRITE_TIMEOUT_S = 2.0
"""After this time (s) a port that takes no bytes counts as silent: 2 s are 2,000 bytes at 9600 baud, and
commands have some 20. Doubled, a stop on a hung port fails 2 s later; halved, nothing changes on ports that
work."""


@dataclass(frozen=True, slots=True)
class ControlLines:
    """What DTR and RTS of a serial port are while it is open.

    Both are asserted for cables that draw their power from these lines, and because that keeps the reset
    circuit of an ESP32 at rest. Many Arduino boards reset when DTR is asserted: for those it can be switched
    off.

    Attributes
    ----------
    dtr, rts : bool
        Whether the signal is asserted.
    """

    dtr: bool = True
    rts: bool = True


class ByteLine(Protocol):
    """A line that carries bytes both ways; its loss is raised as `DeviceMissing`."""

    @property
    def address(self) -> str:
        """Device path or ``socket://host:port``, for messages."""
        ...

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        ...

    async def open(self) -> None:
        """Open it, exclusively where that is possible; a line that is open is closed first."""
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
        """Drop what has come so far, and return it for the log."""
        ...

    async def lost(self) -> str:
        """Wait until the open line is lost, and return why."""
        ...


def existing_ports() -> list[str]:
    """List the serial ports of this machine, stable names (``/dev/serial/by-id``) first."""
    stable = sorted(str(entry) for entry in Path("/dev/serial/by-id").glob("*"))
    return stable + sorted(port.device for port in list_ports.comports())


class _ReadAhead:
    """The reading half of a line: what its own thread or protocol puts into `Incoming` as it comes."""

    def __init__(self, address: str, advice: Callable[[], str], log: WireLog | None) -> None:
        self._address = address
        self._log = log or WireLog(kept=1)
        self._incoming = Incoming(address, advice, self._log)

    @property
    def address(self) -> str:
        """Where it leads: a device path, or a URL."""
        return self._address

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._incoming.usable

    async def read(self, timeout_s: float) -> bytes:
        """Return what has come, waiting up to `timeout_s` for the first of it; empty when none came.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost, and nothing is left to read.
        """
        return await self._incoming.read(timeout_s)

    def drain(self) -> bytes:
        """Drop what has come so far, and return it."""
        return self._incoming.drain()

    async def lost(self) -> str:
        """Wait until the open line is lost, and return why."""
        return await self._incoming.lost()


class SerialLine(_ReadAhead):
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
        For a serial port.
    """

    def __init__(
        self,
        address: str,
        *,
        baud: int = 9600,
        log: WireLog | None = None,
        control: ControlLines | None = None,
    ) -> None:
        super().__init__(address, self._advice, log)
        self._baud = baud
        self._control = control or ControlLines()
        self._port: serial.Serial | None = None
        self._threads: list[ThreadPoolExecutor] = []
        self._reading: threading.Thread | None = None
        self._closing = threading.Event()
        self._writing = threading.Condition()
        self._stops_ordered = self._stops_written = 0
        """Writes that go before all others: counted by the loop alone, and by their thread alone."""
        self._changing = asyncio.Lock()
        """Held while the line is opened or closed: a port that is just being closed is still locked."""

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
            timeout=_READ_S,
            write_timeout=_WRITE_TIMEOUT_S,
            exclusive=True,
            do_not_open=True,
        )
        # set before opening: otherwise pyserial asserts both at once, which resets some boards
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
            # pyserial leaves the socket of a cut connection open: its `shutdown` fails before its `close`
            link = getattr(port, "_socket", None)
            # of a port that is gone there is nothing left to close
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
            If the other end accepts no bytes.
        """
        await self._write_by(0, data)

    async def write_now(self, data: bytes) -> None:
        """Write all bytes, ahead of every `write` that the port hasn't got yet; raises as `write` does."""
        await self._write_by(1, data)

    async def _write_by(self, which: int, data: bytes) -> None:
        port = self._usable_port()
        write = self._write_stop if which else self._write_whole
        self._stops_ordered += which
        try:
            writing = asyncio.get_running_loop().run_in_executor(self._threads[which], write, port, data)
        except BaseException:
            self._stops_ordered -= which
            raise
        try:
            # a stop that is waited for no more is written all the same: the others wait for it
            await (asyncio.shield(writing) if which else writing)
        except serial.SerialTimeoutException as cause:
            raise DeviceSilent(
                "accepts no more bytes", device=self._address, advice="check cable and power"
            ) from cause
        except OSError as cause:
            self._incoming.lose(str(cause))
            raise self._incoming.missing() from cause

    def _write_whole(self, port: serial.Serial, data: bytes) -> None:
        with self._writing:
            # no longer than a stop takes: one that never came to its thread holds up nothing for ever
            self._writing.wait_for(lambda: self._stops_written >= self._stops_ordered, _WRITE_TIMEOUT_S)
            self._write(port, data)

    def _write_stop(self, port: serial.Serial, data: bytes) -> None:
        with self._writing:
            try:
                self._write(port, data)
            finally:
                self._stops_written += 1
                self._writing.notify_all()

    def _write(self, port: serial.Serial, data: bytes) -> None:
        # noted before it is written: the answer may be read before this thread goes on
        self._log.note("driver->mount", data)
        port.write(data)

    def _usable_port(self) -> serial.Serial:
        self._incoming.require()
        assert self._port is not None
        return self._port

    def _listen(self, port: serial.Serial, loop: asyncio.AbstractEventLoop, closing: threading.Event) -> None:
        """Hand all bytes to the event loop, until closing or loss; runs in the reading thread."""
        # the loop may be closed while a byte is on its way: then `call_soon_threadsafe` raises
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


_UDP_ADVICE = "check host, port, and that this computer is in the mount's Wi-Fi network"


class _Datagrams(asyncio.DatagramProtocol):
    """Passes the events of a socket to its line."""

    def __init__(self, line: UdpLine) -> None:
        self._line = line

    def datagram_received(self, data: bytes, addr: object) -> None:
        self._line.take(data)

    def error_received(self, exc: Exception) -> None:
        self._line.lose(str(exc))

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is not None:
            self._line.lose(str(exc))


class UdpLine(_ReadAhead):
    """A `ByteLine` over UDP, for the Wi-Fi adapters of Sky-Watcher mounts: one datagram a command.

    Parameters
    ----------
    host : str
        Name or address.
    log : WireLog, optional
        Where all bytes are noted, both ways.
    """

    def __init__(self, host: str, port: int, *, log: WireLog | None = None) -> None:
        address = f"udp://[{host}]:{port}" if ":" in host else f"udp://{host}:{port}"
        super().__init__(address, lambda: _UDP_ADVICE, log)
        self._host, self._port = host, port
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> None:
        """Open a socket; whether anything listens at the other end shows at the first question.

        Raises
        ------
        DeviceMissing
            If the host has no address or no route.
        """
        await self.close()
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(
                lambda: _Datagrams(self), remote_addr=(self._host, self._port)
            )
        except OSError as cause:
            raise DeviceMissing(
                f"can't be opened: {cause}", device=self.address, advice=_UDP_ADVICE
            ) from cause
        self._transport = transport
        self._incoming.opened()

    async def close(self) -> None:
        """Close the socket; closing twice is fine."""
        transport, self._transport = self._transport, None
        self._incoming.closed()
        if transport is not None:
            transport.close()
            # the loop closes the socket in its next iteration
            await asyncio.sleep(0)

    async def write(self, data: bytes) -> None:
        """Send one datagram.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost.
        """
        self._usable_transport().sendto(data)
        self._log.note("driver->mount", data)

    async def write_now(self, data: bytes) -> None:
        """Send one datagram; datagrams never wait for each other."""
        await self.write(data)

    def take(self, data: bytes) -> None:
        """Take a datagram that came; called by the socket."""
        if self._transport is not None:
            self._log.note("mount->driver", data)
            self._incoming.arrived(data)

    def lose(self, why: str) -> None:
        """Count the line as lost; called by the socket."""
        if self._transport is not None:
            self._incoming.lose(why)

    def _usable_transport(self) -> asyncio.DatagramTransport:
        self._incoming.require()
        assert self._transport is not None
        return self._transport
