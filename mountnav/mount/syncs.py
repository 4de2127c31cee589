"""The order to sync: sent to a place above the ground, read back, and told whether it was seen."""

from __future__ import annotations

import math
from dataclasses import replace

from mountnav.clock import Clock
from mountnav.devices import Mount, MountReading, PierSide, SyncOutcome, SyncResult
from mountnav.errors import BadRequest, Cancelled, OutsideLimits
from mountnav.journal.records import Outcome
from mountnav.mount.admission import Admission
from mountnav.mount.guarding import Guard
from mountnav.mount.sending import Came, OvertakenError, Sender
from mountnav.mount.standing import Standing
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.sync_outcomes import near_arcsec, unseen
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

_OUTCOMES = {
    SyncOutcome.SEEN: Outcome.DONE,
    SyncOutcome.LATE: Outcome.LATE,
    SyncOutcome.IGNORED: Outcome.IGNORED,
    SyncOutcome.ELSEWHERE: Outcome.ELSEWHERE,
}


class Syncs:
    """Syncs one mount.

    Parameters
    ----------
    mount : Mount
    guard : Guard
    standing : Standing
    sender : Sender
    admission : Admission
    clock : Clock
    """

    def __init__(
        self,
        mount: Mount,
        guard: Guard,
        standing: Standing,
        sender: Sender,
        admission: Admission,
        clock: Clock,
    ) -> None:
        self._mount = mount
        self._guard = guard
        self._standing = standing
        self._sender = sender
        self._admission = admission
        self._clock = clock

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Tell the mount that it points there. See `CheckedMount.sync`."""
        stops = self._sender.stops
        async with self._admission.held("sync"):
            before = await self._standing.reading()
            try:
                self._guard.require_above_ground(from_mount(place), self._clock.utc())
            except (OutsideLimits, BadRequest) as refusal:
                await self._sender.refused("sync", refusal, before, place)
                raise
            self._guard.told_anew(self._clock.utc())
            try:
                return await self._sender.send(
                    "sync",
                    lambda: self._sent_and_read(place, before),
                    self._came,
                    place=place,
                    before=before,
                    stops=stops,
                    moves=True,
                )
            except OvertakenError:
                raise Cancelled("stopped before the sync was sent", device=self._mount.name) from None

    async def _sent_and_read(self, place: Apparent | Icrs, before: MountReading) -> SyncResult:
        result: SyncResult | None = await self._mount.sync(place)
        resolution = self._mount.resolution_arcsec
        if result is None:
            # the drivers of others may leave the reading to us
            after = await self._standing.reading()
            miss = separation_arcsec(from_mount(after.place), from_mount(place))
            offset = separation_arcsec(from_mount(before.place), from_mount(place))
            seen = miss <= near_arcsec(offset, resolution, math.inf)
            result = SyncResult(SyncOutcome.SEEN if seen else SyncOutcome.IGNORED, after, miss, 0.0)
        if result.outcome is SyncOutcome.IGNORED:
            # nor may they know that a mount can take another place
            result = replace(result, outcome=unseen(before, result.read_back, resolution))
        return result

    def _came(self, result: SyncResult) -> Came:
        counts = result.outcome.seen
        if counts:
            self._standing.regained()
        if result.outcome is SyncOutcome.ELSEWHERE and self._standing.trusted:
            self._standing.distrust(
                f"it took a sync for another place: it believes to be {result.miss_arcsec:.0f}″ from there"
            )
        return Came(
            _OUTCOMES[result.outcome],
            after=result.read_back,
            miss_arcsec=result.miss_arcsec,
            facts={"after_s": result.after_s},
            new_segment="a sync was seen" if counts else "",
            synced_on=self._guard.side(result.read_back) or PierSide.UNKNOWN,
        )
