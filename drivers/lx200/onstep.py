"""OnStep and OnStepX: an LX200 that tells all of itself in one word, refuses with reasons, and reads finely.

What matters of its behavior [ONSTEP]:

- switched on it believes to be at its home, doesn't track, and refuses gotos until date and time are set;
- a parked one keeps its position when it is switched off; a sync on the other side of the pier is refused;
- `:MS#` during a goto is refused *and* ends that goto; so is `:hC#`;
- `:hF#` declares the present place to be the home: never sent;
- `:MN#` flips: in the codec, sent by nobody unless asked.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.lx200 import codec, onstep_codec
from drivers.lx200.angles import dec_from_text, longitude_from_text
from drivers.lx200.dialect import Ask, Dialect, Handshake, Lacks, Spot, State
from drivers.lx200.fine_angles import degrees_to_fine_text
from drivers.lx200.meade import BASIC
from drivers.lx200.onstep_codec import Status
from drivers.lx200.replies import of_text
from drivers.lx200.site_and_time import Writing, read_clock, read_site
from drivers.wire.command import Command
from mountnav.devices import PierSide
from mountnav.sky.coordinates import Site

GET_FINE_LATITUDE: Command[float] = Command(
    b":GtH#", "latitude", of_text(lambda wire: dec_from_text(wire).deg)
)
GET_FINE_LONGITUDE: Command[float] = Command(b":GgH#", "longitude", of_text(longitude_from_text))


async def _place(ask: Ask) -> Spot:
    ra = await ask.known(onstep_codec.GET_FINE_RA)
    dec = await ask.known(onstep_codec.GET_FINE_DEC)
    # the coarse words are those of any LX200: without them there is no place
    return Spot(
        await ask(codec.GET_RA) if ra is None else ra, await ask(codec.GET_DEC) if dec is None else dec
    )


async def _status(ask: Ask) -> Status | None:
    """Ask once; twice for what one flipped bit can make of the usual answer: `N` and `n`, `p` and `P`."""
    status = await ask.known(onstep_codec.STATUS)
    if status is None:
        return None
    if status.slewing or status.parked or status.parking or status.park_failed or status.homing:
        again = await ask(onstep_codec.STATUS)
        if again != status:
            return await ask(onstep_codec.STATUS)
    return status


async def _state(ask: Ask) -> State:
    status = await _status(ask)
    if status is None:
        return State()
    fresh = False
    if status.at_home and not status.tracking and not status.parked and not status.slewing:
        # where it wakes up; one with a clock of its own knows the time at once, see `_woke_up`
        fresh = bool(await ask.known(onstep_codec.CLOCK_UNSET))
    return State(
        slewing=status.slewing or status.homing or status.parking,
        tracking=status.tracking,
        parked=status.parked,
        at_home=status.at_home,
        pier_side=status.pier_side,
        fresh=fresh,
    )


async def _woke_up(ask: Ask) -> bool:
    """Whether it stands as after power-up; one that was sent home stands so, too."""
    status = await _status(ask)
    if status is None:
        return False
    return status.at_home and not status.tracking and not status.parked and not status.slewing


async def _read_site(ask: Ask) -> Site | None:
    latitude_deg = await ask.known(GET_FINE_LATITUDE)
    longitude_deg = await ask.known(GET_FINE_LONGITUDE)
    if latitude_deg is None or longitude_deg is None:
        return await read_site(ask)
    return Site(latitude_deg, longitude_deg)


async def _guiding(ask: Ask) -> bool:
    status = await ask.known(onstep_codec.STATUS)
    return status is not None and status.guiding


async def _guide_rate_deg_s(ask: Ask) -> float | None:
    return await ask.known(onstep_codec.GUIDE_RATE_DEG_S)


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    """What reads coarsely is written coarsely; what doesn't tell its status tells no side and no park."""
    if lacks(onstep_codec.GET_FINE_RA, onstep_codec.GET_FINE_DEC):
        dialect = replace(dialect, set_ra=codec.set_ra, set_dec=codec.set_dec, step_arcsec=BASIC.step_arcsec)
    if lacks(onstep_codec.STATUS):
        dialect = replace(dialect, tells_pier_side=False, parks_unread=True)
    return dialect


async def _destination_side(ask: Ask) -> PierSide | None:
    side = await ask(onstep_codec.DESTINATION_SIDE)
    return None if side is PierSide.UNKNOWN else side


def _west_positive(longitude_deg: float) -> bytes:
    # east may be negative; the bare form 0..360 is taken by old firmware, too [ONSTEP :Sg#]
    return degrees_to_fine_text(-longitude_deg % 360.0, 2, digits=3)[1:]


_WRITING = Writing(
    zone=b":SG+00:00#",
    date_answers_bare=True,
    latitude=lambda deg: degrees_to_fine_text(deg, 2),
    longitude=_west_positive,
)


def _is_onstep(handshake: Handshake) -> bool:
    return (handshake.product or "").lower().replace("-", "").startswith("onstep")


ONSTEP = Dialect(
    name="onstep",
    caption="OnStep",
    recognizes=_is_onstep,
    place=_place,
    state=_state,
    set_ra=onstep_codec.set_ra,
    set_dec=onstep_codec.set_dec,
    slew=onstep_codec.SLEW,
    sync=onstep_codec.SYNC,
    stop=(codec.STOP,),
    step_arcsec=onstep_codec.FINE_STEP_ARCSEC,
    tracks_before_slew=True,
    tracking_on=(onstep_codec.TRACKING_ON,),
    tracking_off=(onstep_codec.TRACKING_OFF,),
    rates=onstep_codec.RATES,
    park=(onstep_codec.PARK,),
    unpark=(onstep_codec.UNPARK,),
    home=(onstep_codec.HOME,),
    set_park=(onstep_codec.SET_PARK,),
    tells_pier_side=True,
    pulse=onstep_codec.pulse,
    guiding=_guiding,
    read_guide_rate=_guide_rate_deg_s,
    longest_pulse_ms=onstep_codec.LONGEST_PULSE_MS,
    read_clock=read_clock,
    write_clock=_WRITING.clock,
    read_site=_read_site,
    write_site=_WRITING.site,
    destination_side=_destination_side,
    fresh=_woke_up,
    asked_sometimes=(onstep_codec.CLOCK_UNSET,),
    without=_without,
)
