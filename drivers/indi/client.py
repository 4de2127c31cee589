"""One connection to an `indiserver`: gets everything about its devices, and knows at once when it is dead.

A closed connection shows by itself. A server that hangs, or a network that swallows, shows by its silence:
it is pinged whenever nothing has come for a moment [indiserver answers pingRequest since 1.9.8, without any
driver]. Servers that know no ping are left to the questions asked of their drivers, and to TCP's own timeout.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from drivers.indi.codec import messages as codec
from drivers.indi.codec import messages as orders
from drivers.indi.codec.messages import Defined, Event, PingAnswered, Pinged
from drivers.indi.codec.state import Properties, Property
from drivers.indi.codec.xml_stream import Malformed
from drivers.indi.family import PORT
from drivers.wire.wire_log import WireLog
from mountnav.clock import utc_now
from mountnav.errors import DeviceMissing
from mountnav.tasks import begun, fault_words

_AT_ONCE_BYTES = 1 << 18
"""Bytes taken from the socket at once. Chosen by hand: an image comes in few reads, and memory stays
small."""
_MOST_UNSENT_BYTES = 1 << 20
"""Bytes that may wait to be sent before the server counts as stuck. Our orders are a few hundred bytes
each, so this is thousands of orders that it has not taken. Chosen by hand."""
_MOST_PROPERTIES = 5000
"""Of all devices that a connection receives news of; a large observatory has a tenth."""
_MOST_PROPERTIES_BYTES = 1 << 24
"""Of all of them together; those of a large observatory take some hundred kB."""
_WORDS_KEPT = 200
"""How many messages of drivers are kept for explaining a refusal. Chosen by hand: a refusal's words come
within a few messages of it."""
_INTRODUCTION_S = 0.5
"""How long a server has to list its devices when we ask only for advice in an error message. Chosen by
hand; doubled, the error is shown later, halved, the list may be incomplete."""
_RETELL_S = 1.0
"""After a broken message all properties are asked for again, and no sooner than after so long once more, in
seconds, doubled each time that the answer holds one as well: a driver with one broken definition would be
asked without end. Twice as long leaves a change that was lost unknown for 1 s more."""
_LONGEST_RETELL_S = 64.0
"""Most that the doubling comes to, in seconds."""


@dataclass(frozen=True, slots=True)
class Pulse:
    """How a server's life is watched.

    Attributes
    ----------
    connect_s : float
        To reach it.
    ping_s : float
        When nothing has come for so long it is pinged.
    silent_s : float
        One that answers pings and was silent for so long is lost.
    """

    connect_s: float = 5.0
    ping_s: float = 0.4
    silent_s: float = 1.9


@dataclass(frozen=True, slots=True)
class Words:
    """Something a driver said, and after how many messages."""

    count: int
    device: str
    text: str


class IndiClient:
    """One connection; it can be opened again after it was lost.

    Parameters
    ----------
    device : str
        About which device; empty for all.
    """

    def __init__(
        self, host: str, port: int = PORT, device: str = "", *, log: WireLog, pulse: Pulse | None = None
    ) -> None:
        self._host, self._port, self._device = host, port, device
        self._pulse = pulse or Pulse()
        self.log = log
        self.properties = Properties()
        self.words: deque[Words] = deque(maxlen=_WORDS_KEPT)
        self.troubles = 0
        """How many messages that may have been of its device made no sense since it was opened."""
        self._retelling = _Retelling()
        self._listeners: list[Callable[[Event, Property | None], None]] = []
        self._writer: asyncio.StreamWriter | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._news = asyncio.Event()
        self._why_lost: str | None = "not connected"
        self._heard = False
        self._answers_pings = False
        self._pings = 0

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"indi://{self._host}:{self._port}"

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._why_lost is None

    def listen(self, listener: Callable[[Event, Property | None], None]) -> None:
        """Tell `listener` of every event, and the property it changed."""
        self._listeners.append(listener)

    async def open(self) -> None:
        """Connect, again if it is open, and ask for the properties.

        Raises
        ------
        DeviceMissing
            If nobody listens there.
        """
        await self.close()
        try:
            async with asyncio.timeout(self._pulse.connect_s):
                reader, writer = await asyncio.open_connection(self._host, self._port)
        except (OSError, TimeoutError) as cause:
            raise DeviceMissing(
                f"can't connect: {cause or 'no answer'}",
                device=self.address,
                advice="is indiserver running there? check host and port",
            ) from cause
        _die_early(writer.get_extra_info("socket"), self._pulse.silent_s)
        self.properties.clear()
        self.words.clear()
        self.troubles, self._answers_pings, self._heard = 0, False, False
        self._retelling = _Retelling()
        self._writer, self._why_lost = writer, None
        self.send(orders.ping_request(self._ping_id()), orders.get_properties(self._device))
        self._tasks = [
            begun(self._hear(reader), "indi-hear", died=self._died),
            begun(self._watch(), "indi-watch", died=self._died),
        ]

    async def close(self) -> None:
        """Release the connection; closing twice is fine."""
        self._lose("closed by us")
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            task.cancel()
        for task in tasks:
            # a fault of its own was reported when it came
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await task
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.transport.abort()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def lost(self) -> str:
        """Wait until the open connection is lost, and return why."""
        while self._why_lost is None:
            await self._news.wait()
        return self._why_lost

    def send(self, *messages: bytes) -> None:
        """Send messages in one piece, now.

        Raises
        ------
        DeviceMissing
            If it is lost.
        """
        writer = self._writer
        if writer is None or self._why_lost is not None:
            raise DeviceMissing(
                f"the connection is lost: {self._why_lost}", device=self.address, advice="connect again"
            )
        for message in messages:
            if not message.startswith(b"<ping"):
                self.log.note("driver->mount", message)
        writer.write(b"".join(messages))
        if writer.transport.get_write_buffer_size() > _MOST_UNSENT_BYTES:
            self._lose("it takes nothing any more")

    async def until(self, true: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until something is true of what was heard; return whether it came true in time.

        Raises
        ------
        DeviceMissing
            If the connection is lost meanwhile.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not true():
                    if self._why_lost is not None:
                        raise DeviceMissing(
                            f"the connection is lost: {self._why_lost}",
                            device=self.address,
                            advice="is indiserver still running?",
                        )
                    await self._news.wait()
        except TimeoutError:
            return False
        return True

    async def devices_there(self) -> list[str]:
        """Ask the server for its devices, on another connection: this one is about its own alone."""
        other = IndiClient(self._host, self._port, log=WireLog(kept=1), pulse=self._pulse)
        await other.open()
        try:
            await other.until(lambda: False, _INTRODUCTION_S)
            return other.properties.devices()
        finally:
            await other.close()

    def said_since(self, count: int, device: str) -> list[str]:
        """What a device's driver said after so many messages."""
        return [words.text for words in self.words if words.count > count and words.device == device]

    # -- hearing ---------------------------------------------------------------------------------

    async def _hear(self, stream: asyncio.StreamReader) -> None:
        reader = codec.Reader()
        while True:
            try:
                data = await stream.read(_AT_ONCE_BYTES)
            except OSError as cause:
                self._lose(f"the connection broke: {cause}")
                return
            if not data:
                self._lose("the server closed the connection")
                return
            self._heard = True
            troubles = self.troubles
            for events in reader.parts(data):
                for event in events:
                    self._take(event)
                    if not self.usable:
                        return
                self._tell_news()
                # whatever a server sends: a stop, and all else, has its turn in between
                await asyncio.sleep(0)
            if self.troubles > troubles:
                self._retelling.want()
            self._have_retold()

    def _take(self, event: Event) -> None:
        if isinstance(event, Malformed):
            # indi_lx200_OnStep 1.9.9 defines a property without device and name: nothing of ours
            if event.device is None or not self._device or event.device == self._device:
                self.troubles += 1
            self.log.note("event", meaning=f"broken message: {event.why}: {event.excerpt!r}")
        elif isinstance(event, PingAnswered):
            self._answers_pings = True
            return
        else:
            self.log.note("mount->driver", event.raw)
        if isinstance(event, Pinged):
            self.send(orders.ping_reply(event.uid))
        now = self.properties.take(event, utc_now(), asyncio.get_running_loop().time())
        if len(self.properties) > _MOST_PROPERTIES:
            self._give_up(f"it defines more than {_MOST_PROPERTIES} properties")
        elif self.properties.size_bytes > _MOST_PROPERTIES_BYTES:
            self._give_up(f"its properties take more than {_MOST_PROPERTIES_BYTES >> 20} MB")
        message = getattr(event, "message", "")
        # a message that comes with a definition is as old as that
        if message and not isinstance(event, Defined):
            self.words.append(Words(self.properties.count, getattr(event, "device", ""), message))
        for listener in self._listeners:
            listener(event, now)

    def _have_retold(self) -> None:
        """Have everything sent again if a change may have been lost, and it is time."""
        if self.usable and self._retelling.due(asyncio.get_running_loop().time()):
            self.send(orders.get_properties(self._device))

    def _give_up(self, why: str) -> None:
        """Hear no more of a server that would have us grow without end."""
        self._lose(f"{why}: a driver of it is out of order; restart it")
        self.properties.clear()

    def _tell_news(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _died(self, fault: Exception) -> None:
        """A task of ours is gone: what nobody reads or watches any more is no link."""
        self._lose(fault_words(fault))

    def _lose(self, why: str) -> None:
        if self._why_lost is not None:
            return
        self._why_lost = why
        self.log.note("event", meaning=f"{self.address}: {why}")
        self._tell_news()

    # -- life ------------------------------------------------------------------------------------

    async def _watch(self) -> None:
        """Ping a silent server; glances are counted, not seconds: a stall of ours is not its death."""
        pulse = self._pulse
        most = max(2, int(pulse.silent_s / pulse.ping_s))
        quiet = 0
        while self.usable:
            await asyncio.sleep(pulse.ping_s)
            quiet = 0 if self._heard else quiet + 1
            self._heard = False
            self._have_retold()
            if quiet >= most and self._answers_pings:
                self._lose(f"the server was silent for {quiet * pulse.ping_s:.1f} s")
            elif quiet and self.usable:
                self.send(orders.ping_request(self._ping_id()))

    def _ping_id(self) -> str:
        self._pings += 1
        return f"mountnav-{self._pings}"


class _Retelling:
    """When everything has to be sent again, because a change may have been lost."""

    def __init__(self) -> None:
        self._wanted = False
        self._next_s = -math.inf
        self._wait_s = _RETELL_S

    def want(self) -> None:
        """Something was lost."""
        self._wanted = True

    def due(self, now_s: float) -> bool:
        """Whether to ask now; then it counts as asked."""
        if not self._wanted or now_s < self._next_s:
            return False
        # long after the last time it is another matter
        again = now_s < self._next_s + self._wait_s
        self._wait_s = min(2.0 * self._wait_s, _LONGEST_RETELL_S) if again else _RETELL_S
        self._wanted, self._next_s = False, now_s + self._wait_s
        return True


def _die_early(end: socket.socket | None, silent_s: float) -> None:
    """Have the system give up a dead peer soon, where it can."""
    if end is None:
        return
    with contextlib.suppress(OSError):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        unacknowledged = getattr(socket, "TCP_USER_TIMEOUT", None)
        if unacknowledged is not None:
            end.setsockopt(socket.IPPROTO_TCP, unacknowledged, round(1000.0 * silent_s))
