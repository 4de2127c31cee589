"""ZWO AM3, AM5, AM7: OnStep's frame without its fine words, with a park of its own.

What matters of its behavior [ZWO]:

- switched on it believes to be at its home, and refuses gotos until time and site are set;
- `:hC#` goes to the mechanical zero and latches nothing; `:hP#` parks (firmware from 1.1.9), and only `:Spu#`
  releases that; older firmware knows no park: `dialect=am5-old` parks by going home;
- places are read and written to whole seconds: 15″ in right ascension.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.lx200 import am5_codec, codec
from drivers.lx200.am5_codec import ParkState
from drivers.lx200.angles import dec_to_text
from drivers.lx200.dialect import Ask, Dialect, Handshake, Spot, State
from drivers.lx200.site_and_time import Writing, read_clock, read_site


async def _place(ask: Ask) -> Spot:
    return Spot(await ask(codec.GET_RA), await ask(codec.GET_DEC))


async def _old_state(ask: Ask) -> State:
    status = await ask(am5_codec.STATUS)
    return State(
        slewing=status.slewing,
        tracking=await ask(am5_codec.TRACKING),
        at_home=status.at_home,
        pier_side=await ask(am5_codec.PIER_SIDE),
    )


async def _state(ask: Ask) -> State:
    state = await _old_state(ask)
    parking = await ask(am5_codec.PARK_STATE)
    return replace(
        state,
        slewing=state.slewing or parking is ParkState.PARKING,
        parked=parking is ParkState.PARKED,
    )


async def _woke_up(ask: Ask) -> bool:
    """Whether it stands as after power-up; one that was sent home stands so, too."""
    status = await ask(am5_codec.STATUS)
    return status.at_home and not status.slewing and not await ask(am5_codec.TRACKING)


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
    longest_pulse_ms=am5_codec.LONGEST_PULSE_MS,
    read_clock=read_clock,
    write_clock=_WRITING.clock,
    read_site=read_site,
    write_site=_WRITING.site,
    fresh=_woke_up,
)

AM5_OLD = replace(
    AM5,
    name="am5-old",
    caption="ZWO AM with firmware before 1.1.9",
    recognizes=lambda handshake: False,
    state=_old_state,
    park=(am5_codec.HOME,),
    unpark=(am5_codec.TRACKING_ON,),
    parks_unread=True,
)
