"""A centering within its time; whatever its end, it is written down, and a mount out of time is stopped."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from mountnav.errors import NotReached, TargetNotReached
from mountnav.journal.records import EntryKind
from mountnav.navigation.centering import Centering, centering_facts
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.recovering import recover
from mountnav.navigation.reports import CenterReport
from mountnav.navigation.slewing import Slewing
from mountnav.sky.coordinates import Icrs


async def center_in_time(
    equipment: Equipment,
    slewing: Slewing,
    target: Icrs,
    policy: CenteringPolicy,
    *,
    halt: Callable[[], Awaitable[None]],
    planned_s: float | None,
    key: str | None,
) -> CenterReport:
    """Center `target`; see `Centering`.

    Parameters
    ----------
    equipment : Equipment
    slewing : Slewing
    target : Icrs
    policy : CenteringPolicy
    halt : callable
        Stops the mount, when time has run out.
    planned_s : float or None
        How long the target is to be followed afterwards.
    key : str or None
        Its name.

    Raises
    ------
    TargetNotReached
        Also when time ran out (`NotReached.TIME`); the mount is stopped then.
    OutsideLimits, NotSolved, OffsetImplausible, SyncRefused, MountMoved, Cancelled
    DeviceError, JournalFailed
    """

    async def find() -> None:
        await recover(equipment, policy)

    run = Centering(equipment, slewing, target, policy, recover=find, planned_s=planned_s, key=key)
    try:
        async with asyncio.timeout(policy.timeout_s) as limit:
            report = await run.run()
    except TimeoutError:
        if not limit.expired():
            raise
        await halt()
        late = TargetNotReached(
            f"not centered within {policy.timeout_s:.0f} s ({run.last_error}); the mount was stopped",
            device=equipment.name,
            advice="allow more time, or see what took it in the job's attempts",
            reason=NotReached.TIME,
        )
        equipment.note_now(EntryKind.CENTERING, late.what, centering_facts(run, error=late))
        raise late from None
    except BaseException as error:
        # also a cancelled one, which must not wait
        words = f"not centered: {error or type(error).__name__}"
        equipment.note_now(EntryKind.CENTERING, words, centering_facts(run, error=error))
        raise
    words = f"centered to {report.error_after_arcsec:.1f}″ in {len(report.tries)} tries"
    await equipment.note(EntryKind.CENTERING, words, centering_facts(run, report=report))
    return report


__all__ = ["center_in_time"]
