"""A sync and its read-back: seen, late, ignored, or another place taken; sent once, never believed unread.

What the readings after a sync mean is one law for all mounts (`SyncLaw` of `mountnav.devices`); drivers call
it here only, through `SyncReadBack`. What follows from the outcome (journal, model, undo) is decided above.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from datetime import datetime

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.refusals import Refusals
from drivers.generic.session import LateSync, Session
from mountnav.clock import pause, sky_s, utc_now
from mountnav.devices import MountReading, OffsetRates, SyncLaw, SyncOutcome, SyncResult, miss_arcsec
from mountnav.errors import DeviceMissing, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs

_LATE_FOR_S = 60.0
"""How long (s) after a sync was given up it is still recognized when it shows. Chosen: the slowest simulated
mounts take 25 s. Doubled, a place that is reached by hand passes for the sync for twice as long; halved,
little is left."""


class SyncReadBack:
    """Judges the readings that follow one sync.

    Parameters
    ----------
    place : Apparent or Icrs
        Where the mount is told that it points.
    before : MountReading
        The last reading before the sync.
    resolution_arcsec : float
        The mount's step.
    most_arcsec : float
        A sync is seen no further than that from its place, unless the step is coarser.
    rates : collection of OffsetRates
        At which the mount may track beside the sidereal one: it goes on at them while it is read.

    Attributes
    ----------
    near_arcsec : float
        How near to its place the mount must believe to be.
    """

    def __init__(
        self,
        place: Apparent | Icrs,
        before: MountReading,
        *,
        resolution_arcsec: float,
        most_arcsec: float,
        rates: Collection[OffsetRates] = (),
    ) -> None:
        self._place = place
        self._before = before
        self._sent_utc: datetime | None = None
        self._rates = tuple(rates)
        self._law = SyncLaw.of(apart_arcsec(before.place, place), resolution_arcsec, most_arcsec)
        self.near_arcsec = self._law.near_arcsec

    def sent(self, utc: datetime) -> None:
        """The sync has gone out: from now on a mount that rests believes a place that turns with the sky."""
        self._sent_utc = utc

    def shows(self, now: MountReading) -> bool:
        """Whether a reading shows the sync."""
        assert self._sent_utc is not None
        return self._law.seen(miss_arcsec(self._place, self._sent_utc, now, self._rates))

    def result(self, now: MountReading, *, after_s: float, late: bool) -> SyncResult:
        """What the sync came to by the last reading, taken `after_s` after it."""
        if not self.shows(now):
            outcome = self._law.unseen(self._before, now, self._rates)
        else:
            outcome = SyncOutcome.LATE if late else SyncOutcome.SEEN
        return SyncResult(outcome, now, apart_arcsec(now.place, self._place), after_s)


async def sync(session: Session, refusals: Refusals, place: Apparent | Icrs) -> SyncResult:
    """Tell a mount that it points at a place, and read back; see `GenericMount.sync`."""
    session.require_no_job()
    await session.ready()
    stops, links = session.stops, session.links
    async with session.ordering:
        before = await session.read()
        if before.slewing:
            raise DeviceRefused("the sync refused: it slews", device=session.name, reason=Refusal.BUSY)
        read_back = SyncReadBack(
            place,
            before.reading,
            resolution_arcsec=session.language.resolution_arcsec,
            most_arcsec=session.timing.near_arcsec,
            rates=session.drift.may,
        )
        # one that was given up earlier would be taken for this one
        session.late_sync = None
        went_out = False

        def wanted() -> bool:
            nonlocal went_out
            if session.stops != stops or session.links != links:
                return False
            # only now: until it goes out a place that has changed is a jump, say of a mount that was switched
            # off and on while the target was sent
            went_out = True
            session.filter.forget()
            return True

        async with refusals.checked("the sync", before, stops=False):
            try:
                sent = await session.language.send_sync(place, wanted)
            finally:
                if went_out:
                    # a reading between the two would have kept the place before it
                    session.filter.forget()
                session.forget_rest()
        if not sent.wire:
            raise DeviceRefused(
                "the sync was not sent: a stop came before it, or its link was lost", device=session.name
            )
        try:
            result = await _read_until_seen(session, read_back)
        except BaseException:
            # the next reader finds it here, there, or (if it was switched off meanwhile) where it woke up
            if session.filter.last is None:
                session.filter.last = before
            session.late_sync = _late(place, read_back.near_arcsec)
            raise
    if session.links != links:
        raise DeviceMissing(
            "its link was lost during the sync: whether it was carried out is not known",
            device=session.name,
            advice="look at the sky before anything moves",
        )
    if result.outcome.seen:
        session.trust("a sync was seen")
        return result
    session.late_sync = _late(place, read_back.near_arcsec)
    if result.outcome is SyncOutcome.ELSEWHERE:
        session.went_elsewhere(result.miss_arcsec)
        return result
    if sent.lost is not None:
        raise sent.lost
    return result


def _late(place: Apparent | Icrs, near_arcsec: float) -> LateSync:
    return LateSync(place, near_arcsec, asyncio.get_running_loop().time() + _LATE_FOR_S, utc_now())


async def _read_until_seen(session: Session, read_back: SyncReadBack) -> SyncResult:
    loop, timing = asyncio.get_running_loop(), session.timing
    sent_s = loop.time()
    read_back.sent(utc_now())
    while True:
        now = (await session.read()).reading
        # the sky turns by its own time; how long is too long for a wire is counted in the machine's
        waited_s = loop.time() - sent_s
        if read_back.shows(now) or waited_s > timing.sync_wait_s:
            return read_back.result(now, after_s=sky_s(waited_s), late=waited_s > timing.late_s)
        await pause(timing.soon_s)
