"""What any mount must do: the promises of `mountnav.devices.Mount`, tried on a real one."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable
from datetime import UTC
from typing import Any

from mountnav.clock import utc_now
from mountnav.devices import (
    STARS_RATES,
    Direction,
    Mount,
    MountReading,
    OffsetRates,
    Skill,
    Skilled,
    SlewOutcome,
    Trusts,
)
from mountnav.errors import BadRequest, Busy, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.tasks import waited_for

__all__ = ["NonConforming", "check_mount", "check_skills"]

RATE_ARCSEC_S = 5.0
"""Offset rate that is tried, ″/s, unless the mount takes less. Doubled or halved, nothing shows."""
AXIS_DEG_S = 0.2
"""Speed of an axis that is tried, °/s, or the nearest one. Doubled, it goes twice as far in the try."""
STOP_ON_WIRE_S = 0.1
"""A stop must be on the wire so soon, s, whatever else goes on: at 5°/s that is half a degree. Doubled, a
stop that queues behind a question of 0.15 s would pass."""


class NonConforming(AssertionError):
    """The mount does not do what `mountnav.devices.Mount` promises."""


async def check_mount(mount: Mount, *, step_deg: float = 1.0) -> None:
    """Check an opened mount: reading, small slew and back, sync and its undoing, stop, wrong kind of place.

    A mount that is `Skilled` is also parked and unparked, its tracking switched off and on, told offset
    rates, and moved by its axes, where it says it can; one that `Trusts` must do so after connecting, or be
    trusted before. A mount with a `wire_log` is checked for a stop on the wire within 100 ms.

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
    _demand(
        not isinstance(mount, Trusts) or mount.trusted, "its position doesn't count: nothing can be tried"
    )
    away = _north_of(start, -step_deg)
    await _check_slew(mount, away, near_arcsec)
    await _check_slew(mount, start, near_arcsec)
    await _check_refusal(mount)
    await _check_sync(mount, near_arcsec)
    await _check_stop(mount, _north_of(start, -step_deg))
    await _check_kind(mount)
    if isinstance(mount, Skilled):
        await check_skills(mount)


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
        try:
            result = await mount.sync(place)
        except DeviceRefused as refusal:
            _demand(refusal.reason is Refusal.UNSUPPORTED, f"a sync was refused: {refusal.what}")
            return
        _demand(result.outcome.seen, f"a sync to {place} was not seen: {result.outcome}")
        _demand(result.miss_arcsec <= near_arcsec, f"a sync that was seen misses by {result.miss_arcsec}")
        reading = await mount.reading()
        off_arcsec = _apart_arcsec(reading.place, place)
        _demand(off_arcsec <= near_arcsec, f"{off_arcsec:.0f} arcsec off after a sync to {place}")


async def _check_stop(mount: Mount, place: Apparent | Icrs) -> None:
    await mount.stop()
    slew = waited_for(mount.slew(place))
    # one turn of the loop: the slew has begun to talk, then the stop overtakes it
    await asyncio.sleep(0)
    log: Any = getattr(mount, "wire_log", None)
    noted = 0 if log is None else log.count
    began_s = 0.0 if log is None else log.now_s()
    stop = waited_for(mount.stop())
    await stop
    if log is not None:
        sent = [entry.t_s for entry in log.entries(noted) if entry.way == "driver->mount"]
        _demand(bool(sent), "a stop sent nothing over the wire")
        _demand(sent[0] - began_s < STOP_ON_WIRE_S, f"a stop took {sent[0] - began_s:.3f} s to the wire")
    outcome = await slew
    _demand(outcome is not SlewOutcome.STALLED, "a slew that was stopped says stalled")
    _demand((await mount.reading()).slewing is not True, "slewing after a stop")


async def _check_refusal(mount: Mount) -> None:
    """A place that can't be: the mount says no in words, or doesn't arrive; it never says that it has."""
    reading = await mount.reading()
    south = -89.9 if reading.place.dec_deg > 0.0 else 89.9
    if isinstance(reading.place, Icrs):
        below: Apparent | Icrs = Icrs(reading.place.ra_deg, south)
    else:
        below = Apparent(reading.place.ra_deg, south, utc_now())
    try:
        outcome = await mount.slew(below)
    except DeviceRefused:
        return
    # a mount without a horizon of its own goes there: what it says must be true all the same
    now = (await mount.reading()).place
    off_arcsec = _apart_arcsec(now, below)
    near_arcsec = max(30.0, 2.0 * mount.resolution_arcsec)
    _demand(
        (outcome is SlewOutcome.ARRIVED) == (off_arcsec <= near_arcsec),
        f"{outcome}, {off_arcsec:.0f} arcsec off",
    )
    _demand(await mount.slew(reading.place) is SlewOutcome.ARRIVED, "it does not come back")


async def check_skills(mount: Any) -> None:
    """Check the skills that a mount says it has, and that it refuses the others in words.

    Parameters
    ----------
    mount : Mount and Skilled
        Opened, at rest, tracking.

    Raises
    ------
    NonConforming
        With what was expected and what was found.
    """
    if Skill.TRACK in mount.skills:
        for on in (False, True):
            await mount.set_tracking(on)
            _demand((await mount.reading()).tracking in (on, None), f"tracking is not {on}")
    else:
        await _must_refuse(mount.set_tracking(False), "tracking off")
    if Skill.GUIDE in mount.skills:
        before = (await mount.reading()).place
        for direction in Direction:
            await mount.guide(direction, 0.2)
        off_arcsec = _apart_arcsec((await mount.reading()).place, before)
        _demand(
            off_arcsec <= 30.0 + 2.0 * mount.resolution_arcsec, f"guiding went {off_arcsec:.0f} arcsec off"
        )
    else:
        await _must_refuse(mount.guide(Direction.NORTH, 0.1), "a guide pulse")
    await _check_rates(mount)
    await _check_axes(mount)
    if {Skill.PARK, Skill.UNPARK} <= mount.skills:
        outcome = await mount.park()
        _demand(outcome is SlewOutcome.ARRIVED, f"parking ended as {outcome}")
        reading = await mount.reading()
        _demand(reading.parked is not False, "it says it is not parked after parking")
        if reading.parked:
            await _must_refuse(mount.slew(_north_of(reading.place, -0.5)), "a slew while parked")
        await mount.unpark()
        _demand((await mount.reading()).parked is not True, "it says it is parked after unparking")
    elif Skill.PARK not in mount.skills:
        await _must_refuse(mount.park(), "parking")


async def _check_rates(mount: Any) -> None:
    """Offset rates are taken, told where they can be, ended, and refused where they are too fast."""
    if Skill.OFFSET_RATES not in mount.skills:
        if hasattr(mount, "set_offset_rates"):
            await _must_refuse(mount.set_offset_rates(OffsetRates(1.0, 0.0)), "offset rates")
        return
    most = mount.most_offset_arcsec_s or OffsetRates(RATE_ARCSEC_S, RATE_ARCSEC_S)
    rates = OffsetRates(min(RATE_ARCSEC_S, most.ra_arcsec_s), -min(RATE_ARCSEC_S, most.dec_arcsec_s))
    await mount.set_offset_rates(rates)
    told = await mount.offset_rates()
    step = 0.01 + getattr(mount, "offset_step_arcsec_s", 0.0)
    _demand(
        told is None
        or max(abs(told.ra_arcsec_s - rates.ra_arcsec_s), abs(told.dec_arcsec_s - rates.dec_arcsec_s))
        <= step,
        f"ordered {rates}, it says {told}",
    )
    if mount.most_offset_arcsec_s is not None:
        fast = OffsetRates(2.0 * most.ra_arcsec_s + 1.0, 0.0)
        await _must_refuse(mount.set_offset_rates(fast), "a rate that is too fast", bad_too=True)
    await mount.set_offset_rates(STARS_RATES)
    told = await mount.offset_rates()
    _demand(
        told is None or max(abs(told.ra_arcsec_s), abs(told.dec_arcsec_s)) <= step, f"ended, it says {told}"
    )


async def _check_axes(mount: Any) -> None:
    """An axis moves until it is told to end; meanwhile nothing else begins, and a stop ends it too."""
    if Skill.MOVE_AXIS not in mount.skills:
        if hasattr(mount, "move_axis"):
            await _must_refuse(mount.move_axis("primary", 0.1), "a moved axis")
        return
    for axis, spans in mount.axis_rates_deg_s.items():
        speeds = [min(max(AXIS_DEG_S, span.least_deg_s), span.most_deg_s) for span in spans]
        speed = min(speeds, key=lambda one: abs(one - AXIS_DEG_S), default=0.0)
        if not 0.0 < speed <= 1.0:
            continue
        place = (await mount.reading()).place
        await mount.move_axis(axis, -speed)
        try:
            await mount.slew(place)
        except Busy:
            pass
        else:
            raise NonConforming(f"it was slewed while its {axis} axis was moved")
        await mount.move_axis(axis, 0.0)
        await mount.move_axis(axis, speed)
        await mount.stop()
        before = await mount.reading()
        await asyncio.sleep(0.5)
        moved_arcsec = _apart_arcsec((await mount.reading()).place, before.place)
        _demand(
            moved_arcsec <= 30.0 + 2.0 * mount.resolution_arcsec, f"its {axis} axis goes on after the stop"
        )


async def _must_refuse(order: Awaitable[object], what: str, *, bad_too: bool = False) -> None:
    """`bad_too`: it may also be refused as a bad request, before the device is asked."""
    try:
        await order
    except DeviceRefused:
        return
    except BadRequest:
        if bad_too:
            return
        raise
    raise NonConforming(f"it took {what}, which it can't do")


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
