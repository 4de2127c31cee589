"""One LX200 app: its half targets, clock and site, its commands and their answers.

A target is a pair of halves, and a half that was refused leaves none. SkySafari may open a connection for
each command, so the target is kept for its machine for a while; a connection that set a target itself means
that one. The format is each connection's own, long at first. The app is sent our clock and site; what it
sends of them is compared, never taken.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import datetime, time, timedelta
from typing import Literal

from api.access.callers import Caller
from api.orders.goto_orders import GotoOrders, NotTaken
from api.orders.targets import ApparentTarget
from api.orders.vocabulary import LONGEST_PULSE_S, GuideOrder, ParkOrder, UnparkOrder
from api.orders.watching import Snapshot, Watch, apparent_place
from api.planetarium import lx200_codec
from api.planetarium.lx200_codec import app_declination, app_right_ascension
from api.planetarium.lx200_keys import Lx200Keys, Pad
from drivers.lx200.codec.angles import (
    dec_from_text,
    dec_to_text,
    longitude_from_text,
    longitude_to_text,
    ra_from_text,
    ra_to_text,
)
from drivers.lx200.codec.site_and_time import date_from_text, hours_to_utc_from_text, time_from_text
from drivers.wire.command import Unreadable
from mountnav import __version__
from mountnav.clock import utc_now
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Apparent, Site
from mountnav.tasks import Died, begun

__all__ = ["Aim", "Aims", "Half", "Lx200Client", "Machine", "MountLost", "SiteAndClock"]


Half = Literal["r", "d"]
_READERS: dict[Half, Callable[[bytes], float]] = {
    "r": lambda wire: ra_from_text(app_right_ascension(wire)).deg,
    "d": lambda wire: dec_from_text(app_declination(wire)).deg,
}
_TOGETHER = timedelta(seconds=30)
"""Halves that were set further apart are of two targets: a place between them was never meant."""


@dataclass(frozen=True, slots=True)
class _Set:
    deg: float
    utc: datetime


class Aim:
    """A target, of date.

    Parameters
    ----------
    lives : timedelta or None
        How long it counts; None: until another one is set, as on a real mount.
    """

    def __init__(self, lives: timedelta | None = None) -> None:
        self._lives = lives
        self._halves: dict[Half, _Set] = {}

    def set(self, half: Half, wire: bytes) -> None:
        """Take ``:Sr`` or ``:Sd``.

        Raises
        ------
        Unreadable
            It is none; what was set of that half before is forgotten, or an app that doesn't look at the
            answer would be sent to one target's right ascension and another's declination.
        """
        self._halves.pop(half, None)
        self._halves[half] = _Set(_READERS[half](wire), utc_now())

    def target(self) -> ApparentTarget | None:
        """Both halves, if they are of one target that counts still."""
        ra, dec = self._halves.get("r"), self._halves.get("d")
        if ra is None or dec is None or abs(ra.utc - dec.utc) > _TOGETHER:
            return None
        if self._lives is not None and utc_now() - min(ra.utc, dec.utc) > self._lives:
            return None
        return ApparentTarget(ra_deg=ra.deg % 360.0, dec_deg=dec.deg)


@dataclass(slots=True)
class Machine:
    """What is kept for the programs of one machine: some open a connection for each command.

    Attributes
    ----------
    hours_to_utc : float or None
        Its zone, as told.
    pad : Pad
        Its keys.
    """

    aim: Aim = field(default_factory=lambda: Aim(_TOGETHER))
    hours_to_utc: float | None = None
    pad: Pad = field(default_factory=Pad)


@dataclass(slots=True)
class Aims:
    """The target of one connection: its own, else its machine's."""

    machine: Machine
    own: Aim = field(default_factory=Aim)
    spoiled: bool = False
    """A half was refused: another program's target is not what was meant."""

    def set(self, half: Half, wire: bytes) -> None:
        """Take ``:Sr`` or ``:Sd``. Raises `Unreadable`; then there is no target."""
        refused: Unreadable | None = None
        for aim in (self.own, self.machine.aim):
            try:
                aim.set(half, wire)
            except Unreadable as error:
                refused = error
        if refused is not None:
            self.spoiled = True
            raise refused
        self.spoiled = self.spoiled and self.own.target() is None

    def target(self) -> ApparentTarget | None:
        """Where this connection wants to go."""
        own = self.own.target()
        return own if own is not None or self.spoiled else self.machine.aim.target()


_SAME_PLACE_DEG = 0.1
"""An app's site this near to ours counts as the same, deg: it sends whole arcminutes. Doubled, 20 km off
goes without a word."""
_BUILT = {"VD": b"Jan 01 2026", "VT": b"00:00:00"}
"""Some clients wait for a date of the firmware: a form of words, as no firmware is here."""


class SiteAndClock:
    """What is the same wherever the mount points.

    Parameters
    ----------
    machine : Machine
        Of the app: it has a zone of its own.
    """

    def __init__(self, site: Site, machine: Machine) -> None:
        self._site = site
        self._machine = machine

    def answers(self) -> dict[str, Callable[[], bytes]]:
        """What ``:G…`` is answered, by its letters, without the ``#``."""
        site = self._site
        return {
            "S": lambda: lx200_codec.sidereal_text(sidereal_time_deg(utc_now(), site)),
            "L": lambda: self._local().strftime("%H:%M:%S").encode(),
            "a": lambda: self._local().strftime("%I:%M:%S").encode(),
            "C": lambda: self._local().strftime("%m/%d/%y").encode(),
            "G": lambda: lx200_codec.zone_text(self._hours_to_utc()),
            "c": lambda: b"24",
            "t": lambda: dec_to_text(site.latitude_deg, short=True),
            "g": lambda: longitude_to_text(site.longitude_deg),
            "T": lambda: b"60.1",
            "M": lambda: b"mountnav",
            "VP": lambda: b"mountnav",
            "VN": lambda: __version__.encode(),
            "VF": lambda: b"mountnav|" + __version__.encode(),
            "VD": lambda: _BUILT["VD"],
            "VT": lambda: _BUILT["VT"],
        }

    def compare(self, what: str, wire: bytes) -> bytes:
        """``1`` if what an app says of site and time is so, else ``0``.

        Raises
        ------
        Unreadable, ValueError
            It makes no sense.
        """
        if what == "C":
            return lx200_codec.UPDATING if self._is_today(date_from_text(wire)) else b"0"
        return b"1" if self._is_so(what, wire) else b"0"

    def _is_so(self, what: str, wire: bytes) -> bool:
        if what == "t":
            return (
                abs(dec_from_text(lx200_codec.plain_angle(wire)).deg - self._site.latitude_deg)
                < _SAME_PLACE_DEG
            )
        if what == "g":
            off_deg = longitude_from_text(lx200_codec.plain_angle(wire)) - self._site.longitude_deg
            return abs((off_deg + 180.0) % 360.0 - 180.0) < _SAME_PLACE_DEG
        if what == "G":
            # the app's own zone, in which it is answered from now on: nothing of the mount's
            self._machine.hours_to_utc = hours_to_utc_from_text(wire)
            return True
        if what == "L":
            at: time = time_from_text(wire)
            told = timedelta(hours=at.hour, minutes=at.minute, seconds=at.second)
            return lx200_codec.is_that_time(told, utc_now(), self._machine.hours_to_utc)
        return False

    def _is_today(self, told: object) -> bool:
        """Whether a local date is ours; a day more or less where the zone isn't known."""
        slack = timedelta(0) if self._machine.hours_to_utc is not None else timedelta(hours=14)
        local = self._local()
        return told in ((local - slack).date(), local.date(), (local + slack).date())

    def _hours_to_utc(self) -> float:
        if self._machine.hours_to_utc is not None:
            return self._machine.hours_to_utc
        offset = utc_now().astimezone().utcoffset() or timedelta(0)
        return -offset.total_seconds() / 3600.0

    def _local(self) -> datetime:
        return utc_now() - timedelta(hours=self._hours_to_utc())


_log = logging.getLogger(__name__)

_SYNC_ANSWERED_S = 5.0
"""How long an app's sync waits for its end before it is answered as taken, s; chosen by hand. Halved, more
refusals of slow mounts are only logged."""
_BELOW = frozenset({"altitude", "horizon", "below-horizon"})
_DROPPED = {"MS": b"2A stop came first#", "CM": b"Not synced: a stop came first#"}
_PULSE = re.compile(r"Mg([nsew])(\d{1,5})")
_KEY = re.compile(r"([MQ])([nsew])")
_SPEED = re.compile(r"R([GCMS])\d?")
_IGNORED = re.compile(r"T[QLSM]|H|AP|AA|AL|F.*|B.*")
"""Taken without a word, as the protocol has it, and nothing moves: modes, focusers."""


class MountLost(Exception):
    """The mount can't be read: LX200 has no word for that, so the connection ends."""


class Lx200Client:
    """One connection.

    Parameters
    ----------
    machine : Machine
        The app's.
    letter : bytes
        What ACK is answered: how the mount stands.
    keys : Lx200Keys
        Moves axes.
    died : callable
        Told of a fault in what goes on beside the answers: LX200 has no word for it, so the connection ends.
    """

    def __init__(
        self,
        caller: Caller,
        watch: Watch,
        ordering: GotoOrders,
        site: Site,
        machine: Machine,
        letter: bytes,
        keys: Lx200Keys,
        *,
        died: Died,
    ) -> None:
        self.died = died
        self.stops = 0
        """How many stops were heard: orders that were heard before one and wait are dropped."""
        self._caller = caller
        self._watch = watch
        self._ordering = ordering
        self._here = SiteAndClock(site, machine)
        self._aims = Aims(machine)
        self._letter = letter
        self._keys, self._pad = keys, machine.pad
        self._short = False
        self._pulses: set[asyncio.Task[None]] = set()

    async def stop(self) -> None:
        """Stop all motion now. Raises `NotTaken`."""
        self._keys.stopped()
        await self._ordering.stop(self._caller)

    def heard(self) -> None:
        """Take in that something came: what its machine's keys move goes on."""
        self._pad.heard()

    def moves(self, side: str) -> bool:
        """Whether a key of that side, or its opposite, moves an axis."""
        return self._keys.moves(side)

    async def release(self, side: str) -> None:
        """End what a key moves, at once."""
        await self._keys.release(self._caller, side)

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
        if command == lx200_codec.ACK:
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
        if (key := _KEY.fullmatch(text)) is not None:
            if key[1] == "Q":
                await self._keys.release(self._caller, key[2])
            elif stops == self.stops:
                await self._keys.press(self._caller, self._pad, key[2])
            return b""
        if (speed := _SPEED.fullmatch(text)) is not None:
            self._pad.choose(speed[1])
            return b""
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
            return lx200_codec.SLEWING if self._watch.latest.slewing else lx200_codec.AT_REST
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
            "A": lambda: lx200_codec.altitude_text(self._height()[0], short=short),
            "Z": lambda: lx200_codec.azimuth_text(self._height()[1], short=short),
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
            return code + lx200_codec.words(refusal.problem.detail) + b"#"
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
            return b"Not synced: " + lx200_codec.words(refusal.problem.detail) + b"#"
        return lx200_codec.MATCHED

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
        if duration_ms > 1000 * LONGEST_PULSE_S:
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
