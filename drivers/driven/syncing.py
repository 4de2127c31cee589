"""A sync and its read-back: seen, seen late, or accepted and ignored; sent once, never believed unread."""

from __future__ import annotations

import asyncio

from drivers.driven.tended import LateSync, Tended
from drivers.language import Readout
from drivers.places import apart_arcsec
from mountnav.clock import pause
from mountnav.errors import Busy, DeviceMissing, DeviceRefused, Refusal
from mountnav.navigation.devices import MountReading, SyncOutcome, SyncResult
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.present import sky_s

_LATE_FOR_S = 60.0
"""So long after it was given up a sync that shows is still recognized."""


async def sync(tended: Tended, place: Apparent | Icrs) -> SyncResult:
    """Tell a mount that it points at a place, and read back; see `DrivenMount.sync`."""
    if tended.job is not None:
        raise Busy(f"a {tended.job} is running", device=tended.name, advice="wait for it, or stop it")
    await tended.ready()
    stops, links = tended.stops, tended.links
    async with tended.ordering:
        before = await tended.look()
        if before.slewing:
            raise DeviceRefused("the sync refused: it slews", device=tended.name, reason=Refusal.BUSY)
        tended.judge.forget()
        sent = await tended.language.send_sync(place, lambda: tended.stops == stops and tended.links == links)
        # a look between the two would have kept the place before it
        tended.judge.forget()
        tended.restless()
        if not sent.wire:
            raise DeviceRefused(
                "the sync was not sent: a stop came before it, or its link was lost", device=tended.name
            )
        # a quarter of the offset is left to the mount, so that a small sync that was ignored still shows
        share_arcsec = 0.25 * apart_arcsec(before.place, place)
        free_arcsec = tended.language.resolution_arcsec + 5.0
        near_arcsec = max(min(share_arcsec, tended.timing.near_arcsec), free_arcsec)
        result = await _read_back(tended, place, near_arcsec)
    if tended.links != links:
        raise DeviceMissing(
            "its link was lost during the sync: whether it was carried out is not known",
            device=tended.name,
            advice="look at the sky before anything moves",
        )
    if result.outcome is not SyncOutcome.IGNORED:
        tended.trust("a sync was seen")
        return result
    if sent.lost is not None:
        raise sent.lost
    tended.late_sync = LateSync(place, near_arcsec, asyncio.get_running_loop().time() + _LATE_FOR_S)
    return result


async def _read_back(tended: Tended, place: Apparent | Icrs, near_arcsec: float) -> SyncResult:
    loop, timing = asyncio.get_running_loop(), tended.timing
    asked = loop.time()
    while True:
        now = await tended.look()
        # the sky turns by its own time; how long is too long for a wire goes by the machine's
        waited_s = loop.time() - asked
        after_s = sky_s(waited_s)
        miss_arcsec = apart_arcsec(now.place, place)
        drift_arcsec = 0.0 if now.tracking else timing.drift_arcsec_s * after_s
        seen = miss_arcsec <= near_arcsec + drift_arcsec
        if seen or waited_s > timing.sync_wait_s:
            outcome = SyncOutcome.IGNORED
            if seen:
                outcome = SyncOutcome.LATE if waited_s > timing.late_s else SyncOutcome.SEEN
            return SyncResult(outcome, as_reading(now), miss_arcsec, after_s)
        await pause(min(0.2, timing.poll_s))


def as_reading(readout: Readout) -> MountReading:
    """What is published of a look."""
    return MountReading(
        readout.place,
        readout.utc,
        readout.slewing,
        readout.tracking,
        readout.parked,
        readout.at_home,
        readout.pier_side,
    )
