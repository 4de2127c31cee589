"""A sync from its sending to its end: read back, verified if asked for, taken back if it is contradicted.

If it can't be taken back, the mount's position counts no more, or by what the sky has shown.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from mountnav.clock import Clock
from mountnav.devices import (
    MountReading,
    PierSide,
    SyncLaw,
    SyncOutcome,
    SyncResult,
    for_mount,
    from_mount,
    miss_arcsec,
    rates_of,
)
from mountnav.errors import (
    BadFrame,
    Cancelled,
    DeviceError,
    DeviceRefused,
    MountnavError,
    SkyError,
    SyncDoubt,
    SyncElsewhere,
    SyncIgnored,
    SyncRefused,
)
from mountnav.mount import CheckedMount
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.camera import Normal
from mountnav.navigation.reports import Listener, Look, angle_words, finite_or_none
from mountnav.navigation.sync_judge import Judge
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.navigation.vetoes import SyncContext
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, half_turn_deg, offset_arcsec, separation_arcsec
from mountnav.tasks import waited_for

__all__ = [
    "Listener",
    "LookAgain",
    "ReadBack",
    "SyncEnd",
    "SyncProgress",
    "SyncTransaction",
    "SyncUndone",
    "TookElsewhere",
    "UndoFailed",
    "context_facts",
    "contradiction",
    "end_of",
    "look_facts",
    "place_facts",
    "read_back_facts",
    "send_sync",
    "stays_lost",
    "stood_still",
    "turned_over",
    "undo",
    "undone",
    "went_elsewhere",
    "why_not_by_sight",
]


_EACH_S = 0.2
"""Between two readings after a sync, s, as the drivers' own. Doubled, a sync that is seen late is reported up
to 0.2 s later."""
LOST_S = 30.0
"""A mount that is lost is read so long after a sync that doesn't show, s: without it nothing can be done; the
slowest simulated ones take 25 s. Halved, those would be called deaf."""


@dataclass(frozen=True, slots=True)
class ReadBack:
    """A sync that was sent, and what the readings showed afterwards.

    Attributes
    ----------
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
    way_arcsec : float
        How far the reading has to jump. A quarter of that is left to the mount, but no more than the policy's
        bound; its own resolution always. So a small sync that was ignored is still recognized.
    lost : bool
        Whether the mount's position doesn't count: then it is read for `LOST_S` at least.

    Raises
    ------
    DeviceError, JournalFailed
        As of the mount's sync.
    """
    law = SyncLaw.of(way_arcsec, mount.resolution_arcsec, policy.read_back_arcsec)
    began = clock.monotonic_s()
    told_utc = clock.utc()
    told = for_mount(place, mount.epoch, told_utc)
    result: SyncResult = await mount.sync(told)
    kill_point("sync transaction: answered")
    outcome, reading = result.outcome, result.read_back
    until_s = max(policy.read_back_s, LOST_S) if lost else policy.read_back_s
    while True:
        there = from_mount(reading.place)
        miss, after_s = separation_arcsec(there, place), clock.monotonic_s() - began
        rates = rates_of(mount)
        # one that follows a comet goes on while it is read
        off = min(miss, miss_arcsec(told, told_utc, reading, rates)) if rates else miss
        if law.seen(off):
            seen = SyncOutcome.SEEN if outcome is SyncOutcome.SEEN else SyncOutcome.LATE
            return ReadBack(seen, reading, there, miss, after_s)
        if after_s >= until_s or (outcome is SyncOutcome.ELSEWHERE and after_s >= policy.read_back_s):
            gone = outcome is SyncOutcome.ELSEWHERE
            return ReadBack(outcome if gone else SyncOutcome.IGNORED, reading, there, miss, after_s)
        if after_s > 1.0 and outcome.seen:
            outcome = SyncOutcome.LATE
        await clock.sleep(_EACH_S)
        kill_point("sync transaction: reading back")
        reading = await mount.reading()


def went_elsewhere(miss_arcsec: float, device: str) -> SyncElsewhere:
    """Tell what to raise for a sync that was taken for another place."""
    return SyncElsewhere(
        f"it synced to another place: it believes that it is {miss_arcsec:.0f}″ from what was synced",
        device=device,
        advice="its position is not trusted: solve a frame and sync (recover; a centering begins with that). "
        "If it does that again, set sync.rule to never, trust it, and let offsets do",
    )


class SyncEnd(StrEnum):
    """How a sync transaction ended; `outcome` of the journal's rows of `EntryKind.SYNC`."""

    COMMITTED = "committed"
    REFUSED = "refused by the mount"
    IGNORED = "ignored by the mount"
    ELSEWHERE = "taken for another place"
    BY_SIGHT = "not taken, counts by sight"
    """A look has shown how far off it is."""
    UNDONE = "undone"
    UNDO_FAILED = "undo failed"
    UNKNOWN = "unknown"
    """It may have been carried out: the mount could not be asked."""
    INTERRUPTED = "interrupted"
    """The work was cancelled after the sync was sent."""


def look_facts(found: Look, normal: Normal | None) -> dict[str, object]:
    """What was seen and believed, and how the frame compares with those before it."""
    solution = found.solution
    return {
        "look_id": found.look_id,
        "seen": place_facts(found.seen),
        "believed": place_facts(found.believed),
        "offset_east_arcsec": found.offset.east_arcsec,
        "offset_north_arcsec": found.offset.north_arcsec,
        "offset_arcsec": found.offset.total_arcsec,
        "mid_exposure_utc": found.mid_exposure_utc.isoformat(),
        "pairs": solution.pairs,
        "rms_arcsec": finite_or_none(solution.rms_arcsec),
        "sigma_arcsec": finite_or_none(solution.center_sigma_arcsec),
        "false_probability": finite_or_none(solution.false_probability),
        "mode": solution.mode,
        "scale_arcsec_px": solution.scale_arcsec_px,
        "rotation_deg": solution.rotation_deg,
        "parity": solution.parity,
        "usual_scale_arcsec_px": None if normal is None else normal.scale_arcsec_px,
        "usual_camera_angle_deg": None if normal is None else normal.camera_angle_deg,
    }


def context_facts(context: SyncContext, policy: SyncPolicy) -> dict[str, object]:
    """What was known besides."""
    expected = context.expected
    return {
        "rule": str(policy.rule),
        "syncs_tonight": context.counts.tonight,
        "syncs_on_target": context.counts.on_target,
        "modeled": context.modeled,
        "expected_east_arcsec": None if expected is None else expected.offset.east_arcsec,
        "expected_north_arcsec": None if expected is None else expected.offset.north_arcsec,
        "expected_sigma_arcsec": None if expected is None else finite_or_none(expected.sigma_arcsec),
    }


def read_back_facts(sent: ReadBack) -> dict[str, object]:
    """What the mount's readings showed."""
    return {
        "seen_as": str(sent.outcome),
        "read_back": place_facts(sent.place),
        "read_back_miss_arcsec": sent.miss_arcsec,
        "after_s": sent.after_s,
    }


def place_facts(place: Icrs) -> dict[str, float]:
    """An ICRS place."""
    return {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg}


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
    resolution_arcsec : float
        The mount's.
    """
    if again.look_id == first.look_id or again.mid_exposure_utc <= sent.reading.utc:
        return "the verifying look was not taken after the sync"
    allowed = policy.verify_arcsec + resolution_arcsec
    off = again.offset.total_arcsec
    if not off <= allowed:
        return (
            f"after the sync the tube looks {angle_words(off)} from where the mount believes ({allowed:.0f}″)"
        )
    return None


async def undo(
    mount: CheckedMount, believed: Icrs, sent: ReadBack, policy: SyncPolicy, clock: Clock
) -> ReadBack:
    """Sync back to what the mount believed before a sync, what it has moved since included.

    Parameters
    ----------
    believed : Icrs
        Before the sync; a mount that tracks stays there, and a JNow mount is sent it as of now.
    sent : ReadBack
        Of the sync.

    Raises
    ------
    UndoFailed
        The mount doesn't believe it, or can't be asked.
    """
    kill_point("sync transaction: undo")
    try:
        now = from_mount((await mount.reading()).place)
        motion = offset_arcsec(now, sent.place)
        place = displaced(believed, motion.east_arcsec, motion.north_arcsec)
        back = await send_sync(mount, place, separation_arcsec(now, place), policy, clock)
    except MountnavError as error:
        # also when it can't be written down, and so isn't sent
        raise UndoFailed(
            f"a contradicted sync could not be undone: {error}",
            device=mount.name,
            advice="its position is not trusted: order a recovery before anything moves",
        ) from error
    if not back.outcome.seen:
        raise UndoFailed(
            f"a contradicted sync could not be undone: the reading is {back.miss_arcsec:.0f}″ "
            "from what the mount believed before",
            device=mount.name,
            advice="its position is not trusted: order a recovery before anything moves",
        )
    return back


def undone(words: str, device: str, doubt: SyncDoubt = SyncDoubt.NOT_EXPECTED) -> SyncUndone:
    """Tell what to raise after a sync was taken back."""
    return SyncUndone(
        f"the sync was undone: {words}",
        device=device,
        advice="the mount believes what it did before; correct by offset, and look at the journal",
        doubts=(doubt,),
    )


LookAgain = Callable[[], Awaitable[Look]]


@dataclass(slots=True)
class SyncProgress:
    """How far one sync has come: what its transaction decides by, and the facts of its rows in the journal.

    Attributes
    ----------
    found : Look
        That is synced on.
    decided_by : mapping
        The facts of the decision: trigger, target, look, context.
    confirmed_by : str or None
        The look that agrees with it, where one was asked for.
    segment_before : str
        The mount's segment when the sync was sent: a sync that was seen has begun another one.
    sent : ReadBack or None
        None: not sent yet, or not answered.
    unverified : bool
        The verifying look could not be had or was no good: that says nothing of the mount.
    contradiction : str
        Why it was taken back, in words.
    undone : bool or None
        Whether it could be taken back; None: it wasn't tried, or not finished.
    """

    found: Look
    decided_by: Mapping[str, object]
    asked_for_second: bool = False
    confirmed_by: str | None = None
    segment_before: str = ""
    sent: ReadBack | None = None
    unverified: bool = False
    contradiction: str = ""
    undone: bool | None = None
    undone_miss_arcsec: float = 0.0

    def facts(self) -> dict[str, object]:
        """For the journal, as far as it has come."""
        facts = dict(self.decided_by)
        if self.asked_for_second:
            facts["confirmed_by"] = self.confirmed_by
        if self.segment_before:
            facts["segment_before"] = self.segment_before
        if self.sent is not None:
            facts |= read_back_facts(self.sent)
        if self.unverified:
            facts["unverified"] = True
        if self.contradiction:
            facts["contradiction"] = self.contradiction
        if self.undone is not None:
            facts["undone"] = self.undone
        if self.undone:
            facts["undone_miss_arcsec"] = self.undone_miss_arcsec
        return facts


@dataclass(slots=True)
class SyncTransaction:
    """One sync that was decided on.

    Attributes
    ----------
    listen : callable
        Hears what happens, for the event stream.
    progress : SyncProgress
        What happens is added.
    before : MountReading
        The mount's last one before the sync.
    """

    judge: Judge
    listen: Listener
    progress: SyncProgress
    before: MountReading

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
        judge, progress, mount = self.judge, self.progress, self.judge.mount
        found, was_trusted = progress.found, mount.trusted
        progress.segment_before = mount.segment_id
        self.listen(
            "syncing", {"look_id": found.look_id, "ra_deg": found.seen.ra_deg, "dec_deg": found.seen.dec_deg}
        )
        sent = await send_sync(
            mount, found.seen, found.offset.total_arcsec, judge.policy, judge.clock, lost=not was_trusted
        )
        progress.sent = sent
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
            progress.contradiction = words
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
        kill_point("sync transaction: to be verified")
        try:
            again = await look_again()
        except (SkyError, BadFrame, DeviceError) as error:
            # that says nothing of the mount
            self.progress.unverified = True
            return None, (SyncDoubt.NOT_EXPECTED, f"it could not be verified: {error}")
        kill_point("sync transaction: looked again")
        no_good = self.judge.no_good(again)
        if no_good is not None:
            self.progress.unverified = True
            return again, (no_good[0], f"the verifying look can't be used: {no_good[1]}")
        resolution_arcsec = self.judge.mount.resolution_arcsec
        words = contradiction(self.progress.found, again, sent, self.judge.policy, resolution_arcsec)
        return again, None if words is None else (SyncDoubt.NOT_EXPECTED, words)

    async def _take_back(self, sent: ReadBack, believed: Icrs, was_trusted: bool) -> None:
        """Undo it; to its end also when the work is cancelled: no wrong sync must stay half undone."""
        mount = self.judge.mount
        self.listen("undoing-sync", {"look_id": self.progress.found.look_id})
        task = waited_for(undo(mount, believed, sent, self.judge.policy, self.judge.clock))
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError:
            await asyncio.wait({task})
            raise
        finally:
            if not task.done() or task.cancelled():
                mount.distrust("a contradicted sync was being undone when the work was cancelled")
            elif (error := task.exception()) is not None:
                self.progress.undone = False
                mount.distrust(str(error))
            else:
                self.progress.undone = True
                self.progress.undone_miss_arcsec = task.result().miss_arcsec
                if not was_trusted:
                    mount.distrust("the sync that had made it trusted was undone")
                self.listen("sync-undone", {"look_id": self.progress.found.look_id})


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


class TookElsewhere(SyncElsewhere):
    """The mount took another place than it was sent, and counts all the same: a look has shown which.

    Attributes
    ----------
    look : Look
        The one that showed it.
    """

    def __init__(self, before: SyncElsewhere, look: Look) -> None:
        super().__init__(
            before.what,
            device=before.device,
            advice="its position is trusted because of what was seen; corrections go "
            "by offset until noon, or until its "
            "link is made again",
        )
        self.look = look


def stays_lost(error: DeviceError, off_arcsec: float) -> DeviceError:
    """What to raise for a lost mount that took no sync, and is too far off to count by sight; with a way out.

    Parameters
    ----------
    error : DeviceError
        How its sync ended.
    off_arcsec : float
        How far off it was seen.
    """
    what = f"{error.what}; it looks {off_arcsec / 3600.0:.1f}° from where it believes it points"
    advice = (
        "a mount that takes no syncs can't be told where it points: align it at its own hand control, or "
        "open its clutches and turn the tube by hand to where it believes it points; then say trust"
    )
    if isinstance(error, DeviceRefused):
        return DeviceRefused(what, device=error.device, advice=advice, reason=error.reason)
    return type(error)(what, device=error.device, advice=advice)


def why_not_by_sight(judge: Judge, found: Look) -> str | None:
    """Why a position can't count by a look, in words; None if it can.

    Parameters
    ----------
    found : Look
        Another one agrees with it, and how a German mount stands is known.
    """
    if found.segment_id != judge.mount.segment_id:
        return "its zero points have changed since the look"
    no_good = judge.no_good(found)
    if no_good is not None:
        return no_good[1]
    off_arcsec = off_at_most_arcsec(judge, found)
    if off_arcsec <= judge.policy.max_arcsec:
        return None
    return (
        f"its axes may be off by {off_arcsec / 3600.0:.1f}°, more than the "
        f"{judge.policy.max_arcsec / 3600.0:.1f}° that are believed"
    )


def off_at_most_arcsec(judge: Judge, found: Look) -> float:
    """How far off the tube may look anywhere in the sky, by what it was off at a look.

    A pole that is off shows as an offset to the east; an axis that is off turns the sky by 1 / cos δ more.
    """
    utc = found.mid_exposure_utc
    seen, believed = (
        icrs_to_hour_angle(place, utc, judge.site, judge.air) for place in (found.seen, found.believed)
    )
    turned_deg = half_turn_deg(seen.ha_deg - believed.ha_deg)
    axes_arcsec = 3600.0 * math.hypot(turned_deg, seen.dec_deg - believed.dec_deg)
    return max(axes_arcsec, found.offset.total_arcsec)


def stood_still(found: Look, before: MountReading, again: Look, allowed_arcsec: float) -> bool:
    """Whether two looks show one place of the sky, and the mount believes in the same posture.

    Parameters
    ----------
    found : Look
        Before the sync.
    before : MountReading
        The last one before it.
    again : Look
        After it.
    """
    apart = separation_arcsec(found.seen, again.seen)
    return apart <= allowed_arcsec and turned_over(before, again.after) is None
