"""What one dialect of LX200 says, and how: a value of commands and hooks, composed, not inherited.

`drivers.lx200.language` knows the order in which these make a reading or an order; a dialect only knows its
words. What a dialect lacks stays None, and the language refuses it as unsupported.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Protocol, TypeVar

from drivers.lx200.codec.angles import WireAngle
from drivers.lx200.codec.base import Answer
from drivers.lx200.codec.rates import MotionKeys, OffsetWords
from drivers.wire.command import Command
from mountnav.devices import Direction, Epoch, PierSide, Skill, TrackingRate
from mountnav.sky.coordinates import Site

T = TypeVar("T")

Order = Command[Answer] | Command[bool] | Command[None]
"""A command that changes something: refused when it answers an `Answer` with a refusal, or False."""


class Ask(Protocol):
    """Puts one question and returns its answer; raises what `drivers.wire.exchange.Exchange.ask` raises."""

    async def __call__(self, command: Command[T], deadline_s: float | None = None) -> T:
        """Send and read; `deadline_s` shorter than usual for what may stay unanswered."""
        ...

    async def known(self, command: Command[T]) -> T | None:
        """Ask what this mount may lack; None where it does. See `OptionalQuestions.known`."""
        ...


@dataclass(frozen=True, slots=True)
class Handshake:
    """What the mount answered to the questions that every dialect bears.

    Attributes
    ----------
    letter : str or None
        To ACK; a Gemini's or an OnStep's own letters too. None when silent.
    ended : bool
        Whether a `#` followed the letter.
    product : str or None
        To ``:GVP#``; None when silent.
    firmware : str or None
        To ``:GVN#``, asked only after a product; None when silent.
    """

    letter: str | None = None
    ended: bool = False
    product: str | None = None
    firmware: str | None = None


@dataclass(frozen=True, slots=True)
class State:
    """What the mount reports of itself besides its place; None where it can't."""

    slewing: bool | None = None
    tracking: bool | None = None
    parked: bool | None = None
    at_home: bool | None = None
    pier_side: PierSide | None = None
    fresh: bool = False


@dataclass(frozen=True, slots=True)
class Pointing:
    """A place as read; `state` when the same answer held it."""

    ra: WireAngle
    dec: WireAngle
    state: State | None = None


@dataclass(frozen=True, slots=True)
class Nudge:
    """Guiding by a motion that we begin and end ourselves: rate, start, our wait, stop [LX200 :Mn#]."""

    rate: tuple[Command[None], ...]
    start: Mapping[Direction, Command[None]]
    stop: Mapping[Direction, Command[None]]


Lacks = Callable[..., bool]
"""Whether one of the commands given is known to be missing."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """One dialect.

    Attributes
    ----------
    name : str
        As in ``?dialect=``.
    caption : str
        In words, for reports.
    recognizes : callable (Handshake) -> bool
        The first dialect of the registry that says True is spoken.
    place : callable (Ask) -> awaitable Pointing
        Asks for the place; nothing else, so that its instant is known.
    state : callable (Ask) -> awaitable State, optional
        Asks for the rest, where `place` didn't read it; with `Ask.known`, since firmware may lack any of it.
    asked_sometimes : tuple of Command
        Questions that `state` asks in some states only: put once at opening, to know whether they exist.
    set_ra, set_dec : callable (deg, short) -> Command of bool
        Take a target; `short` while the mount is in the short format.
    slew, sync : Command of Answer
        To the target.
    stop : tuple of Command of None
        All motion; must leave tracking as it is. Sent in one piece, past everything.
    after_stop : tuple of Order
        Sent by the ordinary way after the first stop, when `stop` can't but end tracking; usually empty.
    prelude : tuple of Order
        Once after recognition, before anything is read: sets forms, never a position, a time or a motion.
    toggle : Command of None, optional
        Sent once to a mount that is found in the short format [LX200 :U#].
    step_arcsec : float
        Coarsest step of a target as it is written here (in the long format).
    silent_refusals : bool
        Whether a slew it won't do is answered like one it will.
    tracks_before_slew : bool
        Whether a slew leaves a mount that doesn't track as it was: then tracking is switched on before.
    tracking_on, tracking_off : tuple of Order
        Empty where it can't.
    park, unpark, home, set_park : tuple of Order
        Empty where it can't. Each is sent once.
    finds_home : bool
        Whether `home` ends at a sensor.
    parks_unread : bool
        Whether `state` doesn't show a parked mount: then parked is what was ordered to park and came to rest.
    tells_pier_side : bool
        Whether `state` (or `place`) does.
    pulse : callable (Direction, milliseconds) -> Order, optional
        A guide pulse that the mount times.
    longest_pulse_ms : int
        Longer ones are sent in pieces.
    read_guide_rate : callable (Ask) -> awaitable float or None, optional
        Of a pulse on either axis (°/s); asked at opening.
    guiding : callable (Ask) -> awaitable bool, optional
        Whether a pulse still runs; asked after the time of each one that the mount times.
    nudge : Nudge, optional
        Where there is no `pulse`.
    offsets : OffsetWords, optional
        Where it can track at rates of its own.
    keys : MotionKeys, optional
        Where its axes can be moved on by hand, at speeds that are known.
    read_clock : callable (Ask) -> awaitable datetime or None, optional
        None: the dialect can't.
    write_clock : callable (utc) -> tuple of Order, optional
        None: the dialect can't.
    read_site : callable (Ask) -> awaitable Site or None, optional
        None: the dialect can't.
    write_site : callable (Site) -> tuple of Order, optional
        None: the dialect can't.
    destination_side : callable (Ask) -> awaitable PierSide or None, optional
        Asked after the target was set; must not move.
    fresh : callable (Ask) -> awaitable bool, optional
        Evidence of a power-up that `state` doesn't carry; asked at opening and after troubles on the line.
    greets : bool
        Whether it may be asked ACK and ``:GVP#``, when it was named.
    boot : callable (Handshake) -> str or None
        In words, when the handshake shows that it is not ready; it counts as fresh then.
    fitted : callable (Dialect, Handshake) -> Dialect
        What product and firmware change in it.
    without : callable (Dialect, Lacks) -> Dialect
        What it is when some of its questions are missing.
    epoch : {"apparent", "icrs"}
        By itself.
    """

    name: str
    caption: str
    recognizes: Callable[[Handshake], bool]
    place: Callable[[Ask], Awaitable[Pointing]]
    set_ra: Callable[[float, bool], Command[bool]]
    set_dec: Callable[[float, bool], Command[bool]]
    slew: Command[Answer]
    sync: Command[Answer]
    stop: tuple[Command[None], ...]
    state: Callable[[Ask], Awaitable[State]] | None = None
    asked_sometimes: tuple[Command[bool], ...] = ()
    after_stop: tuple[Order, ...] = ()
    prelude: tuple[Order, ...] = ()
    toggle: Command[None] | None = None
    step_arcsec: float = 15.0
    silent_refusals: bool = False
    tracks_before_slew: bool = False
    tracking_on: tuple[Order, ...] = ()
    tracking_off: tuple[Order, ...] = ()
    rates: Mapping[TrackingRate, Order] = field(default_factory=dict)
    park: tuple[Order, ...] = ()
    unpark: tuple[Order, ...] = ()
    home: tuple[Order, ...] = ()
    set_park: tuple[Order, ...] = ()
    finds_home: bool = False
    parks_unread: bool = False
    tells_pier_side: bool = False
    pulse: Callable[[Direction, int], Order] | None = None
    longest_pulse_ms: int = 9999
    read_guide_rate: Callable[[Ask], Awaitable[float | None]] | None = None
    guiding: Callable[[Ask], Awaitable[bool]] | None = None
    nudge: Nudge | None = None
    offsets: OffsetWords | None = None
    keys: MotionKeys | None = None
    read_clock: Callable[[Ask], Awaitable[datetime | None]] | None = None
    write_clock: Callable[[datetime], tuple[Order, ...]] | None = None
    read_site: Callable[[Ask], Awaitable[Site | None]] | None = None
    write_site: Callable[[Site], tuple[Order, ...]] | None = None
    destination_side: Callable[[Ask], Awaitable[PierSide | None]] | None = None
    fresh: Callable[[Ask], Awaitable[bool]] | None = None
    greets: bool = True
    boot: Callable[[Handshake], str | None] = lambda handshake: None
    fitted: Callable[[Dialect, Handshake], Dialect] = lambda dialect, handshake: dialect
    without: Callable[[Dialect, Lacks], Dialect] = lambda dialect, lacks: dialect
    epoch: Epoch = "apparent"

    @property
    def skills(self) -> frozenset[Skill]:
        """What follows from the words it has."""
        has = {
            Skill.PARK: self.park,
            Skill.UNPARK: self.unpark,
            Skill.HOME: self.home,
            Skill.FIND_HOME: self.home and self.finds_home,
            Skill.SET_PARK: self.set_park,
            Skill.TRACK: self.tracking_on and self.tracking_off,
            Skill.TRACKING_RATES: self.rates,
            Skill.GUIDE: self.pulse is not None or self.nudge is not None,
            Skill.OFFSET_RATES: self.offsets is not None,
            Skill.MOVE_AXIS: self.keys is not None,
            Skill.PIER_SIDE: self.tells_pier_side,
            Skill.DESTINATION_SIDE: self.destination_side is not None,
            Skill.CLOCK: self.read_clock is not None,
            Skill.SET_CLOCK: self.write_clock is not None,
            Skill.SITE: self.read_site is not None,
            Skill.SET_SITE: self.write_site is not None,
        }
        return frozenset(skill for skill, words in has.items() if words)
