"""What is done about a look that shows the target beside the middle: a sync, or an aim beside the target."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from mountnav.devices import PierSide, SyncOutcome, from_mount
from mountnav.errors import (
    DeviceRefused,
    NotReached,
    OutsideLimits,
    SyncIgnored,
    SyncRefused,
    TargetNotReached,
)
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.look_retries import PersistentLook
from mountnav.navigation.policy import Approach, CenteringPolicy, CorrectBy
from mountnav.navigation.reports import Correction, Look
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.steering import (
    ENOUGH_LOOKS,
    Followed,
    Hole,
    PolarSteering,
    Sighting,
    sent_as_believed,
    steering_for,
)
from mountnav.navigation.sync import SyncDecision, SyncTrigger
from mountnav.navigation.sync_transaction import TookElsewhere
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, displaced, offset_arcsec, separation_arcsec

ZEROED_AT_DEC_DEG = 60.0
"""Far enough from the pole for a sync: there a polar axis 10′ off shifts the hour angle by 17′ at most.
Chosen by hand; at 75° it would be 37′."""

VAGUE_ARCSEC = 900.0
"""When the tube may look further than this from what is expected, one sigma, two frames must agree. Chosen by
hand, 15′. Doubled, one false frame may move a mount by half a degree."""

NEAR_ARCSEC = 120.0
"""A correction as small as this changes no sides. Chosen by hand. Doubled, a hole at the pole of 4′ goes
unsaid."""

Note = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Corrected:
    """What was done about a look, before the next slew."""

    correction: Correction
    why: str
    sync_outcome: SyncOutcome | None = None


class Correcting:
    """The corrections of one centering: it knows where the mount is sent, and why.

    Parameters
    ----------
    note : callable
        Told what an operator should know.
    key : str or None
        The target's name, for the policy of syncs.
    ahead : callable, optional
        Of a target that moves: where it will be in the middle of the exposure after a slew that begins now
        from the place that is given.

    Attributes
    ----------
    aim : Icrs
        Where the mount was, or is to be, sent.
    approach : bool
        Whether slews end with a leg from the fixed side.
    model_id : str or None
        The pointing model that aimed.
    """

    def __init__(
        self,
        equipment: Equipment,
        slewing: Slewing,
        target: Icrs,
        policy: CenteringPolicy,
        note: Note,
        key: str | None,
        ahead: Callable[[Icrs | None], Icrs] | None = None,
    ) -> None:
        self.aim = target
        self._ahead = ahead
        self.approach = policy.approach is Approach.ALWAYS
        self.model_id: str | None = None
        self._equipment = equipment
        self._slewing = slewing
        self._target = target
        self._policy = policy
        self._note = note
        self._key = key
        self._steering = steering_for(target, equipment.mount.resolution_arcsec, equipment.site)
        self._zeroed = self._astray = False
        self._ignored = False
        self._segment_id = ""
        self._syncs = policy.correct_by is CorrectBy.SYNC
        polar_distance_deg = 90.0 - abs(target.dec_deg)
        if self._syncs and polar_distance_deg < policy.pole_deg:
            self._syncs = False
            note(f"{polar_distance_deg:.2f}° from the pole: corrected by offsets, not by syncs")
        if policy.correct_by is CorrectBy.MODEL and equipment.pointing.model_id is None:
            note("no pointing model is in force: corrected by offsets alone")

    async def expect(self) -> float | None:
        """Aim; how far off the tube may look after the first slew, one sigma; None if that isn't known."""
        slewing = self._slewing
        self._lead()
        side = await slewing.side_at(self._target)
        self.aim = slewing.aimed(self._target, side)
        if self.aim != self._target:
            self.model_id = self._equipment.pointing.model_id
        expected = slewing.expected(self._target, side)
        if expected is None:
            return None
        steps = math.sqrt(1.0 / 6.0) * self._equipment.mount.resolution_arcsec
        offset = expected.offset.total_arcsec if self.model_id is None else 0.0
        return math.hypot(offset, math.sqrt(2.0) * expected.sigma_arcsec, steps)

    async def anew(self) -> float | None:
        """What was seen before counts no more: the mount was synced."""
        self._steering.forget()
        self._segment_id = self._equipment.mount.segment_id
        return await self.expect()

    async def slew(self) -> bool:
        """Send the mount to the aim; whether it changed sides: then the looks that follow begin again."""
        kill_point("centering slew")
        self._lead()
        try:
            report = await self._slewing.slew(self._target, self.aim, approach=self._leg())
        except TargetNotReached as error:
            if error.reason is not NotReached.REST or not self._ignored:
                raise
            # it rests elsewhere by a belief that has jumped: the sync took hold on the way
            self._ignored = False
            self._note(f"the sync that it had seemed to ignore took hold on the way: {error.what}")
            return False
        if report.flipped:
            if not isinstance(self._steering, PolarSteering):
                self._steering.forget()
            self._note(f"the slew changed sides of the pier, to {report.side_after}")
        return report.flipped

    @property
    def target(self) -> Icrs:
        """Where the target is, or was to be when the mount was sent there last."""
        return self._target

    def _lead(self) -> None:
        """Go on to where a moving target will be: the aim stays as far beside it as it is."""
        if self._ahead is None:
            return
        latest = self._equipment.readings.latest
        place = self._ahead(None if latest is None else from_mount(latest.place))
        on = offset_arcsec(place, self._target)
        self.aim = displaced(self.aim, on.east_arcsec, on.north_arcsec)
        self._target = self._steering.target = place

    def _leg(self) -> Offset | None:
        """From where the last leg comes: towards the west and the north, the way that tracking turns."""
        arcsec = self._policy.approach_arcsec
        if isinstance(self._steering, PolarSteering):
            # the hour angle's backlash is nothing on the sky there, the declination's turns with each step
            sign = -math.copysign(1.0, self._target.dec_deg)
            return None if self._policy.approach is Approach.NEVER else Offset(0.0, sign * arcsec)
        return Offset(arcsec, -arcsec) if self.approach else None

    async def look(self) -> Look:
        """Look until it is solved, by all that the policy allows."""

        async def go(place: Icrs) -> None:
            await self._slewing.slew(place)

        policy = self._policy
        persistent = PersistentLook(self._equipment, policy, policy.persistence, used="centering", go=go)
        seen = await persistent.look()
        if seen.neighbor is not None:
            self.aim = seen.neighbor
            self._note("solved in a neighbor field, and corrected by that")
        kill_point("centering looked")
        return seen.look

    def sighted(self, found: Look) -> Followed:
        """Take in a look; whether the tube did what the last correction asked."""
        if found.segment_id != self._segment_id:
            # its zero points are new, and not by our doing: a late sync, a reboot, a slip
            self._steering.forget()
            self._segment_id = found.segment_id
        bound = max(60.0, 3.0 * self._equipment.mount.resolution_arcsec)
        sent = sent_as_believed(self.aim, found.believed, bound)
        followed = self._steering.sighted(
            Sighting(sent, found.seen, found.after.side), found.mid_exposure_utc
        )
        if followed is Followed.STUCK and self._policy.approach is Approach.WHEN_NEEDED:
            self.approach = True
        return followed

    def disbelieve(self) -> None:
        """The last look was wrong."""
        self._steering.disbelieve()

    def must_be_confirmed(self, found: Look, followed: Followed) -> bool:
        """Whether one frame is not enough to move by: nothing is known that a false one would offend.

        So it is before the camera is known, while the zero points are not, and where the tube seems to have
        gone elsewhere.
        """
        equipment = self._equipment
        if followed is Followed.ELSEWHERE or equipment.guard.learned.normal is None:
            return True
        expected = self._slewing.expected(found.seen, found.after.side)
        return expected is None or expected.sigma_arcsec > VAGUE_ARCSEC

    def hole(self, found: Look) -> Hole | None:
        """The hole round the mount's pole, with the target in it."""
        steering = self._steering
        if not isinstance(steering, PolarSteering):
            return None
        hole = steering.hole(found.mid_exposure_utc, found.after.side)
        if hole is None and self._astray and steering.looks >= ENOUGH_LOOKS:
            off = separation_arcsec(found.seen, self._target)
            if off < NEAR_ARCSEC:
                return None
            return Hole(off, "wherever the mount is sent for either side of the pier, it takes the other one")
        return hole

    async def _next_aim(self, found: Look) -> Icrs:
        """Beside the target, for the side on which the tube will hang there."""
        now, side = self._equipment.clock.utc(), found.after.side
        aim = self._steering.next_aim(now, side)
        if isinstance(self._steering, PolarSteering) and side is not PierSide.UNKNOWN:
            other = await self._slewing.side_at(aim)
            if other not in (side, PierSide.UNKNOWN):
                there = self._steering.next_aim(now, other)
                self._astray = await self._slewing.side_at(there) is not other
                aim = aim if self._astray else there
        return aim

    async def correct(self, found: Look, decision: SyncDecision) -> Corrected:
        """Choose where to slew next, and sync the mount if that is the way."""
        why, outcome = "", None
        if self._syncs and not self._equipment.guard.prefers_offset:
            if decision.allowed:
                outcome, why, again = await self._synced(found, decision)
                if again is not None:
                    # it believes another place now: the next step is counted from that
                    found = again
                    sighting = Sighting(again.believed, again.seen, again.after.side)
                    self._steering.sighted(sighting, again.mid_exposure_utc)
                if not why:
                    self._steering.believed(found.seen)
                    self.aim = self._slewing.aimed(self._target, found.after.side)
                    return Corrected(Correction.SYNC, str(outcome), outcome)
            else:
                why = f"not synced: {decision.why}"
                self._note(why)
        self.aim = await self._next_aim(found)
        if self._policy.correct_by is CorrectBy.MODEL and self.model_id is not None:
            return Corrected(Correction.MODEL, "the model's aim, and the error that was left")
        return Corrected(Correction.OFFSET, why or "beside the target by the error seen", outcome)

    async def _synced(
        self, found: Look, decision: SyncDecision
    ) -> tuple[SyncOutcome | None, str, Look | None]:
        """Sync; with words when the mount takes no sync, and it has to be an offset.

        With a look besides, where the mount took another place than it was sent, and that was seen.
        """
        kill_point("centering sync")
        try:
            report = await self._equipment.guard.commit(
                found,
                SyncTrigger.CENTERING,
                target=self._key,
                decision=decision,
                look_again=self._look_again,
            )
        except TookElsewhere as error:
            self._syncs = False
            self._note(f"by offset from here on: {error.what}")
            self._steering.forget()
            self._segment_id = self._equipment.mount.segment_id
            return SyncOutcome.ELSEWHERE, error.what, error.look
        except (SyncIgnored, SyncRefused, DeviceRefused) as error:
            # its belief stays as it is, so aim beside the target
            self._syncs = False
            self._note(f"by offset from here on: {error.what}")
            self._ignored = isinstance(error, SyncIgnored)
            return SyncOutcome.IGNORED if self._ignored else None, error.what, None
        self._segment_id = self._equipment.mount.segment_id
        return report.outcome, "", None

    async def _look_again(self) -> Look:
        plain = replace(self._policy.persistence, tactics=frozenset())
        return (await PersistentLook(self._equipment, self._policy, plain, used="sync verified").look()).look

    async def zeroed_below_the_pole(self) -> Corrected | None:
        """Put the zero points right far below the pole, once: without them the hole is smaller.

        At the pole itself a sync would put the hour angle wrong; where it is made, it does not. None where
        that isn't allowed, or didn't work.

        Raises
        ------
        OutsideLimits, SolveFailed, MountMoved, DeviceError, JournalFailed
        """
        guard = self._equipment.guard
        if self._zeroed or self._policy.correct_by is not CorrectBy.SYNC or guard.prefers_offset:
            return None
        self._zeroed = True
        dec_deg = math.copysign(ZEROED_AT_DEC_DEG, self._target.dec_deg)
        below = Icrs(self._target.ra_deg, dec_deg)
        try:
            await self._slewing.slew(below)
        except OutsideLimits:
            # below the horizon under the pole: on the other side of it
            below = Icrs((self._target.ra_deg + 180.0) % 360.0, dec_deg)
            await self._slewing.slew(below)
        self.aim = below
        found = await self.look()
        decision = guard.consider(found, SyncTrigger.CENTERING, target=self._key)
        words = "" if decision.allowed else decision.why
        outcome = None
        if decision.allowed:
            outcome, words, _ = await self._synced(found, decision)
        if words:
            self._note(f"not synced below the pole: {words}")
            return None
        self._note(f"synced at declination {below.dec_deg:.0f}°: without that it could not be reached")
        self._steering.forget()
        self._astray = False
        self.aim = self._target
        return Corrected(Correction.SYNC, "synced far below the pole", outcome)


__all__ = ["Corrected", "Correcting"]
