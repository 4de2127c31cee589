"""Stellarium's telescope server: one telescope's position twice a second, and gotos from anyone who connects.

The protocol has no word for "unknown": while the mount can't be read nobody is connected.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging

from api.access.callers import Caller, Face
from api.listeners.tcp import Allowance
from api.orders.goto_orders import NotTaken
from api.orders.targets import IcrsTarget
from api.orders.watching import Snapshot
from api.planetarium.stellarium_codec import GotoStream, NotStellarium, position_message
from api.planetarium.telescope_server import AT_ONCE_BYTES, LONGEST_SILENCE_S, OneTelescopeServer
from api.service import Service
from mountnav.settings.faces import StellariumSettings
from mountnav.tasks import Crew, waited_for

_log = logging.getLogger(__name__)

_PERIOD_S = 0.5
"""Longest time between two positions, s, as Stellarium's own servers send them. Doubled, its reticle moves
in jumps."""


class StellariumServer(OneTelescopeServer):
    """Serves one telescope to Stellarium.

    Parameters
    ----------
    settings : StellariumSettings, optional
        Instead of the service's own.

    Raises
    ------
    BadSettings
        There is no such telescope.
    """

    def __init__(self, service: Service, settings: StellariumSettings | None = None) -> None:
        settings = settings or service.settings.stellarium
        super().__init__(
            service, settings, section="stellarium", name="Stellarium's port", speaks_first=False
        )
        self._gotos: set[asyncio.Task[None]] = set()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername") or ("unknown", 0)
        caller = Caller(f"stellarium {peer[0]}:{peer[1]}", self._role, Face.STELLARIUM, str(peer[0]))
        crew = Crew()
        crew.begin(self._tell(writer), f"{caller.name} is told")
        crew.begin(self._hear(reader, caller), f"{caller.name} is heard")
        try:
            await crew.until_any()
        except NotStellarium as error:
            _log.info("%s is closed: %s", caller.name, error)
        finally:
            await crew.end()
            writer.close()

    async def _tell(self, writer: asyncio.StreamWriter) -> None:
        """Tell the position until the mount is lost."""
        snapshot = self._watch.latest
        while message := _message(snapshot):
            writer.write(message)
            async with asyncio.timeout(LONGEST_SILENCE_S):
                await writer.drain()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_PERIOD_S):
                    await self._watch.next(snapshot.revision)
            snapshot = self._watch.latest

    async def _hear(self, reader: asyncio.StreamReader, caller: Caller) -> None:
        stream, allowance = GotoStream(), Allowance()
        while data := await reader.read(AT_ONCE_BYTES):
            await allowance.spend(len(data))
            gotos = stream.feed(data)
            if gotos:
                # what was clicked last is meant
                place = gotos[-1].place
                target = IcrsTarget(ra_deg=place.ra_deg, dec_deg=place.dec_deg)
                # its own task: it is ordered, or refused and audited, though its client goes at once
                going = waited_for(self._go(caller, target), f"{caller.name} goes")
                self._gotos.add(going)
                going.add_done_callback(self._gotos.discard)
                await asyncio.shield(going)

    async def _go(self, caller: Caller, target: IcrsTarget) -> None:
        try:
            await self._ordering.goto(caller, target)
        except NotTaken as refusal:
            # its protocol has no answer: the log, the audit and the page tell
            _log.warning("%s: a goto from %s was not taken: %s", self._id, caller.name, refusal)


def _message(snapshot: Snapshot) -> bytes | None:
    """The position as a message; None while it isn't known."""
    state = snapshot.state
    if not state.connected or state.icrs is None or state.reading is None:
        return None
    return position_message(state.icrs, state.reading.utc)


__all__ = ["StellariumServer"]
