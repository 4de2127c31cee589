"""A sync and its read-back: seen, late, ignored, or another place taken; sent once, never believed unread."""

from __future__ import annotations

import asyncio

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.language import Readout
from drivers.generic.refusals import Refusals
from drivers.generic.session import LateSync, Session
from mountnav.clock import pause, sky_s, utc_now
from mountnav.devices import SyncLaw, SyncOutcome, SyncResult, miss_arcsec
from mountnav.errors import Busy, DeviceMissing, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs

_LATE_FOR_S = 60.0
"""So long after it was given up a sync that shows is still recognized."""


async def sync(tended: Session, refusals: Refusals, place: Apparent | Icrs) -> SyncResult:
    """Tell a mount that it points at a place, and read back; see `GenericMount.sync`."""
    if tended.job is not None:
        raise Busy(f"a {tended.job} is running", device=tended.name, advice="wait for it, or stop it")
    await tended.ready()
    stops, links = tended.stops, tended.links
    async with tended.ordering:
        before = await tended.look()
        if before.slewing:
            raise DeviceRefused("the sync refused: it slews", device=tended.name, reason=Refusal.BUSY)
        way_arcsec = apart_arcsec(before.place, place)
        law = SyncLaw.of(way_arcsec, tended.language.resolution_arcsec, tended.timing.near_arcsec)
        # one that was given up earlier would be taken for this one
        tended.late_sync = None
        went_out = False

        def wanted() -> bool:
            nonlocal went_out
            if tended.stops != stops or tended.links != links:
                return False
            # only now: until it goes out a place that has changed is a jump, say of a mount that was switched
            # off and on while it was told the target
            went_out = True
            tended.judge.forget()
            return True

        async with refusals.seen_to("the sync", before, stops=False):
            try:
                sent = await tended.language.send_sync(place, wanted)
            finally:
                if went_out:
                    # a look between the two would have kept the place before it
                    tended.judge.forget()
                tended.restless()
        if not sent.wire:
            raise DeviceRefused(
                "the sync was not sent: a stop came before it, or its link was lost", device=tended.name
            )
        try:
            result = await _read_back(tended, before, place, law)
        except BaseException:
            # whoever reads it next finds it here, there, or where it woke up that was switched off meanwhile
            if tended.judge.last is None:
                tended.judge.last = before
            tended.late_sync = _late(place, law.near_arcsec)
            raise
    if tended.links != links:
        raise DeviceMissing(
            "its link was lost during the sync: whether it was carried out is not known",
            device=tended.name,
            advice="look at the sky before anything moves",
        )
    if result.outcome.seen:
        tended.trust("a sync was seen")
        return result
    tended.late_sync = _late(place, law.near_arcsec)
    if result.outcome is SyncOutcome.ELSEWHERE:
        tended.went_elsewhere(result.miss_arcsec)
        return result
    if sent.lost is not None:
        raise sent.lost
    return result


def _late(place: Apparent | Icrs, near_arcsec: float) -> LateSync:
    return LateSync(place, near_arcsec, asyncio.get_running_loop().time() + _LATE_FOR_S)


async def _read_back(tended: Session, before: Readout, place: Apparent | Icrs, law: SyncLaw) -> SyncResult:
    loop, timing = asyncio.get_running_loop(), tended.timing
    asked, told_utc = loop.time(), utc_now()
    while True:
        now = (await tended.look()).reading
        # the sky turns by its own time; how long is too long for a wire goes by the machine's
        waited_s = loop.time() - asked
        outcome = law.outcome(miss_arcsec(place, told_utc, now), before.reading, now)
        if outcome.seen or waited_s > timing.sync_wait_s:
            if outcome.seen and waited_s > timing.late_s:
                outcome = SyncOutcome.LATE
            return SyncResult(outcome, now, apart_arcsec(now.place, place), sky_s(waited_s))
        await pause(min(0.2, timing.poll_s))
