"""Meade's own dialects, and the few words that any clone has.

What the document of 2010 and the classic's manual say of each model stands here; none was tried on a real
mount [Meade Telescope Serial Command Protocol, LX200 manual appendix].
"""

from __future__ import annotations

import re
from dataclasses import replace

from drivers.lx200.codec import base
from drivers.lx200.codec.base import of_text
from drivers.lx200.codec.dialect import Ask, Dialect, Handshake, Lacks, Nudge, Pointing, State
from drivers.lx200.codec.site_and_time import Writing, clock_was_never_set, read_clock, read_site
from drivers.wire.command import Command, Unreadable
from mountnav.devices import TrackingRate

_STATUS = re.compile(rb"([APGL])([TNS])([0-3HP])")
_NEW_GUIDING_FIRMWARE = "31Ee"
_HALT = (base.STOP, *base.STOP_MOVE.values())
_NUDGE = Nudge((base.GUIDE_RATE,), base.START_MOVE, base.STOP_MOVE)


async def spot(ask: Ask) -> Pointing:
    """Right ascension, then declination [LX200 :GR#, :GD#]."""
    return Pointing(await ask(base.GET_RA), await ask(base.GET_DEC))


async def _bars(ask: Ask) -> State:
    return State(slewing=await ask.known(base.SLEWING))


def _status(wire: bytes) -> State:
    """Mounting, tracking, alignment: ``AT1``; 0 has never been aligned since it was switched on."""
    match = _STATUS.fullmatch(wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not an alignment status")
    return State(tracking=match[2] == b"T", fresh=match[3] == b"0")


ALIGNMENT_STATUS: Command[State] = Command(b":GW#", "alignment status", of_text(_status))


async def _gps_state(ask: Ask) -> State:
    state = await ask.known(ALIGNMENT_STATUS) or State()
    return replace(state, slewing=await ask.known(base.SLEWING))


def _without_alignment(dialect: Dialect, lacks: Lacks) -> Dialect:
    """Its power-up shows in its clock then, as a classic's."""
    return replace(dialect, fresh=clock_was_never_set) if lacks(ALIGNMENT_STATUS) else dialect


BASIC = Dialect(
    name="basic",
    caption="LX200 with the few words that any clone has",
    recognizes=lambda handshake: True,
    place=spot,
    set_ra=base.set_ra,
    set_dec=base.set_dec,
    slew=base.SLEW,
    sync=base.SYNC,
    stop=(base.STOP,),
    toggle=base.TOGGLE_PRECISION,
    greets=False,
)

CLASSIC = replace(
    BASIC,
    name="classic",
    caption="Meade LX200 classic",
    # the classic has no product name [LX200 :GVP#]
    recognizes=lambda handshake: handshake.letter in ("P", "A", "L") and handshake.product is None,
    state=_bars,
    stop=_HALT,
    greets=True,
    rates={rate: base.RATES[rate] for rate in (TrackingRate.SIDEREAL, TrackingRate.LUNAR)},
    nudge=_NUDGE,
    read_clock=read_clock,
    write_clock=Writing().clock,
    read_site=read_site,
    write_site=Writing().site,
    fresh=clock_was_never_set,
)


def _with_timed_pulses(dialect: Dialect, handshake: Handshake) -> Dialect:
    """Firmware from 31Ee on times its pulses itself, as its later letters and numbers do."""
    if (handshake.firmware or "") < _NEW_GUIDING_FIRMWARE:
        return dialect
    return replace(dialect, pulse=base.guide_pulse)


AUTOSTAR = replace(
    CLASSIC,
    name="autostar",
    caption="Meade Autostar",
    recognizes=lambda handshake: (
        re.match(r"Autostar|Audiostar|ETX|DS", handshake.product or "", re.IGNORECASE) is not None
    ),
    park=(base.quiet(b":hP#", "park", repeatable=False),),
    parks_unread=True,
    fitted=_with_timed_pulses,
)

GENERIC = replace(
    AUTOSTAR,
    name="generic",
    caption="LX200 clone with Autostar's words",
    recognizes=lambda handshake: handshake.letter is not None and handshake.product is not None,
)

LX200GPS = replace(
    AUTOSTAR,
    name="lx200gps",
    caption="Meade LX200GPS, Autostar II",
    recognizes=lambda handshake: (
        re.match(r"LX2001|LX200 ?GPS|RCX|Autostar II", handshake.product or "", re.IGNORECASE) is not None
    ),
    state=_gps_state,
    without=_without_alignment,
    # it starts again, from the place it was parked at [LX200 :I#]
    unpark=(base.quiet(b":I#", "start again", repeatable=False),),
    pulse=base.guide_pulse,
    fitted=lambda dialect, handshake: dialect,
    fresh=None,
)
