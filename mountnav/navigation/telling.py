"""A sync on told coordinates: somebody says where the telescope points, and nobody has looked.

A planetarium's sync, mostly. It is believed within bounds: the mount's own position counts, it follows the
sky, stands well, and the place is near enough to where it already believes to be. A mount that is lost, or
further off, is for `recover`: words don't make a position count again.
"""

from __future__ import annotations

from mountnav.errors import DeviceRefused, Refusal, SyncDoubt, SyncIgnored, SyncRefused
from mountnav.journal.records import EntryKind
from mountnav.navigation.devices import MountReading, SyncOutcome
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.kinds import for_mount, from_mount
from mountnav.navigation.reports import ToldReport
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec, separation_arcsec


async def sync_to(equipment: Equipment, place: Icrs) -> ToldReport:
    """Tell the mount that it points at `place`, as somebody said, and read it back.

    Parameters
    ----------
    equipment : Equipment
    place : Icrs

    Returns
    -------
    ToldReport

    Raises
    ------
    SyncRefused
        What stands against it; nothing was sent.
    DeviceRefused
        It is parked, its position can't be trusted (nothing was sent), or it said no.
    SyncIgnored
        It accepted and ignored it.
    OutsideLimits, DeviceError, JournalFailed
    """
    mount = equipment.mount
    before = await mount.reading()
    believed = from_mount(before.place)
    off_arcsec = separation_arcsec(believed, place)
    refusal = _unfit(equipment, before) or _doubted(equipment, before, place, off_arcsec)
    if refusal is not None:
        told = {"told": True, "ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "off_arcsec": off_arcsec}
        await equipment.note(EntryKind.REFUSAL, refusal.what, told)
        raise refusal
    equipment.listen("syncing", {"told": True, "off_arcsec": off_arcsec})
    result = await mount.sync(for_mount(place, mount.epoch, equipment.clock.utc()))
    read_back = from_mount(result.read_back.place)
    equipment.listen(
        "synced", {"outcome": str(result.outcome), "told": True, "miss_arcsec": result.miss_arcsec}
    )
    if result.outcome is SyncOutcome.IGNORED:
        raise SyncIgnored(
            f"it accepted the sync, and still reads {result.miss_arcsec:.0f}″ from there",
            device=mount.name,
            advice="correct by offsets or by a pointing model; see docs/syncing.md",
        )
    return ToldReport(
        outcome=result.outcome,
        place=place,
        offset=offset_arcsec(place, believed),
        read_back=read_back,
        read_back_miss_arcsec=result.miss_arcsec,
    )


def _unfit(equipment: Equipment, before: MountReading) -> DeviceRefused | None:
    """What speaks against any word, as the mount stands."""
    mount = equipment.mount
    if before.parked:
        return DeviceRefused(
            "the sync refused: it is parked",
            device=mount.name,
            advice="unpark it first",
            reason=Refusal.PARKED,
        )
    if not mount.trusted:
        # near to where it believes to be means nothing then, and after a sync it would slew again
        return DeviceRefused(
            "the sync refused: its position can't be trusted, and nobody has looked",
            device=mount.name,
            advice="solve a frame and sync (recover), let it find its home, or say trust",
            reason=Refusal.UNTRUSTED,
        )
    return None


def _doubted(
    equipment: Equipment, before: MountReading, place: Icrs, off_arcsec: float
) -> SyncRefused | None:
    """What speaks against this place; nothing that is no number passes."""
    policy = equipment.guard.policy

    def doubted(doubt: SyncDoubt, why: str, advice: str) -> SyncRefused:
        words = f"the sync refused: {why}"
        return SyncRefused(words, device=equipment.mount.name, advice=advice, doubts=(doubt,))

    if before.slewing:
        return doubted(SyncDoubt.MOVED, "it is moving", "wait until it is at rest")
    if before.tracking is False:
        return doubted(SyncDoubt.NOT_TRACKING, "it does not follow the sky", "let it track, then sync")
    if not off_arcsec <= policy.told_max_arcsec:
        return doubted(
            SyncDoubt.TOO_FAR,
            f"told {off_arcsec / 3600.0:.2f}° from where it believes to point, more than the "
            f"{policy.told_max_arcsec / 3600.0:.2f}° that words may move it",
            "let it look (sync, recover); or raise sync.told_max_arcsec",
        )
    if 90.0 - abs(place.dec_deg) < policy.min_pole_deg:
        return doubted(
            SyncDoubt.NEAR_POLE,
            f"within {policy.min_pole_deg:.1f}° of the pole it would turn the hour angle",
            "sync further from the pole",
        )
    observed = icrs_to_observed(place, equipment.clock.utc(), equipment.site, equipment.air)
    if not observed.alt_deg >= policy.min_altitude_deg:
        return doubted(
            SyncDoubt.TOO_LOW,
            f"the place is at altitude {observed.alt_deg:.1f}°",
            f"sync above {policy.min_altitude_deg:.0f}°",
        )
    return None


__all__ = ["sync_to"]
