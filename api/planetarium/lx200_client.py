"""What an app says in LX200, and what it is answered: one connection, or a burst of them from one machine.

SkySafari may open a connection for each command, so the target is kept for its machine for a while; a
connection that set a target itself means that one. The format is each connection's own, long at first.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable

from api.access.callers import Caller
from api.orders.orders import GuideOrder, ParkOrder, UnparkOrder
from api.orders.targets import ApparentTarget
from api.orders.watching import Snapshot, Watch
from api.planetarium import lx200_words
from api.planetarium.lx200_here import Here
from api.planetarium.lx200_machine import Aims, Machine
from api.planetarium.ordering import NotTaken, Ordering
from api.planetarium.place_now import apparent_place
from drivers.lx200.angles import dec_to_text, ra_to_text
from drivers.wire.command import Unreadable
from mountnav.sky.coordinates import Apparent, Site
from mountnav.tasks import Died, begun

_log = logging.getLogger(__name__)

_SYNC_ANSWERED_S = 5.0
_BELOW = frozenset({"altitude", "horizon", "below-horizon"})
_DROPPED = {"MS": b"2A stop came first#", "CM": b"Not synced: a stop came first#"}
_PULSE = re.compile(r"Mg([nsew])(\d{1,5})")
_LONGEST_PULSE_MS = 60_000
_IGNORED = re.compile(r"M[nsew]|Q[nsew]|R[GCMS]\d?|T[QLSM]|H|AP|AA|AL|F.*|B.*")
"""Taken without a word, as the protocol has it, and nothing moves: buttons, rates, modes, focusers."""


class MountLost(Exception):
    """The mount can't be read: LX200 has no word for that, so the connection ends."""


class Lx200Client:
    """One connection.

    Parameters
    ----------
    caller : Caller
    watch : Watch
    ordering : Ordering
    site : Site
    machine : Machine
        The app's.
    letter : bytes
        What ACK is answered: how the mount stands.
    died : callable
        Told of a fault in what goes on beside the answers: LX200 has no word for it, so the connection ends.
    """

    def __init__(
        self,
        caller: Caller,
        watch: Watch,
        ordering: Ordering,
        site: Site,
        machine: Machine,
        letter: bytes,
        *,
        died: Died,
    ) -> None:
        self.died = died
        self.stops = 0
        """How many stops were heard: orders that were heard before one and wait are dropped."""
        self._caller = caller
        self._watch = watch
        self._ordering = ordering
        self._here = Here(site, machine)
        self._aims = Aims(machine)
        self._letter = letter
        self._short = False
        self._pulses: set[asyncio.Task[None]] = set()

    async def stop(self) -> None:
        """Stop all motion now. Raises `NotTaken`."""
        await self._ordering.stop(self._caller)

    async def answer(self, command: bytes, stops: int = 0) -> bytes:
        """Carry a command out, and answer; b"" where the protocol has none, or the command is unknown.

        Parameters
        ----------
        command : bytes
            ACK, or ``:...#``.
        stops : int
            How many stops had come when it was heard.

        Raises
        ------
        MountLost
            The answer isn't known.
        """
        if command == lx200_words.ACK:
            return self._letter
        text = command[1:-1].decode("latin-1")
        orders: dict[str, Callable[[], Awaitable[bytes]]] = {
            "MS": self._slew,
            "CM": self._sync,
            "CMR": self._sync,
            "hP": lambda: self._quietly(ParkOrder()),
            "KA": lambda: self._quietly(ParkOrder()),
            "PO": lambda: self._quietly(UnparkOrder()),
            "hW": lambda: self._quietly(UnparkOrder()),
        }
        if text in orders:
            return _DROPPED.get(text, b"") if stops != self.stops else await orders[text]()
        if (pulse := _PULSE.fullmatch(text)) is not None:
            return self._guide(pulse[1], int(pulse[2]) if stops == self.stops else 0)
        if _IGNORED.fullmatch(text):
            return b""
        if text[:1] == "S":
            try:
                return self._set(text[1:2], command[3:-1].strip())
            except (Unreadable, ValueError):
                return b"0"
        return self._told(text)

    # -- questions -----------------------------------------------------------------------------------

    def _told(self, text: str) -> bytes:
        if text == "U":
            self._short = not self._short
            return b""
        if text == "D":
            return lx200_words.SLEWING if self._watch.latest.slewing else lx200_words.AT_REST
        if text == "P":
            return b"LOW  PRECISION"
        if text == "MA":
            # to altitude and azimuth: not offered
            return b"1"
        if text[:1] != "G":
            return b""
        ask = {**self._of_the_sky(), **self._here.answers()}
        return ask[text[1:]]() + b"#" if text[1:] in ask else b""

    def _of_the_sky(self) -> dict[str, Callable[[], bytes]]:
        short = self._short
        return {
            "R": lambda: ra_to_text(self._place().ra_deg, short=short),
            "D": lambda: dec_to_text(self._place().dec_deg, short=short),
            "r": lambda: ra_to_text(self._target_or_place().ra_deg, short=short),
            "d": lambda: dec_to_text(self._target_or_place().dec_deg, short=short),
            "A": lambda: lx200_words.altitude_text(self._height()[0], short=short),
            "Z": lambda: lx200_words.azimuth_text(self._height()[1], short=short),
            "W": self._status,
        }

    def _seen(self) -> Snapshot:
        snapshot = self._watch.latest
        if not snapshot.state.connected or snapshot.state.reading is None:
            raise MountLost(snapshot.state.problem or "the mount can't be read")
        return snapshot

    def _place(self) -> Apparent:
        place = apparent_place(self._seen())
        if place is None:
            raise MountLost("the mount can't be read")
        return place

    def _target_or_place(self) -> Apparent | ApparentTarget:
        return self._aims.target() or self._place()

    def _height(self) -> tuple[float, float]:
        state = self._seen().state
        if state.altitude_deg is None or state.azimuth_deg is None:
            raise MountLost("the mount can't be read")
        return state.altitude_deg, state.azimuth_deg

    def _status(self) -> bytes:
        """Mounting, tracking, aligned [LX200 :GW#]."""
        reading = self._seen().state.reading
        tracking = reading is not None and reading.tracking is not False
        return self._letter + (b"T" if tracking else b"N") + b"1"

    # -- what it sets --------------------------------------------------------------------------------

    def _set(self, what: str, wire: bytes) -> bytes:
        """Take a target, or compare what it says of here: ``1``, else ``0``.

        Raises
        ------
        Unreadable, ValueError
            It makes no sense.
        """
        if what in ("r", "d"):
            self._aims.set("r" if what == "r" else "d", wire)
            return b"1"
        return self._here.compare(what, wire)

    # -- orders --------------------------------------------------------------------------------------

    async def _slew(self) -> bytes:
        target = self._aims.target()
        if target is None:
            return b"2No target was set#"
        try:
            await self._ordering.goto(self._caller, target)
        except NotTaken as refusal:
            code = b"1" if _BELOW.intersection(refusal.reasons) else b"2"
            return code + lx200_words.words(refusal.problem.detail) + b"#"
        return b"0"

    async def _sync(self) -> bytes:
        target = self._aims.target()
        if target is None:
            return b"Not synced: no target was set#"
        syncing = begun(self._synced(target), "LX200 sync", died=self.died)
        try:
            async with asyncio.timeout(_SYNC_ANSWERED_S):
                refusal = await asyncio.shield(syncing)
        except TimeoutError:
            # its end is in the journal; the app must not wait longer
            return b"Not synced yet#"
        if refusal is not None:
            return b"Not synced: " + lx200_words.words(refusal.problem.detail) + b"#"
        return lx200_words.MATCHED

    async def _synced(self, target: ApparentTarget) -> NotTaken | None:
        """Sync, and return why it was not taken: an answer, or too late for one, and no fault of ours."""
        try:
            await self._ordering.sync(self._caller, target)
        except NotTaken as refusal:
            return refusal
        return None

    async def _quietly(self, order: ParkOrder | UnparkOrder) -> bytes:
        try:
            await self._ordering.long(self._caller, order)
        except NotTaken:
            # there is no answer to it: the audit has it, and the app sees that nothing moves
            return b""
        return b""

    def _guide(self, direction: str, duration_ms: int) -> bytes:
        if duration_ms > _LONGEST_PULSE_MS:
            _log.info("%s: a guide pulse of %d ms is too long: not taken", self._caller.name, duration_ms)
        elif duration_ms > 0:
            order = GuideOrder.model_validate({"direction": direction, "duration_s": duration_ms / 1000.0})
            task = begun(self._pulse(order), "LX200 pulse", died=self.died)
            self._pulses.add(task)
            task.add_done_callback(self._pulses.discard)
        return b""

    async def _pulse(self, order: GuideOrder) -> None:
        try:
            await self._ordering.short(self._caller, order)
        except NotTaken:
            # as above
            return


__all__ = ["Lx200Client", "Machine", "MountLost"]
