"""A sync taken back: the mount is told again what it believed; if that fails, its position counts no more."""

from __future__ import annotations

from mountnav.clock import Clock
from mountnav.devices import MountReading, PierSide
from mountnav.errors import DeviceError, MountnavError, SyncDoubt, SyncRefused
from mountnav.mount import CheckedMount
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.reports import Look
from mountnav.navigation.steps import step
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.navigation.sync_read_back import ReadBack, send_sync
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec


class SyncUndone(SyncRefused):
    """A sync that was sent and seen, and then contradicted: the mount believes again what it did before."""

    slug: str = "sync-undone"


class UndoFailed(DeviceError):
    """A sync was contradicted and could not be taken back: the mount's position counts no more."""

    slug: str = "sync-undo-failed"


def turned_over(before: MountReading, after: MountReading) -> str | None:
    """Tell if the mount took a sync for the other posture: its next slew would go the wrong way round."""
    sides = (before.pier_side, after.pier_side)
    if any(side in (None, PierSide.UNKNOWN) for side in sides) or sides[0] is sides[1]:
        return None
    return f"the mount took the sync for the other side of the pier ({sides[0]} → {sides[1]})"


def contradiction(
    first: Look, again: Look, sent: ReadBack, policy: SyncPolicy, resolution_arcsec: float
) -> str | None:
    """Tell in words why a verifying look doesn't confirm a sync; None if it does.

    Parameters
    ----------
    first : Look
        That was synced on.
    again : Look
    sent : ReadBack
    policy : SyncPolicy
    resolution_arcsec : float
        The mount's.
    """
    if again.look_id == first.look_id or again.mid_exposure_utc <= sent.reading.utc:
        return "the verifying look was not taken after the sync"
    allowed = policy.verify_arcsec + resolution_arcsec
    off = again.offset.total_arcsec
    if not off <= allowed:
        return f"after the sync the tube looks {_angle(off)} from where the mount believes ({allowed:.0f}″)"
    return None


async def undo(
    mount: CheckedMount, believed: Icrs, sent: ReadBack, policy: SyncPolicy, clock: Clock
) -> ReadBack:
    """Sync back to what the mount believed before a sync, what it has moved since included.

    Parameters
    ----------
    mount : CheckedMount
    believed : Icrs
        Before the sync; a mount that tracks stays there, and a JNow mount is sent it as of now.
    sent : ReadBack
        Of the sync.
    policy : SyncPolicy
    clock : Clock

    Raises
    ------
    UndoFailed
        The mount doesn't believe it, or can't be asked.
    """
    step("sync transaction: undo")
    try:
        now = from_mount((await mount.reading()).place)
        motion = offset_arcsec(now, sent.place)
        place = displaced(believed, motion.east_arcsec, motion.north_arcsec)
        back = await send_sync(mount, place, separation_arcsec(now, place), policy, clock)
    except MountnavError as error:
        # also when it can't be written down, and so isn't sent
        raise UndoFailed(
            f"a sync that was contradicted could not be taken back: {error}",
            device=mount.name,
            advice="its position doesn't count: order a recovery before anything moves",
        ) from error
    if not back.outcome.seen:
        raise UndoFailed(
            f"a sync that was contradicted could not be taken back: the reading is {back.miss_arcsec:.0f}″ "
            "from what the mount believed before",
            device=mount.name,
            advice="its position doesn't count: order a recovery before anything moves",
        )
    return back


def undone(words: str, device: str, doubt: SyncDoubt = SyncDoubt.NOT_EXPECTED) -> SyncUndone:
    """Tell what to raise after a sync was taken back."""
    return SyncUndone(
        f"the sync was taken back: {words}",
        device=device,
        advice="the mount believes what it did before; correct by offset, and look at the journal",
        doubts=(doubt,),
    )


def _angle(arcsec: float) -> str:
    return f"{arcsec / 3600.0:.1f}°" if arcsec >= 3600.0 else f"{arcsec:.0f}″"


__all__ = ["SyncUndone", "UndoFailed", "contradiction", "turned_over", "undo", "undone"]
