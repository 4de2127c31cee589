"""What any mount must do: the promises of `mountnav.navigation.devices.Mount`, tried on a real one."""

from __future__ import annotations

import asyncio
import math
from datetime import UTC

from mountnav.errors import BadRequest
from mountnav.navigation.devices import Mount, MountReading, SlewOutcome
from mountnav.sky.coordinates import Apparent, Icrs, utc_now
from mountnav.sky.sphere import displaced, separation_arcsec

__all__ = ["NonConforming", "check_mount"]


class NonConforming(AssertionError):
    """The mount does not do what `mountnav.navigation.devices.Mount` promises."""


async def check_mount(mount: Mount, *, step_deg: float = 1.0) -> None:
    """Check an opened mount: reading, small slew and back, sync and its undoing, stop, wrong kind of place.

    Parameters
    ----------
    mount : Mount
        Opened, at rest, tracking, with `step_deg` of free sky to the south and room to move.
    step_deg : float
        How far the test slew goes.

    Raises
    ------
    NonConforming
        With what was expected and what was found.
    mountnav.errors.DeviceError
        Whatever the mount raises.
    """
    near_arcsec = max(30.0, 2.0 * mount.resolution_arcsec)
    start = await _check_reading(mount)
    away = _north_of(start, -step_deg)
    await _check_slew(mount, away, near_arcsec)
    await _check_slew(mount, start, near_arcsec)
    await _check_sync(mount, near_arcsec)
    await _check_stop(mount, _north_of(start, -step_deg))
    await _check_kind(mount)


def _demand(true: bool, what: str) -> None:
    if not true:
        raise NonConforming(what)


async def _check_reading(mount: Mount) -> Apparent | Icrs:
    before = utc_now()
    reading = await mount.reading()
    after = utc_now()
    _check_kind_of(mount, reading)
    place = reading.place
    _demand(math.isfinite(place.ra_deg) and 0.0 <= place.ra_deg < 360.0, f"right ascension in {place}")
    _demand(math.isfinite(place.dec_deg) and -90.0 <= place.dec_deg <= 90.0, f"declination in {place}")
    _demand(reading.utc.tzinfo is UTC, f"the instant {reading.utc} is not aware UTC")
    _demand(before <= reading.utc <= after, f"the instant {reading.utc} is not between asking and answer")
    _demand(mount.resolution_arcsec > 0.0, f"resolution {mount.resolution_arcsec}")
    _demand(bool(mount.name), "the mount has no name")
    return place


def _check_kind_of(mount: Mount, reading: MountReading) -> None:
    kind = Icrs if mount.epoch == "icrs" else Apparent
    _demand(isinstance(reading.place, kind), f"{reading.place} from a mount that speaks {mount.epoch}")


async def _check_slew(mount: Mount, place: Apparent | Icrs, near_arcsec: float) -> None:
    outcome = await mount.slew(place)
    _demand(outcome is SlewOutcome.ARRIVED, f"slew to {place} ended as {outcome}")
    reading = await mount.reading()
    _demand(reading.slewing is not True, "slewing after a slew has ended")
    off_arcsec = _apart_arcsec(reading.place, place)
    _demand(off_arcsec <= near_arcsec, f"slew to {place} ended {off_arcsec:.0f} arcsec away")


async def _check_sync(mount: Mount, near_arcsec: float) -> None:
    before = (await mount.reading()).place
    shifted = _north_of(before, -1.0 / 6.0)
    for place in (shifted, before):
        await mount.sync(place)
        reading = await mount.reading()
        off_arcsec = _apart_arcsec(reading.place, place)
        _demand(off_arcsec <= near_arcsec, f"{off_arcsec:.0f} arcsec off after a sync to {place}")


async def _check_stop(mount: Mount, place: Apparent | Icrs) -> None:
    await mount.stop()
    slew = asyncio.create_task(mount.slew(place))
    # one turn of the loop: the slew has begun to talk, then the stop overtakes it
    await asyncio.sleep(0)
    await mount.stop()
    outcome = await slew
    _demand(outcome is not SlewOutcome.STALLED, "a slew that was stopped says stalled")
    _demand((await mount.reading()).slewing is not True, "slewing after a stop")


async def _check_kind(mount: Mount) -> None:
    wrong = Apparent(0.0, 0.0, utc_now()) if mount.epoch == "icrs" else Icrs(0.0, 0.0)
    try:
        await mount.sync(wrong)
    except (BadRequest, TypeError):
        return
    raise NonConforming(f"a mount that speaks {mount.epoch} took {wrong}")


def _apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


def _north_of(place: Apparent | Icrs, by_deg: float) -> Apparent | Icrs:
    north_arcsec = by_deg * 3600.0
    if isinstance(place, Icrs):
        return displaced(place, 0.0, north_arcsec)
    return displaced(place, 0.0, north_arcsec)
