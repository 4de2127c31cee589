"""One centering: slew, look, correct, slew again, until the target is in the middle or something stops it.

It ends within its time; whatever its end, it is written down, and a mount out of time is stopped. A tube that
looks at its target must hold still there, not only pass by.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

from mountnav.devices import SyncOutcome
from mountnav.errors import (
    DeviceRefused,
    MountnavError,
    NotReached,
    Refusal,
    SyncElsewhere,
    TargetNotReached,
)
from mountnav.journal.records import EntryKind
from mountnav.measuring.measurements import StarImages
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.aim_points import AimPoint
from mountnav.navigation.correcting import Correcting
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.moving import MovingTarget, Target
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.recovering import recover, require_rightly_set
from mountnav.navigation.reports import CenterOutcome, CenterReport, Correction, Look
from mountnav.navigation.slewing import Slewing, crossing, side_note
from mountnav.navigation.sync import SyncTrigger
from mountnav.navigation.tries import StopRules, Tries, tolerance_kept, tolerance_widened, try_facts
from mountnav.navigation.vetoes import apart_arcsec
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, Icrs
from mountnav.sky.sphere import Offset, offset_arcsec, separation_arcsec

__all__ = [
    "LOOKED_AGAIN",
    "Centering",
    "agree",
    "agreeing_looks",
    "center_in_time",
    "centering_facts",
    "moved_arcsec",
    "shows_rest",
]


LOOKED_AGAIN = 6
"""So many more looks may be taken until it is seen to hold still: play of 600″ is taken up meanwhile.
Doubled, a tube in the wind costs six more exposures before that is said."""
_OF_DRIFT = 0.5
"""Stars drawn out by less than this share of the sky's turn did not drift with it. Chosen by hand. Doubled, a
tube that stands still while the sky drifts through passes for one at rest."""
_OF_TOLERANCE = 0.1
"""A tube whose stars are drawn out by so much of the tolerance in seconds may leave it in the next ones.
Chosen by hand. Doubled, a tube that swings slowly is called centered earlier."""
_SHOWS_S = 3.0
"""Gusts swing a tube within some seconds: a shorter exposure shows a moment of that, s. Chosen by hand.
Doubled, exposures of 3 s to 6 s need a second look."""
_AGREE = 0.2
"""Looks that agree to so much of the tolerance show a tube that stays in it. Chosen by hand. Doubled, a drift
of two fifths of the tolerance between two looks counts as rest."""
_SIGMAS, _OF_NOISE = 3.0, 0.5
"""What looks scatter is allowed besides, but no more than this share: trailed ones scatter by anything.
Chosen by hand: 1 of 370 by chance, and half the tolerance."""


def shows_rest(found: Look, tolerance_arcsec: float, exposure_s: float) -> bool:
    """Whether a look shows by itself that the sky stood in the frame: its stars are round, and weren't else.

    Parameters
    ----------
    exposure_s : float
        As it is usual: a shorter one was tried since the stars were drawn out.
    """
    trail_arcsec, took_s = _trail_arcsec(found), found.exposure_s
    if trail_arcsec is None or took_s is None or took_s < max(_SHOWS_S, 0.9 * exposure_s):
        return False
    drift_arcsec = SIDEREAL_ARCSEC_S * math.cos(math.radians(found.seen.dec_deg)) * took_s
    return trail_arcsec <= min(_OF_DRIFT * drift_arcsec, _OF_TOLERANCE * tolerance_arcsec)


def _trail_arcsec(found: Look) -> float | None:
    """How far the sky moved in the frame at most, by the typical star's two widths; None if that isn't known.

    A tube that jumped in the exposure leaves two round images of each star: their distance counts too.
    """
    quality = found.verdict.quality
    trail_px = None if quality is None else quality.trail_px
    if trail_px is None:
        return None
    return max(trail_px, found.verdict.apart_px) * found.solution.scale_arcsec_px


def agreeing_looks(found: Look, exposure_s: float, *, moved: bool) -> int:
    """How many looks in a row must agree with the one before them until the tube is said to hold still.

    Parameters
    ----------
    found : Look
        The last one.
    exposure_s : float
        As it is usual.
    moved : bool
        Whether it was seen to move: it may stand at a turning point.
    """
    quality = found.verdict.quality
    trailed = quality is not None and quality.images is StarImages.TRAILED
    shortened = found.exposure_s is not None and found.exposure_s < 0.9 * exposure_s
    if trailed or shortened:
        # the optics may make such stars, or the mount track so; else it is chance that they agree
        return 3
    return 2 if moved else 1


def agree(first: Look, again: Look, tolerance_arcsec: float) -> bool:
    """Whether two looks at one place show the same sky, as near as it takes to stay within the tolerance.

    Parameters
    ----------
    first, again : Look
        One after the other, with no slew between.
    """
    trail_arcsec = _trail_arcsec(again)
    if trail_arcsec is not None and trail_arcsec > tolerance_arcsec:
        return False  # wherever its middle is
    sigmas = [look.solution.center_sigma_arcsec for look in (first, again)]
    noise = _SIGMAS * math.hypot(*(sigma if math.isfinite(sigma) else 0.0 for sigma in sigmas))
    allowed_arcsec = _AGREE * tolerance_arcsec + min(noise, _OF_NOISE * tolerance_arcsec)
    return moved_arcsec(first, again) <= allowed_arcsec


def moved_arcsec(first: Look, again: Look) -> float:
    """How far the sky moved in the frame from one look to the next."""
    return separation_arcsec(first.seen, again.seen)


MOST_RECOVERIES = 2
"""So often a mount may lose its position in one centering. Chosen by hand. Doubled, a mount with a loose
power plug is recovered, and slewed, twice as often."""


class Centering:
    """One run.

    A target that moves is led: the mount is sent to where it will be in the middle of the next exposure, and
    each look is judged by where it was in the middle of its own.

    Parameters
    ----------
    planned_s : float, optional
        How long the target is to be followed afterwards.
    key : str, optional
        The target's name, for the policy of syncs.
    point : AimPoint, optional
        To which it is brought; the frame's middle if left out.

    Attributes
    ----------
    notes : list of str
        What an operator should know of it, in words with numbers.
    """

    def __init__(
        self,
        equipment: Equipment,
        slewing: Slewing,
        target: Target,
        policy: CenteringPolicy,
        *,
        planned_s: float | None = None,
        key: str | None = None,
        point: AimPoint | None = None,
    ) -> None:
        self._asked = target
        self._moving = MovingTarget(
            target,
            site=equipment.site,
            clock=equipment.clock,
            pace=slewing.pace,
            exposure_s=policy.exposure_s,
            settle_s=policy.settle_s,
        )
        self._slewing = slewing
        self.tries = Tries(equipment)
        self.notes: list[str] = []
        self._equipment = equipment
        self._policy = policy
        self._planned_s = planned_s
        self._key = key
        resolution = equipment.mount.resolution_arcsec
        self._tolerance, note = tolerance_kept(policy.tolerance_arcsec, resolution)
        self._note(note)
        place = self._moving.at(equipment.clock.utc())
        self._judged_utc = equipment.clock.utc()
        self._sigma_arcsec = self._moving.sigma_arcsec(equipment.clock.utc())
        self._tolerance, note = tolerance_widened(self._tolerance, self._sigma_arcsec)
        self._note(note)
        self._ends = StopRules(equipment.name, policy, self.tries, self._tolerance)
        ahead = self._moving.ahead if self._moving.moves else None
        self._correcting = Correcting(equipment, slewing, place, policy, self._note, key, ahead, point)
        self._flipped = False
        self._recoveries = 0

    async def run(self) -> CenterReport:
        """Center.

        Returns
        -------
        CenterReport
            Always a success; every other end is an error.

        Raises
        ------
        OutsideLimits, SolveFailed, OffsetTooLarge, SyncRefused, MountMoved, TargetNotReached, Cancelled
        DeviceError, JournalFailed
        """
        clock, correcting, ends, tries = self._equipment.clock, self._correcting, self._ends, self.tries
        began_s = clock.monotonic_s()
        kill_point("centering begin")
        if not self._equipment.trusted:
            await self._recovered()
        expected = expected_first = await correcting.expect()
        await self._slew()
        while True:
            tries.begin()
            found = await correcting.look()
            if not self._equipment.trusted:
                if ends.too_far is not None:
                    # looks agree that it is further off than a sync may be: that is for the operator
                    raise ends.too_far
                # rebooted, or its link was lost: begin again
                await self._recovered()
                expected = await correcting.anew()
                await self._slew()
                continue
            require_rightly_set(found, self._equipment.mount, device=self._equipment.name)
            followed = correcting.sighted(found)
            self._keep_pace(found)
            error = self._error(found)
            tries.add(found, error, followed, expected, approached=correcting.approach)
            decision = self._equipment.guard.consider(found, SyncTrigger.CENTERING, target=self._key)
            if decision.against_the_sky:
                correcting.disbelieve()
                refused = ends.doubted(decision)
                tries.close(Correction.NONE, f"doubted: {decision.why}", slewed=False)
                if refused is not None:
                    raise refused
                continue
            if error.total_arcsec > self._tolerance and correcting.must_be_confirmed(found, followed):
                second = await correcting.look()
                apart = apart_arcsec(found, second)
                if apart > self._policy.max_motion_arcsec + self._equipment.mount.resolution_arcsec:
                    correcting.disbelieve()
                    refused = ends.disagreed(apart)
                    tries.close(Correction.NONE, f"a second frame was solved {apart:.0f}″ away", slewed=False)
                    if refused is not None:
                        raise refused
                    continue
                found = second
                decision = self._equipment.guard.consider(found, SyncTrigger.CENTERING, target=self._key)
            ends.followed(followed)
            ends.believed()
            self._slewing.seen = found
            if error.total_arcsec <= self._tolerance:
                latest = await self._at_rest(found)
                if latest is None:
                    tries.close(Correction.NONE, "its position became untrusted", slewed=False)
                    continue
                if latest is not found:
                    # that the tube holds still is what it shows: a moving target has gone on meanwhile
                    there = self._moving.at(self._judged_utc)
                    error = offset_arcsec(correcting.aiming.place(latest), there)
                    found = latest
                    tries.seen_again(found, error)
                    followed = correcting.sighted(found)
                    decision = self._equipment.guard.consider(found, SyncTrigger.CENTERING, target=self._key)
            if error.total_arcsec <= self._tolerance:
                tries.close(Correction.NONE, "centered", slewed=False)
                return self._report(found, expected_first, clock.monotonic_s() - began_s)
            stop = correcting.out_of_reach or ends.why(followed, correcting.hole(found))
            done = None
            if stop is None:
                try:
                    done = await correcting.correct(found, decision)
                except SyncElsewhere as error:
                    # nobody knows where it points: begin again
                    tries.close(Correction.NONE, error.what, slewed=False, sync_outcome=SyncOutcome.ELSEWHERE)
                    await self._recovered()
                    expected = await correcting.anew()
                    await self._slew()
                    continue
            elif stop.reason is NotReached.POLE and stop is not correcting.out_of_reach and not ends.last:
                done = await correcting.zeroed_below_the_pole()
            if done is None:
                assert stop is not None
                tries.close(Correction.NONE, stop.what, slewed=False)
                raise stop
            expected = tries.noise_arcsec(found)
            await self._slew()
            tries.close(done.correction, done.why, slewed=True, sync_outcome=done.sync_outcome)

    @property
    def target(self) -> Icrs:
        """Where the target is, or was to be when the mount was sent there last."""
        return self._correcting.target

    def _error(self, found: Look) -> Offset:
        """How far the tube looked from where the target was in the middle of that exposure."""
        self._judged_utc = found.mid_exposure_utc
        place = self._correcting.aiming.place(found)
        return offset_arcsec(place, self._moving.at(found.mid_exposure_utc))

    def _keep_pace(self, found: Look) -> None:
        """Learn how long after a slew an exposure was half over."""
        arrived = self._slewing.arrived_utc
        if arrived is not None and self._moving.moves:
            waited_s = (found.mid_exposure_utc - arrived).total_seconds()
            self._slewing.pace.looked(waited_s, found.exposure_s or self._policy.exposure_s)
            self._slewing.arrived_utc = None

    @property
    def last_error(self) -> str:
        """How far off the last look was, in words."""
        if not self.tries.all:
            return "no look was finished"
        return f"last seen {self.tries.latest.error_arcsec:.0f}″ off"

    async def _at_rest(self, found: Look) -> Look | None:
        """Look until the tube is seen to hold still; the last look, which may show it elsewhere.

        None if the mount's position stopped counting meanwhile.

        Raises
        ------
        TargetNotReached
            It doesn't hold still: what was seen held for a moment only.
        """
        correcting, latest, aim = self._correcting, found, self._correcting.aim
        if shows_rest(found, self._tolerance, self._policy.exposure_s):
            return found
        most, agreed = 0.0, 0
        for _ in range(LOOKED_AGAIN):
            again = await correcting.look()
            if not self._equipment.trusted:
                return None
            if correcting.aim != aim:
                return again  # in a neighbor field
            decision = self._equipment.guard.consider(again, SyncTrigger.CENTERING, target=self._key)
            if decision.against_the_sky:
                continue
            agreed = agreed + 1 if agree(latest, again, self._tolerance) else 0
            if agreed >= agreeing_looks(again, self._policy.exposure_s, moved=most > 0.0):
                return again
            most = most if agreed else max(most, moved_arcsec(latest, again))
            latest = again
        words = f"looks at one place differ by {most:.0f}″: the tube does not keep still"
        self.tries.close(Correction.NONE, words, slewed=False)
        raise TargetNotReached(
            words,
            device=self._equipment.name,
            advice="is it windy, or does the mount not track? order it again when it is calmer, or allow a "
            "larger tolerance",
            reason=NotReached.RESTLESS,
        )

    async def _recovered(self) -> None:
        """Find out where a mount points whose position doesn't count, and sync it; not for ever."""
        self._recoveries += 1
        if self._recoveries > MOST_RECOVERIES:
            raise DeviceRefused(
                f"its position became untrusted {self._recoveries} times in this centering",
                device=self._equipment.mount.name,
                advice="look at the mount: its power, its cable",
                reason=Refusal.UNTRUSTED,
            )
        await recover(self._equipment, self._policy)
        kill_point("centering recovered")

    async def _slew(self) -> None:
        while True:
            try:
                self._flipped = await self._correcting.slew() or self._flipped
            except DeviceRefused as error:
                if error.reason is not Refusal.UNTRUSTED:
                    raise
                await self._recovered()
                await self._correcting.anew()
            else:
                return

    def _note(self, words: str | None) -> None:
        if words is not None and words not in self.notes:
            self.notes.append(words)

    def _report(self, found: Look, expected: float | None, elapsed_s: float) -> CenterReport:
        equipment = self._equipment
        side, side_seen = found.after.side, equipment.guard.side_seen(found)
        self._note(side_note(found, side_seen))
        followed = self._asked if self._moving.moves else self._correcting.axis
        ahead = crossing(equipment, followed, side, self._planned_s)
        if ahead is not None:
            self._note(ahead.words)
        target, rates = self.target, None
        if self._moving.moves:
            target, rates = (
                self._moving.at(self._judged_utc),
                self._moving.rates(self._judged_utc),
            )
            self._note(uncertain_note(self._sigma_arcsec, found))
        return CenterReport(
            outcome=CenterOutcome.CENTERED,
            target=target,
            tries=tuple(self.tries.all),
            error_before_arcsec=self.tries.all[0].error_arcsec,
            error_after_arcsec=self.tries.latest.error_arcsec,
            error_sigma_arcsec=self.tries.latest.sigma_arcsec,
            tolerance_arcsec=self._tolerance,
            elapsed_s=elapsed_s,
            tolerance_asked_arcsec=self._policy.tolerance_arcsec,
            expected_error_arcsec=expected,
            side=side,
            side_seen=side_seen,
            flipped=self._flipped,
            crossing=ahead,
            model_id=self._correcting.model_id,
            notes=tuple(self.notes),
            at=self._correcting.aiming.seen(found),
            rotation_deg=found.solution.rotation_deg,
            last=found,
            target_name=self._moving.name,
            target_utc=self._judged_utc if self._moving.moves else None,
            target_sigma_arcsec=self._sigma_arcsec,
            target_rates=rates,
        )


def uncertain_note(sigma_arcsec: float, found: Look) -> str | None:
    """What to know of a target whose place is so uncertain that it may not be in the frame."""
    shorter_px = min(found.width_px, found.height_px)
    half_arcsec = 0.5 * shorter_px * found.solution.scale_arcsec_px
    if sigma_arcsec <= 0.0 or half_arcsec <= 0.0 or sigma_arcsec < half_arcsec:
        return None
    return (
        f"the target's place is uncertain by {sigma_arcsec:.0f}″ (one sigma), more than half the field of "
        f"{2.0 * half_arcsec:.0f}″: it may not be in the frame"
    )


def centering_facts(
    run: Centering, *, report: CenterReport | None = None, error: BaseException | None = None
) -> dict[str, object]:
    """A whole centering for the journal: its target, its tries, its end."""
    facts: dict[str, object] = {
        "target_ra_deg": run.target.ra_deg,
        "target_dec_deg": run.target.dec_deg,
        "tries": [try_facts(tried) for tried in run.tries.all],
        "notes": list(run.notes),
    }
    if report is not None:
        if report.at is not None:
            facts |= {"at": report.at.name, "at_x_px": report.at.x_px, "at_y_px": report.at.y_px}
        facts |= {
            "outcome": str(report.outcome),
            "error_before_arcsec": report.error_before_arcsec,
            "error_after_arcsec": report.error_after_arcsec,
            "error_sigma_arcsec": report.error_sigma_arcsec,
            "expected_error_arcsec": report.expected_error_arcsec,
            "tolerance_arcsec": report.tolerance_arcsec,
            "elapsed_s": report.elapsed_s,
            "flipped": report.flipped,
        }
    if error is not None:
        slug = error.slug if isinstance(error, MountnavError) else type(error).__name__
        facts |= {"outcome": slug, "reason": str(getattr(error, "reason", "")), "problem": str(error)}
    return facts


async def center_in_time(
    equipment: Equipment,
    slewing: Slewing,
    target: Target,
    policy: CenteringPolicy,
    *,
    halt: Callable[[], Awaitable[None]],
    planned_s: float | None,
    key: str | None,
    point: AimPoint | None = None,
) -> CenterReport:
    """Center `target`; see `Centering`.

    Parameters
    ----------
    halt : callable
        Stops the mount, when time has run out.
    planned_s : float or None
        How long the target is to be followed afterwards.
    key : str or None
        Its name.
    point : AimPoint, optional
        To which it is brought; the frame's middle if left out.

    Raises
    ------
    TargetNotReached
        Also when time ran out (`NotReached.TIME`); the mount is stopped then.
    OutsideLimits, SolveFailed, OffsetTooLarge, SyncRefused, MountMoved, Cancelled
    DeviceError, JournalFailed
    """
    run = Centering(equipment, slewing, target, policy, planned_s=planned_s, key=key, point=point)
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
            advice="allow more time, or see in the job's attempts what took the time",
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
