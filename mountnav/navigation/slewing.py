"""Slews of a navigator: target and aim are checked, the end is named, and a change of sides is noticed.

On which side of the pier the tube hangs is known from the mount and from the solved rotation.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

from mountnav.devices import PierSide, Skill, SlewOutcome, for_mount, from_mount
from mountnav.errors import (
    Cancelled,
    DeviceRefused,
    LimitKind,
    ModelRefused,
    NotReached,
    OutsideLimits,
    TargetNotReached,
)
from mountnav.journal.records import EntryKind
from mountnav.mount import WentAnotherWay
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.moving import Pace, Target, path_of
from mountnav.navigation.reports import Crossing, Look, SlewReport
from mountnav.pointing.limits.along import reached_along
from mountnav.pointing.model.in_force import Expected
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, displaced, separation_arcsec

__all__ = ["LOOK_AHEAD_S", "Slewing", "crossing", "side_note"]


LOOK_AHEAD_S = 3600.0
"""How far limits are looked for when nobody says how long a target is to be followed, s. Chosen by hand, a
usual exposure. Doubled, reports warn of limits two hours away."""


def side_note(found: Look, seen: PierSide) -> str | None:
    """What an operator should know when the solved rotation shows another side than the mount says.

    Parameters
    ----------
    seen : PierSide
        By the rotation; unknown while the camera's angle has not been learned.
    """
    said = found.after.side
    if PierSide.UNKNOWN in (said, seen) or said is seen:
        return None
    return (
        f"the mount says that the tube is {said} of the pier, the image's rotation "
        f"({found.solution.rotation_deg:.1f}°) says {seen}: its limits on that side may be wrong; look at "
        "it, and set swap_sides of the mount if it is told the wrong way round"
    )


def crossing(
    equipment: Equipment, target: Target, side: PierSide, planned_s: float | None
) -> Crossing | None:
    """The first limit that tracking on `target` reaches within the planned time; along its path, if it moves.

    Parameters
    ----------
    side : PierSide
        On which the tube hangs.
    planned_s : float or None
        An hour if None.
    """
    mount, now = equipment.mount, equipment.clock.utc()
    within_s = LOOK_AHEAD_S if planned_s is None else planned_s
    if within_s <= 0.0:
        return None
    known_side = None if side is PierSide.UNKNOWN else side
    if isinstance(target, Icrs):
        found = mount.limits.reached(
            target,
            now,
            equipment.site,
            equipment.air,
            mounting=mount.mounting,
            side=known_side,
            within_s=within_s,
        )
    else:
        if target.ends_utc is not None:
            within_s = min(within_s, (target.ends_utc - now).total_seconds())
        found = reached_along(
            mount.limits,
            path_of(target, equipment.site),
            now,
            equipment.site,
            equipment.air,
            mounting=mount.mounting,
            side=known_side,
            within_s=within_s,
        )
    if found is None:
        return None
    when = now + timedelta(seconds=found.after_s)
    return Crossing(when, found.limit, _words(found.limit, found.after_s, found.alt_deg))


def _words(limit: LimitKind, after_s: float, alt_deg: float) -> str:
    minutes = after_s / 60.0
    if limit in (LimitKind.MERIDIAN, LimitKind.HOUR_ANGLE):
        return f"tracking reaches the {limit} limit in {minutes:.0f} min: the tube must change sides before"
    return f"tracking reaches the {limit} limit in {minutes:.0f} min, at altitude {alt_deg:.0f}°"


PLANNED_ANEW = 2
"""So often a slew that took another way is planned again: for its side of the pier, and for its rates.
Doubled, a mount that goes its own way is planned again four times before that is said."""


class Slewing:
    """Sends one telescope to places.

    Attributes
    ----------
    pace : Pace
        How long its slews take, learned from each.
    arrived_utc : datetime or None
        When the last one did.
    seen : Look or None
        The last look that was believed: how far beside the mount's belief the tube looked, in its segment.
    """

    def __init__(self, equipment: Equipment) -> None:
        self._equipment = equipment
        self.pace = Pace()
        self.arrived_utc: datetime | None = None
        self.seen: Look | None = None

    async def slew(
        self, target: Icrs, aim: Icrs | None = None, *, approach: Offset | None = None
    ) -> SlewReport:
        """Slew to `aim` so that the tube looks at `target`; both are checked before anything is sent.

        Parameters
        ----------
        aim : Icrs, optional
            The target, if left out.
        approach : Offset, optional
            Come there by a last leg from this place beside it.

        Raises
        ------
        OutsideLimits
        Cancelled
            A stop came.
        TargetNotReached
            The mount came to rest elsewhere.
        DeviceError, JournalFailed
        """
        aim = target if aim is None else aim
        await self._check(target)
        if approach is None:
            return await self._leg(aim)
        first = await self._leg(displaced(aim, approach.east_arcsec, approach.north_arcsec))
        # the tube may have changed sides on the first leg
        return replace(await self._leg(aim), side_before=first.side_before)

    async def _check(self, target: Icrs) -> None:
        equipment = self._equipment
        try:
            # by another sky than the mount's the limits would name a wrong cause
            await equipment.mount.require_agreement()
        except DeviceRefused as error:
            facts: dict[str, object] = {"order": "slew", "ra_deg": target.ra_deg, "dec_deg": target.dec_deg}
            await equipment.note(EntryKind.REFUSAL, error.what, facts)
            raise
        try:
            equipment.mount.limits.check(target, equipment.clock.utc(), equipment.site, equipment.air)
        except OutsideLimits as error:
            facts = {"limit": str(error.limit), "ra_deg": target.ra_deg, "dec_deg": target.dec_deg}
            await equipment.note(EntryKind.REFUSAL, error.what, facts)
            raise

    async def _leg(self, aim: Icrs) -> SlewReport:
        equipment = self._equipment
        mount, clock = equipment.mount, equipment.clock
        latest = equipment.readings.latest
        side_before = None if latest is None else latest.pier_side
        way_arcsec = None if latest is None else separation_arcsec(from_mount(latest.place), aim)
        equipment.listen("slewing", {"ra_deg": aim.ra_deg, "dec_deg": aim.dec_deg})
        kill_point("slewing")
        began = clock.monotonic_s()
        outcome = await self._sent(aim)
        kill_point("slewed")
        reading = await mount.reading()
        reported = from_mount(reading.place)
        miss = separation_arcsec(reported, aim)
        elapsed_s = clock.monotonic_s() - began
        report = SlewReport(outcome, aim, reported, miss, elapsed_s, side_before, reading.pier_side)
        if outcome is SlewOutcome.ARRIVED:
            self.arrived_utc = reading.utc
            if way_arcsec is not None and not report.flipped:
                self.pace.slewed(way_arcsec, elapsed_s)
        equipment.listen("slewed", {"outcome": str(outcome), "miss_arcsec": miss, "elapsed_s": elapsed_s})
        if report.flipped:
            sides = {"from": str(side_before), "to": str(reading.pier_side)}
            equipment.listen("flipped", dict(sides))
            await equipment.note(EntryKind.NOTE, "the slew changed sides of the pier", sides)
        if outcome is SlewOutcome.STOPPED:
            raise Cancelled("the slew was stopped", device=mount.name, advice="send it again when it is safe")
        if outcome is SlewOutcome.STALLED:
            raise TargetNotReached(
                f"the mount stopped {miss:.0f}″ from where it was sent",
                device=mount.name,
                advice="look at the mount before the next slew: is an axis blocked, or a clutch open?",
                reason=NotReached.REST,
            )
        return report

    async def _sent(self, aim: Icrs) -> SlewOutcome:
        """Send it; again, planned from where it stands, if it took another way and was stopped."""
        mount, clock = self._equipment.mount, self._equipment.clock
        for _ in range(PLANNED_ANEW):
            try:
                return await mount.slew(for_mount(aim, mount.epoch, clock.utc()))
            except WentAnotherWay as stopped:
                facts = {"ra_deg": aim.ra_deg, "dec_deg": aim.dec_deg}
                await self._equipment.note(EntryKind.DECISION, f"planned again: {stopped.what}", facts)
        return await mount.slew(for_mount(aim, mount.epoch, clock.utc()))

    # -- before anything moves -----------------------------------------------------------------------

    async def side_at(self, target: Icrs) -> PierSide:
        """The side on which the tube will hang there: foretold by the mount, or the present one.

        Across the meridian from there nobody knows whether it stays: unknown.
        """
        equipment = self._equipment
        mount = equipment.mount
        side: PierSide | None = None
        if Skill.DESTINATION_SIDE in mount.skills:
            side = await mount.destination_side(for_mount(target, mount.epoch, equipment.clock.utc()))
        if side is None and equipment.readings.latest is not None:
            side = equipment.readings.latest.pier_side
            here = icrs_to_hour_angle(target, equipment.clock.utc(), equipment.site, equipment.air)
            if side is not (PierSide.EAST if here.ha_deg >= 0.0 else PierSide.WEST):
                side = None
        return side or PierSide.UNKNOWN

    def aimed(self, target: Icrs, side: PierSide) -> Icrs:
        """Where to send the mount for the tube to look at `target`: by the model in force, or the target."""
        equipment = self._equipment
        if not equipment.apply_model or equipment.pointing.model_id is None:
            return target
        try:
            return equipment.pointing.aim(target, equipment.clock.utc(), side)
        except ModelRefused as error:
            equipment.note_now(
                EntryKind.DECISION,
                f"aimed without the model: {error.what}",
                {"ra_deg": target.ra_deg, "dec_deg": target.dec_deg},
            )
            return target

    def expected(self, target: Icrs, side: PierSide) -> Expected | None:
        """How far off the tube may look at `target`; None where the model can't say."""
        equipment = self._equipment
        try:
            return equipment.pointing.expected(target, equipment.clock.utc(), side)
        except ModelRefused:
            return None
