"""What became of a sync: seen, seen late, or accepted and ignored; by the readings, not by its word."""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.clock import Clock
from mountnav.navigation.checked_mount import CheckedMount
from mountnav.navigation.devices import MountReading, SyncOutcome, SyncResult
from mountnav.navigation.kinds import for_mount, from_mount
from mountnav.navigation.steps import step
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

_EACH_S = 0.2


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
    mount: CheckedMount, place: Icrs, way_arcsec: float, policy: SyncPolicy, clock: Clock
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

    Returns
    -------
    ReadBack

    Raises
    ------
    DeviceError, JournalFailed
        As of the mount's sync.
    """
    share = min(0.25 * way_arcsec, policy.read_back_arcsec)
    near_arcsec = max(share, mount.resolution_arcsec + 5.0)
    began = clock.monotonic_s()
    result: SyncResult | None = await mount.sync(for_mount(place, mount.epoch, clock.utc()))
    step("sync transaction: answered")
    # the drivers of others may leave the reading to us
    outcome = SyncOutcome.SEEN if result is None else result.outcome
    reading = await mount.reading() if result is None else result.read_back
    while True:
        there = from_mount(reading.place)
        miss, after_s = separation_arcsec(there, place), clock.monotonic_s() - began
        if miss <= near_arcsec:
            seen = SyncOutcome.SEEN if outcome is SyncOutcome.SEEN else SyncOutcome.LATE
            return ReadBack(seen, reading, there, miss, after_s)
        if after_s >= policy.read_back_s:
            return ReadBack(SyncOutcome.IGNORED, reading, there, miss, after_s)
        outcome = SyncOutcome.LATE if after_s > 1.0 else outcome
        await clock.sleep(_EACH_S)
        step("sync transaction: reading back")
        reading = await mount.reading()


__all__ = ["ReadBack", "send_sync"]
