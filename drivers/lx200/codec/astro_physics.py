"""Astro-Physics GTO controllers: a space after each setter, recalibration, a status line.

From the maker's command protocol and its status table [AP protocol, :GOS#]; not tried on a real mount. It
answers neither ACK nor :GVP#, so its dialect has to be named: ``?dialect=ap``. After power-up it knows
nothing and says that it looks at 0 h until it was unparked or calibrated.
"""

from __future__ import annotations

import re
from dataclasses import replace

from drivers.lx200.codec import base
from drivers.lx200.codec.angles import dec_to_text, ra_to_text
from drivers.lx200.codec.base import Answer, of_text, words_but_no_place
from drivers.lx200.codec.dialect import Ask, Dialect, Lacks, State
from drivers.lx200.codec.meade import BASIC
from drivers.lx200.codec.rates import OffsetWords
from drivers.lx200.codec.site_and_time import Writing, read_clock, read_site
from drivers.wire.command import Command, Unreadable
from mountnav.devices import Direction, OffsetRates, PierSide, TrackingRate
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S

LONGEST_PULSE_MS = 999
"""A pulse has three digits [AP protocol :Mn]."""
# park, RA rate, Dec rate, slewing, RA motion, Dec motion; the rest is of no use here
_STATUS = re.compile(rb"([P01])([0-9C])([0-9C])([S0])([EW0])([NS0])[ -~]{5,}")
_UNSET_RA = (b"00:00.0", b"00:00:00.0", b"00:00:00")


def _status(wire: bytes) -> State:
    match = _STATUS.fullmatch(wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not a status")
    moving = match[4] == b"S" or match[5] != b"0" or match[6] != b"0"
    return State(slewing=moving, tracking=match[2] != b"9", parked=match[1] == b"P")


def _side(wire: bytes) -> PierSide:
    sides = {b"East": PierSide.EAST, b"West": PierSide.WEST}
    if wire not in sides:
        raise Unreadable(f"{wire!r} is not a side")
    return sides[wire]


def _synced(wire: bytes) -> Answer:
    words_but_no_place(wire)
    return Answer()


def _never_calibrated(wire: bytes) -> bool:
    return wire in _UNSET_RA


STATUS: Command[State] = Command(b":GOS#", "status", of_text(_status))
SIDE: Command[PierSide] = Command(b":pS#", "side of the pier", of_text(_side))
RAW_RA: Command[bool] = Command(b":GR#", "whether it was calibrated", of_text(_never_calibrated))


async def _state(ask: Ask) -> State:
    state = await ask.known(STATUS) or State()
    return replace(state, pier_side=await ask.known(SIDE))


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    return replace(dialect, tells_pier_side=not lacks(SIDE), parks_unread=lacks(STATUS))


async def _was_never_calibrated(ask: Ask) -> bool:
    # 0 h to the last digit; asked at connecting and after troubles only, for a mount may also look there
    return await ask(RAW_RA)


def _set_ra(ra_deg: float, short: bool) -> Command[bool]:
    return base.taken(b":Sr " + ra_to_text(ra_deg, decimals=1) + b"#", "target right ascension")


def _set_dec(dec_deg: float, short: bool) -> Command[bool]:
    return base.taken(b":Sd " + dec_to_text(dec_deg) + b"#", "target declination")


def _pulse(direction: Direction, duration_ms: int) -> Command[None]:
    sent = b":M%s%03d#" % (direction.value.encode(), duration_ms)
    return base.quiet(sent, f"guide {direction.name.lower()} {duration_ms} ms", repeatable=False)


_MOST_OFFSET = 9.9999
"""Times sidereal: one digit before the point, as the document's examples have it; doubled, a second digit may
be cut off."""


def _ra_offset(rates: OffsetRates) -> tuple[Command[bool], ...]:
    """A rate on top of the sidereal one, positive where the mount tracks faster, to the west [AP :RR]."""
    times = -rates.ra_arcsec_s / SIDEREAL_ARCSEC_S
    if not abs(times) <= _MOST_OFFSET:
        raise ValueError(f"a rate of {rates.ra_arcsec_s}″/s can't be told")
    word = f":RR{times:+.4f}#".replace("-0.0000", "+0.0000")
    return (base.taken(word.encode("ascii"), "offset rate in right ascension"),)


OFFSETS = OffsetWords(
    set=_ra_offset,
    most_arcsec_s=OffsetRates(_MOST_OFFSET * SIDEREAL_ARCSEC_S, 0.0),
    step_arcsec_s=1e-4 * SIDEREAL_ARCSEC_S,
    why_one="what a declination rate's sign means on each side of the pier is not certain for this mount",
)
"""`:RD` counts clockwise as seen from above, "equivalent to South" by INDI's notes, which send it as north;
and nothing says what it is after a flip: a wrong sign is worse than no rate [AP protocol :RR :RD]."""

_WRITING = Writing(
    zone=b":SG +00:00:00#",
    latitude=dec_to_text,
    space=b" ",
)

ASTRO_PHYSICS = replace(
    BASIC,
    name="ap",
    caption="Astro-Physics GTO",
    recognizes=lambda handshake: False,
    state=_state,
    without=_without,
    set_ra=_set_ra,
    set_dec=_set_dec,
    # CM takes the present side of the pier for wrong; CMR keeps it, and is what is meant after a solve
    sync=Command(b":CMR#", "recalibrate on target", of_text(_synced), False),
    tracking_on=(base.quiet(b":RT2#", "track the stars"),),
    tracking_off=(base.quiet(b":RT9#", "stop tracking"),),
    rates={
        TrackingRate.SIDEREAL: base.quiet(b":RT2#", "track the stars"),
        TrackingRate.SOLAR: base.quiet(b":RT1#", "track the Sun"),
        TrackingRate.LUNAR: base.quiet(b":RT0#", "track the Moon"),
    },
    park=(base.quiet(b":KA#", "park", repeatable=False),),
    unpark=(base.quiet(b":PO#", "unpark"),),
    tells_pier_side=True,
    pulse=_pulse,
    longest_pulse_ms=LONGEST_PULSE_MS,
    offsets=OFFSETS,
    read_clock=read_clock,
    write_clock=_WRITING.clock,
    read_site=read_site,
    write_site=_WRITING.site,
    fresh=_was_never_calibrated,
    greets=False,
)
