"""LX200 over TCP: one telescope as a mount that SkySafari and many apps know; places are of date (JNow)."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import OrderedDict
from collections.abc import Coroutine

from api.access.callers import Caller, Face
from api.listeners.tcp import STOPS_AT_ONCE, Allowance, Turns
from api.orders.goto_orders import NotTaken
from api.planetarium.lx200_codec import Commands, is_http
from api.planetarium.lx200_keys import Lx200Keys
from api.planetarium.lx200_session import Lx200Client, Machine, MountLost
from api.planetarium.telescope_server import AT_ONCE_BYTES, LONGEST_SILENCE_S, OneTelescopeServer
from api.service import Service
from mountnav.settings.faces import Lx200ServerSettings
from mountnav.tasks import Crew, begun

_log = logging.getLogger(__name__)

_FIRST_BYTES = 16
"""First bytes of a connection by which a web browser is recognized: its method and a space."""
_MOST_WAITING = 100
"""Commands of a client that may wait to be answered; chosen by hand. With more it is answered those, and
let go. Doubled, one that floods is let go later."""
_MOST_MACHINES = 64
"""Machines whose half targets are remembered, as apps may reconnect for each command; chosen by hand.
Halved, a 33rd app makes the first one's target be forgotten."""
_STOP = b":Q#"
_STOPS_ONE_WAY = (b":Qn#", b":Qs#", b":Qe#", b":Qw#")
"""They end what a key moves, or else a goto [Meade LX200 manual, :Qn#]."""
Waiting = tuple[bytes, int]
"""A command, and how many stops had come before it."""


class Lx200Server(OneTelescopeServer):
    """Serves one telescope to LX200 apps.

    Parameters
    ----------
    settings : Lx200ServerSettings, optional
        Instead of the service's own.

    Raises
    ------
    BadSettings
        There is no such telescope.
    """

    def __init__(self, service: Service, settings: Lx200ServerSettings | None = None) -> None:
        settings = settings or service.settings.lx200_server
        super().__init__(service, settings, section="lx200_server", name="the LX200 port")
        self._site = service.settings.site.site
        mounting = next(
            telescope.mount.mounting for telescope in service.settings.telescope if telescope.id == self._id
        )
        # P: a polar axis, A: altitude and azimuth [LX200 0x06]
        self._letter = b"A" if mounting == "altaz" else b"P"
        self._tasks: set[asyncio.Task[None]] = set()
        self._turns = Turns()
        self._keys = Lx200Keys(service.dispatcher, self._id, settings)
        self._machines: OrderedDict[str, Machine] = OrderedDict()

    async def stop(self) -> None:
        """Let all clients go, and listen no more; what keys move ends. Jobs go on."""
        await super().stop()
        await self._keys.close()

    def _machine(self, host: str) -> Machine:
        """What is kept for a machine; the one that was heard of least lately is forgotten."""
        machine = self._machines.setdefault(host, Machine())
        self._machines.move_to_end(host)
        while len(self._machines) > _MOST_MACHINES:
            self._machines.popitem(last=False)
        return machine

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host = str((writer.get_extra_info("peername") or ("unknown",))[0])
        # apps open a connection for each command: the machine is the caller
        caller = Caller(f"lx200 {host}", self._role, Face.LX200, host)
        crew = Crew()
        client = Lx200Client(
            caller,
            self._watch,
            self._ordering,
            self._site,
            self._machine(host),
            self._letter,
            self._keys,
            died=crew.fail,
        )
        waiting: asyncio.Queue[Waiting | None] = asyncio.Queue(_MOST_WAITING)
        crew.begin(self._hear(reader, client, waiting), f"{caller.name} is heard")
        answering = crew.begin(_answer(client, waiting, self._turns, writer), f"{caller.name} is answered")
        try:
            await crew.until(answering)
        except MountLost as lost:
            _log.info("%s is closed: %s", caller.name, lost)
        finally:
            await crew.end()
            writer.close()

    async def _hear(
        self, reader: asyncio.StreamReader, client: Lx200Client, waiting: asyncio.Queue[Waiting | None]
    ) -> None:
        """Take commands in; a stop goes past those that wait, and what moves among them is dropped.

        Nobody is waited for here but a client's own earlier stops, or a stop would be heard late: a client
        with too many commands waiting is answered those, and let go; until then only its stops are heard.
        """
        first, surplus = b"", False
        commands, allowance, room = Commands(), Allowance(), asyncio.Semaphore(STOPS_AT_ONCE)
        with contextlib.suppress(OSError):
            while data := await reader.read(AT_ONCE_BYTES):
                client.heard()
                if len(first) < _FIRST_BYTES:
                    first += data[:_FIRST_BYTES]
                    if is_http(first):
                        _log.warning("%s: a web browser sent a request to the LX200 port", self._id)
                        break
                # an order that came before a stop in the same write is dropped by it, and never begun
                came: list[Waiting] = []
                async for part in self._turns.each(commands.parts(data)):
                    for command in part:
                        if command in _STOPS_ONE_WAY and client.moves(side := command[2:3].decode()):
                            # at once; and once more in its turn, if the key itself still waits
                            self._begin(client.release(side), client)
                        elif self._is_stop(command):
                            await self._begin_stop(client, room)
                        # what was cut off before a stop is refused in its turn
                        if command != _STOP:
                            came.append((command, client.stops))
                for one in came:
                    if surplus:
                        break
                    try:
                        waiting.put_nowait(one)
                    except asyncio.QueueFull:
                        surplus = True
                        self._begin(waiting.put(None), client)
                await allowance.spend(len(data))
        await waiting.put(None)

    def _is_stop(self, command: bytes) -> bool:
        """Whether a command is a stop, or ends with one behind a command that was cut off."""
        if command.endswith(_STOP):
            return True
        return command.endswith(_STOPS_ONE_WAY) and self._watch.latest.slewing

    async def _begin_stop(self, client: Lx200Client, room: asyncio.Semaphore) -> None:
        client.stops += 1
        await room.acquire()
        # its own task: it is sent though its client goes at once
        self._begin(self._stop(client), client).add_done_callback(lambda _: room.release())

    def _begin(self, work: Coroutine[None, None, None], client: Lx200Client) -> asyncio.Task[None]:
        # LX200 has no word for a stop that failed: the connection ends
        task = begun(work, f"LX200 {self._id}", died=client.died)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _stop(self, client: Lx200Client) -> None:
        try:
            await client.stop()
        except NotTaken as failure:
            _log.error("%s: a stop by LX200 was not sent: %s", self._id, failure)


async def _answer(
    client: Lx200Client, waiting: asyncio.Queue[Waiting | None], turns: Turns, writer: asyncio.StreamWriter
) -> None:
    deaf = False
    while (one := await waiting.get()) is not None:
        # a hundred commands of each client would be one turn of the loop
        await turns.mine()
        answer = await client.answer(*one)
        if answer and not deaf:
            writer.write(answer)
            try:
                async with asyncio.timeout(LONGEST_SILENCE_S):
                    await writer.drain()
            except (OSError, TimeoutError):
                # what it has ordered is carried out all the same
                deaf = True
                writer.transport.abort()


__all__ = ["Lx200Server"]
