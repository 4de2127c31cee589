"""10micron: an LX200 with absolute encoders, read by one line, precise to a tenth of an arcsecond.

What matters of its behavior [10MICRON]:

- it keeps its position without power, so there is no evidence of a power-up and none is needed;
- `:CM#` shifts the whole pointing (or adds a star to its model, as its `:CMCFG` was set: never set here);
- parking, unparking and tracking have no answers: what came of them shows in the status;
- `:hF#` is not sent: only mounts with home sensors know it.
"""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime

from drivers.lx200 import codec, tenmicron_codec
from drivers.lx200.dialect import Ask, Dialect, Handshake, Lacks, Order, Spot, State
from drivers.lx200.fine_angles import degrees_to_fine_text
from drivers.lx200.site_and_time import Writing, read_site
from drivers.lx200.tenmicron_codec import FOLLOWING, MOVING, MountStatus
from mountnav.devices import PierSide

_FIRST_WITH_INFO = (2, 14, 9)


def _as_state(status: MountStatus, side: PierSide | None, *, slewing: bool = False) -> State:
    return State(
        slewing=slewing or status in MOVING,
        tracking=status in FOLLOWING,
        parked=status is MountStatus.PARKED,
        pier_side=side,
    )


async def _one_line(ask: Ask) -> Spot:
    info = await ask.known(tenmicron_codec.INFO)
    if info is None:
        return await _place(ask)
    return Spot(info.ra, info.dec, _as_state(info.status, info.pier_side, slewing=info.slewing))


async def _place(ask: Ask) -> Spot:
    return Spot(await ask(codec.GET_RA), await ask(codec.GET_DEC))


async def _state(ask: Ask) -> State:
    status = await ask.known(tenmicron_codec.STATUS)
    side = await ask.known(tenmicron_codec.PIER_SIDE)
    return State(pier_side=side) if status is None else _as_state(status, side)


async def _read_clock(ask: Ask) -> datetime | None:
    return await ask.known(tenmicron_codec.GET_UTC)


async def _destination_side(ask: Ask) -> PierSide | None:
    side = await ask(tenmicron_codec.DESTINATION_SIDE)
    return None if side is PierSide.UNKNOWN else side


def _for_firmware(dialect: Dialect, handshake: Handshake) -> Dialect:
    """Older firmware has no `:Ginfo#`, or another one under that name."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", handshake.firmware or ""))
    if not numbers or numbers >= _FIRST_WITH_INFO:
        return dialect
    return replace(dialect, place=_place, state=_state)


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    if lacks(tenmicron_codec.INFO):
        dialect = replace(dialect, place=_place, state=_state)
    return replace(
        dialect,
        tells_pier_side=not lacks(tenmicron_codec.PIER_SIDE),
        parks_unread=lacks(tenmicron_codec.STATUS),
    )


def _write_clock(utc: datetime) -> tuple[Order, ...]:
    # in ultra precision it takes hundredths and the ISO date, and answers one character [10MICRON :SC#]
    utc = utc.astimezone(UTC)
    hundredths = utc.microsecond // 10_000
    return (
        codec.taken(b":SG+00.0#", "hours to UTC"),
        codec.taken(utc.strftime(f":SL%H:%M:%S.{hundredths:02d}#").encode(), "local time"),
        codec.taken(utc.strftime(":SC%Y-%m-%d#").encode(), "date"),
    )


_WRITING = Writing(
    latitude=lambda deg: degrees_to_fine_text(deg, 1),
    longitude=lambda deg: degrees_to_fine_text(-deg, 1, digits=3),
)

TENMICRON = Dialect(
    name="10micron",
    caption="10micron",
    recognizes=lambda handshake: (handshake.product or "").lower().startswith("10micron"),
    place=_one_line,
    set_ra=tenmicron_codec.set_ra,
    set_dec=tenmicron_codec.set_dec,
    slew=tenmicron_codec.SLEW,
    sync=tenmicron_codec.SYNC,
    stop=(codec.STOP,),
    prelude=(tenmicron_codec.ULTRA_PRECISION,),
    step_arcsec=tenmicron_codec.RA_STEP_ARCSEC,
    tracking_on=(tenmicron_codec.TRACKING_ON,),
    tracking_off=(tenmicron_codec.TRACKING_OFF,),
    rates=tenmicron_codec.RATES,
    park=(tenmicron_codec.PARK,),
    unpark=(tenmicron_codec.UNPARK,),
    tells_pier_side=True,
    pulse=tenmicron_codec.pulse,
    longest_pulse_ms=tenmicron_codec.LONGEST_PULSE_MS,
    read_clock=_read_clock,
    write_clock=_write_clock,
    read_site=read_site,
    write_site=_WRITING.site,
    destination_side=_destination_side,
    fitted=_for_firmware,
    without=_without,
)
