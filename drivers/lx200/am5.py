"""ZWO AM3, AM5, AM7: OnStep's frame without its fine words, with a park of its own.

What matters of its behavior [ZWO]:

- switched on it believes to be at its home, and refuses gotos until time and site are set;
- `:hC#` goes to the mechanical zero and latches nothing; `:hP#` parks (firmware from 1.1.9), and only `:Spu#`
  releases that; older firmware knows no park and is parked by going home (`dialect=am5-old` for one that
  tells no version);
- places are read and written to whole seconds: 15″ in right ascension.
"""

from __future__ import annotations

import re
from dataclasses import replace

from drivers.lx200 import am5_codec, codec
from drivers.lx200.am5_codec import ParkState
from drivers.lx200.angles import dec_to_text
from drivers.lx200.dialect import Ask, Dialect, Handshake, Lacks, Spot, State
from drivers.lx200.site_and_time import Writing, read_clock, read_site

_FIRST_WITH_PARK = (1, 1, 9)
"""The firmware that parks [AM5]; older ones home, and tell no state of parking."""


async def _place(ask: Ask) -> Spot:
    return Spot(await ask(codec.GET_RA), await ask(codec.GET_DEC))


async def _old_state(ask: Ask) -> State:
    status = await ask.known(am5_codec.STATUS)
    return State(
        slewing=None if status is None else status.slewing,
        tracking=await ask.known(am5_codec.TRACKING),
        at_home=None if status is None else status.at_home,
        pier_side=await ask.known(am5_codec.PIER_SIDE),
    )


async def _state(ask: Ask) -> State:
    state = await _old_state(ask)
    parking = await ask.known(am5_codec.PARK_STATE)
    return replace(
        state,
        slewing=True if parking is ParkState.PARKING else state.slewing,
        parked=None if parking is None else parking is ParkState.PARKED,
    )


async def _woke_up(ask: Ask) -> bool:
    """Whether it stands as after power-up; one that was sent home stands so, too."""
    status = await ask.known(am5_codec.STATUS)
    if status is None:
        return False
    return status.at_home and not status.slewing and not await ask.known(am5_codec.TRACKING)


def _for_firmware(dialect: Dialect, handshake: Handshake) -> Dialect:
    """Older firmware has no park; one that doesn't tell its version is asked."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", handshake.firmware or ""))
    return _with_old_park(dialect) if numbers and numbers < _FIRST_WITH_PARK else dialect


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    if lacks(am5_codec.PARK_STATE):
        # what knows no `:Gps#` knows no `:hP#` either: both came with 1.1.9
        dialect = _with_old_park(dialect)
    return replace(dialect, tells_pier_side=not lacks(am5_codec.PIER_SIDE))


def _with_old_park(dialect: Dialect) -> Dialect:
    """Parks by going home, released by tracking; that it is parked only we know."""
    return replace(
        dialect,
        state=_old_state,
        park=(am5_codec.HOME,),
        unpark=(am5_codec.TRACKING_ON,),
        parks_unread=True,
    )


async def _guiding(ask: Ask) -> bool:
    status = await ask.known(am5_codec.STATUS)
    return status is not None and status.guiding


def _west_positive(longitude_deg: float) -> bytes:
    west_deg = -longitude_deg
    west_deg -= 360.0 * round(west_deg / 360.0)
    # three digits of degrees and a sign, as INDI's driver writes it [ZWO :Sg#]
    seconds = round(abs(west_deg) * 3600.0)
    sign = b"-" if west_deg < 0 and seconds else b"+"
    return b"%s%03d*%02d:%02d" % (sign, seconds // 3600, seconds // 60 % 60, seconds % 60)


def _is_am(handshake: Handshake) -> bool:
    product = handshake.product or ""
    return product[:2] == "AM" and product[2:3].isdigit()


_WRITING = Writing(zone=b":SG+00:00#", date_answers_bare=True, latitude=dec_to_text, longitude=_west_positive)

AM5 = Dialect(
    name="am5",
    caption="ZWO AM",
    recognizes=_is_am,
    place=_place,
    state=_state,
    set_ra=am5_codec.set_ra,
    set_dec=am5_codec.set_dec,
    slew=am5_codec.SLEW,
    sync=am5_codec.SYNC,
    stop=(codec.STOP,),
    tracks_before_slew=True,
    tracking_on=(am5_codec.TRACKING_ON,),
    tracking_off=(am5_codec.TRACKING_OFF,),
    rates=am5_codec.RATES,
    park=(am5_codec.PARK,),
    unpark=(am5_codec.UNPARK,),
    home=(am5_codec.HOME,),
    tells_pier_side=True,
    pulse=am5_codec.pulse,
    guiding=_guiding,
    longest_pulse_ms=am5_codec.LONGEST_PULSE_MS,
    read_clock=read_clock,
    write_clock=_WRITING.clock,
    read_site=read_site,
    write_site=_WRITING.site,
    fresh=_woke_up,
    fitted=_for_firmware,
    without=_without,
)

AM5_OLD = replace(
    _with_old_park(AM5),
    name="am5-old",
    caption="ZWO AM with firmware before 1.1.9",
    recognizes=lambda handshake: False,
)
