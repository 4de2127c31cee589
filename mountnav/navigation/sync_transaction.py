"""A sync from its sending to its end: read back, verified if asked for, taken back if it is contradicted."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from mountnav.devices import MountReading, SyncOutcome
from mountnav.errors import (
    BadFrame,
    Cancelled,
    DeviceError,
    SkyError,
    SyncDoubt,
    SyncElsewhere,
    SyncIgnored,
    SyncRefused,
)
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.reports import Look
from mountnav.navigation.steps import step
from mountnav.navigation.sync_facts import SyncEnd, read_back_facts
from mountnav.navigation.sync_judge import Judge
from mountnav.navigation.sync_read_back import ReadBack, send_sync, went_elsewhere
from mountnav.navigation.undoing import UndoFailed, contradiction, turned_over, undo, undone
from mountnav.sky.coordinates import Icrs
from mountnav.tasks import waited_for

Listener = Callable[[str, dict[str, object]], None]
LookAgain = Callable[[], Awaitable[Look]]


@dataclass(slots=True)
class SyncTransaction:
    """One sync that was decided on.

    Attributes
    ----------
    judge : Judge
    listen : callable
    found : Look
    before : MountReading
        The mount's last one before the sync.
    facts : dict
        For the journal; what happens is added.
    """

    judge: Judge
    listen: Listener
    found: Look
    before: MountReading
    facts: dict[str, object]

    async def run(self, look_again: LookAgain | None) -> tuple[ReadBack, Look | None]:
        """Send it and see it through.

        Parameters
        ----------
        look_again : callable or None
            Takes the verifying look that the policy may ask for; without it none is taken.

        Returns
        -------
        sent : ReadBack
            Seen, in time or late.
        again : Look or None
            What verified it.

        Raises
        ------
        SyncIgnored, SyncElsewhere, SyncUndone, UndoFailed, DeviceError, JournalFailed
        """
        judge, found, mount = self.judge, self.found, self.judge.mount
        was_trusted = mount.trusted
        self.facts["segment_before"] = mount.segment_id
        self.listen(
            "syncing", {"look_id": found.look_id, "ra_deg": found.seen.ra_deg, "dec_deg": found.seen.dec_deg}
        )
        sent = await send_sync(
            mount, found.seen, found.offset.total_arcsec, judge.policy, judge.clock, lost=not was_trusted
        )
        self.facts |= read_back_facts(sent)
        self.listen("synced", {"outcome": str(sent.outcome), "read_back_miss_arcsec": sent.miss_arcsec})
        if sent.outcome is SyncOutcome.IGNORED:
            raise SyncIgnored(
                f"the sync was accepted, but the reading is {sent.miss_arcsec:.0f}″ from what was synced",
                device=mount.name,
                advice="is syncing allowed in the mount's present state?",
            )
        if sent.outcome is SyncOutcome.ELSEWHERE:
            raise went_elsewhere(sent.miss_arcsec, mount.name)
        again, against = await self._verified(sent, look_again)
        if against is not None:
            doubt, words = against
            self.facts["contradiction"] = words
            await self._take_back(sent, from_mount(self.before.place), was_trusted)
            raise undone(words, mount.name, doubt)
        return sent, again

    async def _verified(
        self, sent: ReadBack, look_again: LookAgain | None
    ) -> tuple[Look | None, tuple[SyncDoubt, str] | None]:
        """The verifying look if one was asked for, and what contradicts the sync."""
        words = turned_over(self.before, sent.reading)
        if words is not None:
            return None, (SyncDoubt.WRONG_SIDE, words)
        if not self.judge.policy.verify or look_again is None:
            return None, None
        step("sync transaction: to be verified")
        try:
            again = await look_again()
        except (SkyError, BadFrame, DeviceError) as error:
            # that says nothing of the mount
            self.facts["unverified"] = True
            return None, (SyncDoubt.NOT_EXPECTED, f"it could not be verified: {error}")
        step("sync transaction: looked again")
        no_good = self.judge.no_good(again)
        if no_good is not None:
            self.facts["unverified"] = True
            return again, (no_good[0], f"the verifying look is no good: {no_good[1]}")
        resolution_arcsec = self.judge.mount.resolution_arcsec
        words = contradiction(self.found, again, sent, self.judge.policy, resolution_arcsec)
        return again, None if words is None else (SyncDoubt.NOT_EXPECTED, words)

    async def _take_back(self, sent: ReadBack, believed: Icrs, was_trusted: bool) -> None:
        """Undo it; to its end also when the work is cancelled: no wrong sync must stay half undone."""
        mount = self.judge.mount
        self.listen("undoing-sync", {"look_id": self.found.look_id})
        task = waited_for(undo(mount, believed, sent, self.judge.policy, self.judge.clock))
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError:
            await asyncio.wait({task})
            raise
        finally:
            if not task.done() or task.cancelled():
                mount.distrust(
                    "a sync that was contradicted was being taken back when the work was cancelled"
                )
            elif (error := task.exception()) is not None:
                self.facts["undone"] = False
                mount.distrust(str(error))
            else:
                self.facts |= {"undone": True, "undone_miss_arcsec": task.result().miss_arcsec}
                if not was_trusted:
                    mount.distrust("the sync that had made it count was taken back")
                self.listen("sync-undone", {"look_id": self.found.look_id})


def end_of(error: BaseException) -> SyncEnd:
    """How a transaction ended that raised this."""
    match error:
        case UndoFailed():
            return SyncEnd.UNDO_FAILED
        case SyncRefused():
            return SyncEnd.UNDONE
        case SyncIgnored():
            return SyncEnd.IGNORED
        case SyncElsewhere():
            return SyncEnd.ELSEWHERE
        case Cancelled():
            return SyncEnd.INTERRUPTED
        case Exception():
            return SyncEnd.UNKNOWN
    return SyncEnd.INTERRUPTED


__all__ = ["Listener", "LookAgain", "SyncTransaction", "end_of"]
