"""One centering: slew, look, correct, slew again, until the target is in the middle or something stops it.

Each try is kept with its numbers. An end that is not the target's center has a name (`ends`), or is what the
sky, the limits or a device said.
"""

from __future__ import annotations

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
from mountnav.navigation.correcting import Correcting
from mountnav.navigation.ends import Ends
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.flipping import crossing, side_note, side_of
from mountnav.navigation.holding_still import LOOKED_AGAIN, agree, agreeing_looks, moved_arcsec, shows_rest
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.recovering import apart_arcsec, require_rightly_set
from mountnav.navigation.reports import CenterOutcome, CenterReport, Correction, Look
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.steps import step
from mountnav.navigation.syncing import Occasion
from mountnav.navigation.tries import Tries, tolerance_kept, try_facts
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec

MOST_RECOVERIES = 2
"""So often a mount may lose its position in one centering."""


class Centering:
    """One run.

    Parameters
    ----------
    equipment : Equipment
    slewing : Slewing
    target : Icrs
    policy : CenteringPolicy
    recover : callable
        Finds out where an untrusted mount points.
    planned_s : float, optional
        How long the target is to be followed afterwards.
    key : str, optional
        The target's name, for the policy of syncs.

    Attributes
    ----------
    target : Icrs
    tries : Tries
    notes : list of str
        What an operator should know of it, in words with numbers.
    """

    def __init__(
        self,
        equipment: Equipment,
        slewing: Slewing,
        target: Icrs,
        policy: CenteringPolicy,
        *,
        recover: Callable[[], Awaitable[object]],
        planned_s: float | None = None,
        key: str | None = None,
    ) -> None:
        self.target = target
        self.tries = Tries(equipment)
        self.notes: list[str] = []
        self._equipment = equipment
        self._policy = policy
        self._recover = recover
        self._planned_s = planned_s
        self._key = key
        resolution = equipment.mount.resolution_arcsec
        self._tolerance, note = tolerance_kept(policy.tolerance_arcsec, resolution)
        self._note(note)
        self._ends = Ends(equipment.name, policy, self.tries, self._tolerance)
        self._correcting = Correcting(equipment, slewing, target, policy, self._note, key)
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
        OutsideLimits, NotSolved, OffsetImplausible, SyncRefused, MountMoved, TargetNotReached, Cancelled
        DeviceError, JournalFailed
        """
        clock, correcting, ends, tries = self._equipment.clock, self._correcting, self._ends, self.tries
        began_s = clock.monotonic_s()
        step("centering begin")
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
                # rebooted, or its link was lost: begin anew
                await self._recovered()
                expected = await correcting.anew()
                await self._slew()
                continue
            require_rightly_set(found, self._equipment.mount, device=self._equipment.name)
            followed = correcting.sighted(found)
            error = offset_arcsec(found.seen, self.target)
            tries.add(found, error, followed, expected, approached=correcting.approach)
            decision = self._equipment.guard.consider(found, Occasion.CENTERING, target=self._key)
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
                decision = self._equipment.guard.consider(found, Occasion.CENTERING, target=self._key)
            ends.followed(followed)
            ends.believed()
            if error.total_arcsec <= self._tolerance:
                latest = await self._at_rest(found)
                if latest is None:
                    tries.close(Correction.NONE, "its position stopped counting", slewed=False)
                    continue
                if latest is not found:
                    found, error = latest, offset_arcsec(latest.seen, self.target)
                    tries.seen_again(found, error)
                    followed = correcting.sighted(found)
                    decision = self._equipment.guard.consider(found, Occasion.CENTERING, target=self._key)
            if error.total_arcsec <= self._tolerance:
                tries.close(Correction.NONE, "centered", slewed=False)
                return self._report(found, expected_first, clock.monotonic_s() - began_s)
            stop = ends.why(followed, correcting.hole(found))
            done = None
            if stop is None:
                try:
                    done = await correcting.correct(found, decision)
                except SyncElsewhere as error:
                    # nobody knows where it points: begin anew
                    tries.close(Correction.NONE, error.what, slewed=False, sync_outcome=SyncOutcome.ELSEWHERE)
                    await self._recovered()
                    expected = await correcting.anew()
                    await self._slew()
                    continue
            elif stop.reason is NotReached.POLE and not ends.last:
                done = await correcting.zeroed_below_the_pole()
            if done is None:
                assert stop is not None
                tries.close(Correction.NONE, stop.what, slewed=False)
                raise stop
            expected = tries.noise_arcsec(found)
            await self._slew()
            tries.close(done.correction, done.why, slewed=True, sync_outcome=done.sync_outcome)

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
            decision = self._equipment.guard.consider(again, Occasion.CENTERING, target=self._key)
            if decision.against_the_sky:
                continue
            agreed = agreed + 1 if agree(latest, again, self._tolerance) else 0
            if agreed >= agreeing_looks(again, self._policy.exposure_s, moved=most > 0.0):
                return again
            most = most if agreed else max(most, moved_arcsec(latest, again))
            latest = again
        words = f"looks at one place differ by {most:.0f}″: the tube doesn't hold still"
        self.tries.close(Correction.NONE, words, slewed=False)
        raise TargetNotReached(
            words,
            device=self._equipment.name,
            advice="is it windy, or does the mount not track? order it again when it is calmer, or allow a "
            "larger tolerance",
            reason=NotReached.RESTLESS,
        )

    async def _recovered(self) -> None:
        """Find out where a mount points whose position doesn't count, and tell it; not for ever."""
        self._recoveries += 1
        if self._recoveries > MOST_RECOVERIES:
            raise DeviceRefused(
                f"its position stopped counting {self._recoveries} times in this centering",
                device=self._equipment.mount.name,
                advice="look at the mount: its power, its cable",
                reason=Refusal.UNTRUSTED,
            )
        await self._recover()
        step("centering recovered")

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
        side, side_seen = side_of(found), equipment.guard.side_seen(found)
        self._note(side_note(found, side_seen))
        ahead = crossing(equipment, self.target, side, self._planned_s)
        if ahead is not None:
            self._note(ahead.words)
        return CenterReport(
            outcome=CenterOutcome.CENTERED,
            target=self.target,
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
        )


def centering_facts(
    run: Centering, *, report: CenterReport | None = None, error: BaseException | None = None
) -> dict[str, object]:
    """A whole centering for the journal: its target, its tries, its end."""
    facts: dict[str, object] = {
        "target_ra_deg": run.target.ra_deg,
        "target_dec_deg": run.target.dec_deg,
        "tries": [try_facts(one) for one in run.tries.all],
        "notes": list(run.notes),
    }
    if report is not None:
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


__all__ = ["Centering", "centering_facts"]
