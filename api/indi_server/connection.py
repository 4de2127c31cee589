"""One client of the INDI server: what it hears, what it orders, what it has chosen; never in another's way.

Each client has its own ON_COORD_SET (so that nobody's SYNC turns another one's goto into a sync) and its
own CONNECTION (so that nobody disconnects a mount that others use). What it is told is the difference between
what it knows and what is so: a slow client misses positions on the way, and costs no memory.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping

from api.access.callers import Caller, Face, Role
from api.indi_server.device import ABORT, IndiTelescope
from api.indi_server.life import ClientLife
from api.indi_server.orders import Answer, chosen_switch
from api.indi_server.parser import Asked, Broken, Heard, Hearing, Nonsense
from api.indi_server.properties import COORDINATES, PULSES
from api.indi_server.publisher import SYNC, USUAL, LeftSelections, Publisher, Selections
from api.indi_server.vectors import saying
from api.listeners.tcp import STOPS_AT_ONCE, Allowance, Turns
from drivers.indi.codec.messages import Ordered, PingAnswered, Pinged, State, ping_reply, ping_request
from mountnav.clock import utc_now
from mountnav.tasks import Crew

_log = logging.getLogger(__name__)

_AT_ONCE_BYTES = 65_536
"""Bytes taken in one read; `Allowance` bounds what a client may send in all. Doubled, one client holds a
turn of the loop twice as long."""
_MOST_ORDERS, _MOST_WAITING = 200, 5000
"""What a client may have waiting: orders; and with questions and the like."""
_GOODBYE_S = 0.5
"""Longest wait for a client to take its last bytes when its connection ends, s; chosen by hand. Doubled, a
shutdown with a stuck client takes that much longer."""
_LONGEST_SILENCE_S = 30.0
"""A client that takes nothing for so long is gone."""


class Closing(Exception):
    """The connection ends, for a reason that the client is told."""


class Connection:
    """One client.

    Parameters
    ----------
    devices : mapping of str to IndiTelescope
        By their names.
    reader, writer
        Of its connection.
    left : LeftSelections
        What clients have left behind.
    turns : Turns
        Shared by all clients of the port.
    silence_s : float
        A client that answers questions is taken for gone after so long a silence.
    """

    def __init__(
        self,
        devices: Mapping[str, IndiTelescope],
        left: LeftSelections,
        turns: Turns,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        *,
        silence_s: float,
    ) -> None:
        peer = writer.get_extra_info("peername") or ("unknown", 0)
        self.address = f"{peer[0]}:{peer[1]}"
        self._caller = Caller(f"indi {self.address}", Role.OPERATE, Face.INDI, str(peer[0]))
        self._devices = devices
        self._reader, self._writer = reader, writer
        self._hearing = Hearing()
        self._turns = turns
        self._waiting: asyncio.Queue[Heard | Closing | None] = asyncio.Queue(_MOST_WAITING)
        self._selections = Selections(left, str(peer[0]))
        self._publisher = Publisher(devices, self._selections)
        self._life = ClientLife(lambda uid: self._publisher.send(ping_request(uid)), silence_s)
        self._crew = Crew()
        self._stops_room = asyncio.Semaphore(STOPS_AT_ONCE)
        self._orders_waiting = 0
        self._surplus = ""
        """What is too much; once it is, only stops are heard."""
        self._broken = ""
        self._speaks_indi = False
        """Whether a whole message came before anything else."""

    async def run(self) -> None:
        """Serve it until it goes, or has to; what it ordered before is carried out, and its jobs go on."""
        crew = self._crew
        for device in self._devices.values():
            device.came(self._caller, self._life)
        crew.begin(self._read(), f"indi {self.address} reads")
        working = crew.begin(self._work(), f"indi {self.address} works")
        crew.begin(self._watch_its_reading(), f"indi {self.address} is full")
        writing = crew.begin(self._write(), f"indi {self.address} writes")
        try:
            await crew.until(working)
        except Closing as reason:
            _log.info("the INDI client %s is closed: %s", self.address, reason)
            await self._say_goodbye(str(reason), writing)
        finally:
            self._selections.leave()
            for device in self._devices.values():
                device.gone(self._caller)
            await crew.end()
            self._writer.close()
            try:
                async with asyncio.timeout(_GOODBYE_S):
                    await self._writer.wait_closed()
            except (OSError, TimeoutError):
                # it doesn't even take the end
                self._writer.transport.abort()

    async def _write(self) -> None:
        try:
            while True:
                await self._publisher.news.wait()
                self._publisher.news.clear()
                await self._write_out(self._publisher.out())
        except (OSError, TimeoutError):
            # it hears nothing any more: its reading ends as well, and what it ordered is carried out
            self._publisher.end()
            self._writer.transport.abort()

    async def _watch_its_reading(self) -> None:
        await self._publisher.overflowed.wait()
        raise Closing("more was asked for than is being read")

    async def _write_out(self, data: bytes) -> None:
        if data:
            self._writer.write(data)
            # no wait_for: in Python 3.11 it may swallow the cancellation that ends this task
            async with asyncio.timeout(_LONGEST_SILENCE_S):
                await self._writer.drain()

    async def _say_goodbye(self, why: str, writing: asyncio.Task[None]) -> None:
        writing.cancel()
        await asyncio.gather(writing, return_exceptions=True)
        with contextlib.suppress(OSError, TimeoutError):
            self._writer.write(self._publisher.unsent() + saying("", f"[ERROR] goodbye: {why}", utc_now()))
            async with asyncio.timeout(_GOODBYE_S):
                await self._writer.drain()

    def fail(self, fault: Exception) -> None:
        """End it: what it would be told from now on is not so."""
        self._crew.fail(fault)

    def changed(self) -> None:
        """Tell what is different now, as soon as it takes it."""
        self._publisher.news.set()

    def tell(self, device: IndiTelescope, answer: Answer) -> None:
        """Tell how something ended, with its words."""
        self._publisher.tell(device, answer)

    def say(self, device: IndiTelescope, words: str) -> None:
        """Tell a message of a device."""
        self._publisher.say(device, words)

    def lose(self, device: IndiTelescope) -> None:
        """Tell that a device has gone. What this client moves of it ends with the device."""
        self._publisher.forget(device.name)

    def find(self, device: IndiTelescope) -> None:
        """Tell of a device that has come, where the client has asked for all."""
        device.came(self._caller, self._life)
        self.changed()

    # -- what it says --------------------------------------------------------------------------------

    async def _read(self) -> None:
        """Take in what it says, to its end: whatever else is wrong, a stop that came is heard."""
        allowance = Allowance()
        with contextlib.suppress(OSError):
            while data := await self._reader.read(_AT_ONCE_BYTES):
                # a stop goes before all that came with it
                came: list[Heard] = []
                async for part in self._turns.each(self._hearing.parts(data)):
                    for heard in part:
                        self._lives(heard)
                        if isinstance(heard, Ordered) and heard.name == ABORT:
                            await self._abort(heard, came)
                        elif isinstance(heard, PingAnswered):
                            pass
                        else:
                            came.append(heard)
                self._take(came)
                await allowance.spend(len(data))
        await self._waiting.put(None)

    def _lives(self, heard: Heard) -> None:
        """Take in what something that came says of its life."""
        if isinstance(heard, PingAnswered):
            self._life.answered()
            return
        self._life.said()
        if isinstance(heard, Asked) and heard.by_a_server:
            self._life.through_a_server = True

    def _take(self, came: list[Heard]) -> None:
        """Keep what came in its order; what is whole counts, though something between was broken.

        Coordinates after a gap do not: a lost ON_COORD_SET would make a goto of a sync. And where the very
        first is no INDI nothing counts, or a web page could order by what it has its browser send here.
        """
        for heard in came:
            if isinstance(heard, Broken):
                self._broken = self._broken or heard.why
            elif self._broken and (not self._speaks_indi or _is_coordinates(heard)):
                self._refuse_after_gap(heard)
            else:
                self._speaks_indi = True
                self._queue(heard)
        if self._broken and not self._surplus:
            # it ends when what waits is done
            self._surplus = f"that is not INDI: {self._broken}"
            with contextlib.suppress(asyncio.QueueFull):
                self._waiting.put_nowait(Closing(self._surplus))

    def _refuse_after_gap(self, heard: Heard) -> None:
        device = self._devices.get(heard.device) if isinstance(heard, Ordered) else None
        if isinstance(heard, Ordered) and device is not None and self._speaks_indi:
            why = "something before it was broken and may have been ON_COORD_SET: connect and order it again"
            self._publisher.tell(device, Answer.refused(heard.name, why))

    def _queue(self, heard: Heard) -> None:
        # when it is too much it ends, as soon as what waits is done; until then only stops are heard
        if self._surplus:
            if not self._publisher.room.is_set():
                # it goes on, and doesn't read: there is nothing to wait for
                self._publisher.overflowed.set()
            return
        if isinstance(heard, Ordered):
            if self._orders_waiting >= _MOST_ORDERS:
                self._surplus = f"more than {_MOST_ORDERS} orders were waiting"
                return
            self._orders_waiting += 1
        try:
            self._waiting.put_nowait(heard)
        except asyncio.QueueFull:
            self._surplus = f"more than {_MOST_WAITING} messages were waiting"

    async def _abort(self, ordered: Ordered, came: list[Heard]) -> None:
        """Stop before everything else; what this client ordered before, and isn't done yet, is dropped.

        That is what waits, and what `came` with it. A client that has disconnected may stop too.
        """
        device = self._devices.get(ordered.device)
        if device is None:
            self._publisher.send(saying("", f"[ERROR] there is no device {ordered.device}", utc_now()))
            return
        if ordered.kind != "Switch" or set(ordered.values) - {"ABORT"}:
            self._publisher.tell(device, Answer.refused(ABORT, f"{ABORT} is one switch: ABORT"))
            return
        if ordered.values.get("ABORT") is not True:
            self._publisher.tell(device, Answer(ABORT))
            return

        def dropped(heard: Heard | Closing | None) -> bool:
            drop = isinstance(heard, Ordered) and heard.device == ordered.device
            if isinstance(heard, Ordered) and drop:
                self._publisher.tell(device, Answer.refused(heard.name, "a stop came first"))
            return drop

        if self._orders_waiting + sum(isinstance(heard, Ordered) for heard in came) > _MOST_ORDERS:
            self._surplus = self._surplus or f"more than {_MOST_ORDERS} orders were waiting"
        kept = []
        while not self._waiting.empty():
            heard = self._waiting.get_nowait()
            if dropped(heard):
                self._orders_waiting -= 1
            else:
                kept.append(heard)
        came[:] = [heard for heard in came if not dropped(heard)]
        for heard in kept:
            self._waiting.put_nowait(heard)
        if self._surplus and not any(isinstance(heard, Closing) for heard in kept):
            # there is room now: nothing was put back but questions and the like
            with contextlib.suppress(asyncio.QueueFull):
                self._waiting.put_nowait(Closing(self._surplus))
        await self._stops_room.acquire()

        def ended(answer: Answer) -> None:
            self._stops_room.release()
            self._publisher.tell(device, answer)

        # the device's own task: it is sent though its client goes at once
        device.abort(self._caller, ended)

    async def _work(self) -> None:
        while (heard := await self._waiting.get()) is not None:
            # what all clients have waiting would else be one turn of the loop
            await self._turns.mine()
            match heard:
                case Asked():
                    # at its own pace, and at no other client's cost
                    await self._publisher.room.wait()
                    self._publisher.ask(heard)
                case Ordered():
                    self._orders_waiting -= 1
                    await self._order(heard)
                case Pinged(uid=uid):
                    self._publisher.send(ping_reply(uid))
                case Nonsense():
                    self._refuse_nonsense(heard)
                case Closing():
                    raise heard
            if self._surplus and self._waiting.empty():
                raise Closing(self._surplus)
        self._selections.leave()

    async def _order(self, ordered: Ordered) -> None:
        device = self._devices.get(ordered.device)
        if device is None:
            self._publisher.send(saying("", f"[ERROR] there is no device {ordered.device}", utc_now()))
            return
        try:
            if ordered.name == "CONNECTION":
                await self._connect(device, ordered)
            elif not self._publisher.is_connected(device):
                self._publisher.tell(device, Answer.refused(ordered.name, f"{device.name} is not connected"))
            elif ordered.name == "ON_COORD_SET":
                self._choose(device, ordered)
            else:
                await self._give(device, ordered)
        except ValueError as error:
            self._publisher.tell(device, Answer.refused(ordered.name, str(error)))

    async def _give(self, device: IndiTelescope, ordered: Ordered) -> None:
        mode = self._selections.of(device.name)
        if ordered.name == COORDINATES and mode == SYNC:
            # a goto that follows is a goto; and Ok is told when it was synced, not before
            self._selections.choose(device.name, USUAL)
            self._publisher.hold(device, ordered.name)
        elif ordered.name in PULSES and ordered.name in device.vectors:
            # Busy once, then Idle once [INDI GuiderInterface]: what came later would end PHD2's next pulse
            self._publisher.tell(device, Answer(ordered.name, State.BUSY))
            self._publisher.hold(device, ordered.name)
        try:
            answer = await device.take(self._caller, ordered, mode)
        finally:
            self._publisher.release(device, ordered.name)
        self._publisher.tell(device, answer)

    def _choose(self, device: IndiTelescope, ordered: Ordered) -> None:
        chosen = chosen_switch(ordered, self._publisher.shown(device)["ON_COORD_SET"])
        if chosen is not None:
            self._selections.choose(device.name, chosen)
        self._publisher.tell(device, Answer("ON_COORD_SET"))

    async def _connect(self, device: IndiTelescope, ordered: Ordered) -> None:
        chosen = chosen_switch(ordered, self._publisher.shown(device)["CONNECTION"])
        if chosen == "DISCONNECT":
            self._publisher.off[device.name] = True
            self.tell(
                device,
                Answer("CONNECTION", words="[INFO] for this program: the mount stays with the service"),
            )
        elif chosen == "CONNECT":
            self._publisher.off[device.name] = False
            why = None if device.connected else await device.connect()
            if why is not None:
                self._publisher.tell(device, Answer.refused("CONNECTION", why))
            else:
                self._publisher.tell(device, Answer("CONNECTION"))
        self.changed()

    def _refuse_nonsense(self, heard: Nonsense) -> None:
        device = self._devices.get(heard.device)
        if device is None:
            self._publisher.send(saying("", f"[ERROR] {heard.why}", utc_now()))
        else:
            self._publisher.tell(device, Answer.refused(heard.name, heard.why))


def _is_coordinates(heard: Heard) -> bool:
    return isinstance(heard, Ordered) and heard.name == COORDINATES


__all__ = ["Closing", "Connection"]
