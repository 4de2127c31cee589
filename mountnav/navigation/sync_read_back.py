"""What became of a sync: seen, late, ignored, or another place taken; by the readings, not by its word."""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.clock import Clock
from mountnav.devices import MountReading, SyncOutcome, SyncResult
from mountnav.errors import SyncElsewhere
from mountnav.mount import CheckedMount
from mountnav.navigation.kinds import for_mount, from_mount
from mountnav.navigation.steps import step
from mountnav.navigation.sync_outcomes import near_arcsec
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

_EACH_S = 0.2
LOST_S = 30.0
"""A mount that is lost is read so long after a sync that doesn't show, s: without it nothing can be done; the
slowest simulated ones take 25 s."""


@dataclass(frozen=True, slots=True)
class ReadBack:
    """A sync that was sent, and what the readings showed afterwards.

    Attributes
    ----------
    outcome : SyncOutcome
    reading : MountReading
        The last one.
    place : Icrs
        Where it believes to be.
    miss_arcsec : float
        Between that and the place that was synced.
    after_s : float
        From the order to the last reading.
    """

    outcome: SyncOutcome
    reading: MountReading
    place: Icrs
    miss_arcsec: float
    after_s: float


async def send_sync(
    mount: CheckedMount,
    place: Icrs,
    way_arcsec: float,
    policy: SyncPolicy,
    clock: Clock,
    *,
    lost: bool = False,
) -> ReadBack:
    """Send a sync once, and read until it shows or the policy's time is over.

    Parameters
    ----------
    mount : CheckedMount
    place : Icrs
    way_arcsec : float
        How far the reading has to jump. A quarter of that is left to the mount, but no more than the policy's
        bound; its own resolution always. So a small sync that was ignored is still recognized.
    policy : SyncPolicy
    clock : Clock
    lost : bool
        Whether the mount's position doesn't count: then it is read for `LOST_S` at least.

    Returns
    -------
    ReadBack

    Raises
    ------
    DeviceError, JournalFailed
        As of the mount's sync.
    """
    near = near_arcsec(way_arcsec, mount.resolution_arcsec, policy.read_back_arcsec)
    began = clock.monotonic_s()
    result: SyncResult = await mount.sync(for_mount(place, mount.epoch, clock.utc()))
    step("sync transaction: answered")
    outcome, reading = result.outcome, result.read_back
    until_s = max(policy.read_back_s, LOST_S) if lost else policy.read_back_s
    while True:
        there = from_mount(reading.place)
        miss, after_s = separation_arcsec(there, place), clock.monotonic_s() - began
        if miss <= near:
            seen = SyncOutcome.SEEN if outcome is SyncOutcome.SEEN else SyncOutcome.LATE
            return ReadBack(seen, reading, there, miss, after_s)
        if after_s >= until_s or (outcome is SyncOutcome.ELSEWHERE and after_s >= policy.read_back_s):
            gone = outcome is SyncOutcome.ELSEWHERE
            return ReadBack(outcome if gone else SyncOutcome.IGNORED, reading, there, miss, after_s)
        if after_s > 1.0 and outcome.seen:
            outcome = SyncOutcome.LATE
        await clock.sleep(_EACH_S)
        step("sync transaction: reading back")
        reading = await mount.reading()


def went_elsewhere(miss_arcsec: float, device: str) -> SyncElsewhere:
    """Tell what to raise for a sync that was taken for another place."""
    return SyncElsewhere(
        f"it took the sync for another place: it believes to be {miss_arcsec:.0f}″ from what was synced",
        device=device,
        advice="its position doesn't count: solve a frame and sync (recover; a centering begins with that). "
        "If it does that again, set sync.rule to never, trust it, and let offsets do",
    )


__all__ = ["ReadBack", "send_sync", "went_elsewhere"]
