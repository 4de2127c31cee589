"""First light: a telescope that was set up by eye is synced, and its camera is learned.

A new mount is off by degrees: further than a sync may be. A lost one may be recovered by two frames; but a
German mount takes a place for the posture that it believes in, and as long as the camera's angle is not known
no frame shows the posture. A motion does: in the wrong posture the declination axis turns the wrong way. So
the tube is moved a little, within the limits and with the whole offset as a margin, and has to be seen going
where the mount says.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

from mountnav.devices import from_mount
from mountnav.errors import (
    NotReached,
    OffsetTooLarge,
    OutsideLimits,
    SyncDoubt,
    SyncRefused,
    TargetNotReached,
)
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.look_retries import PersistentLook
from mountnav.navigation.policy import CenteringPolicy, Tactic
from mountnav.navigation.recovering import (
    FURTHEST_DEG,
    RecoverySync,
    require_above_ground,
    require_rightly_set,
    sync_or_count_by_sight,
    tracked,
    two_that_agree,
)
from mountnav.navigation.reports import FirstLightReport, Look
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.sync import SyncTrigger
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import HourAngle, Icrs
from mountnav.sky.sphere import Offset, displaced, offset_arcsec

STEP_DEG = 1.5
"""Of the small moves: well beyond all play, and within the margin. Doubled, they leave more of the limits."""
AWAY_FROM_POLE_DEG = 20.0
"""So far from the pole a polar axis 5° off leaves the directions of the axes known to 15°. atan(5° / 20°) =
14°. Halved, 27°: a step in the right posture would look like one across."""
FOLLOWS = 0.35
"""So much of a step may be missing or across: axes that lie 5° otherwise turn it by 15° (0.26). Doubled, a
step that goes 40° astray passes; at 0.26 an honest mount 5° off would fail."""
_ROOM_DEG = 4.0
"""So far above the lowest altitude, the offset besides, there is room for the small steps, °: two steps and a
half of `STEP_DEG`. Doubled, low targets are left though there is room."""
_HALVES = ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0))
"""Ways of the small steps, in `STEP_DEG` of hour angle and declination."""


async def first_light(
    equipment: Equipment, policy: CenteringPolicy, slewing: Slewing, exposure_s: float | None = None
) -> FirstLightReport:
    """Learn where a telescope truly points that was set up by eye, and sync its mount.

    Two frames, solved anywhere in the sky, must agree on a place above the ground and no further than
    `FURTHEST_DEG` from what the mount believes. From the pole, or too low, the tube goes high first.
    Then it is moved by a degree and a half in declination, and has to be seen going there. Then the mount is
    synced on the last look and read back, and two more small moves show that it follows, and teach the
    camera's angle. All moves keep the limits with the offset seen as a margin. On failure nothing was synced.

    Raises
    ------
    OffsetTooLarge
        Further off than that, or frames disagree.
    TargetNotReached
        The tube didn't go where the mount says.
    SyncRefused
        The mount takes itself to be in the other posture; or as `GuardedSync.commit`.
    OutsideLimits
        The place is below the ground, or no small move is allowed from there.
    SolveFailed, BadFrame, MountMoved, SyncIgnored, DeviceError, JournalFailed
    """
    run = _FirstLight(equipment, policy, slewing, exposure_s)
    return await run.run()


class _FirstLight:
    def __init__(
        self, equipment: Equipment, policy: CenteringPolicy, slewing: Slewing, exposure_s: float | None
    ) -> None:
        self._equipment = equipment
        self._policy = policy
        self._slewing = slewing
        self._exposure_s = exposure_s
        self._looks = 0
        self._synced = False
        self._limits = equipment.mount.limits

    async def run(self) -> FirstLightReport:
        equipment, mount = self._equipment, self._equipment.mount
        began = equipment.clock.monotonic_s()
        equipment.listen("first-light", {})
        await mount.require_unparked("sync")
        was_trusted = mount.trusted
        async with tracked(equipment):
            try:
                first = await self._seen()
                # the pole doesn't show how far the hour angle is off
                at_pole = 90.0 - abs(self._hour_angle(first).dec_deg) < AWAY_FROM_POLE_DEG
                off_deg = FURTHEST_DEG if at_pole else first.offset.total_arcsec / 3600.0
                with mount.wider_margin(off_deg):
                    if not was_trusted:
                        # the sky says that it is right to some degrees: enough for small moves with that
                        # margin
                        mount.trust()
                    found = await self._moved_as_told(await self._to_a_good_place(first))
                    guard = equipment.guard
                    guard.learned.forget()
                    kill_point("first light: sync")
                    told = await sync_or_count_by_sight(
                        equipment, self._policy, found, self._look, SyncTrigger.FIRST_LIGHT
                    )
                    self._synced = True
            except BaseException:
                if not was_trusted:
                    mount.distrust("a first light didn't come to its end")
                raise
        after = await self._verified(told)
        learned = equipment.guard.learned
        return FirstLightReport(
            outcome=told.outcome,
            first=first,
            synced=told.look,
            last=after,
            altitude_deg=self._altitude_deg(after.seen, after),
            looks=self._looks,
            learned=learned.words,
            read_back=told.read_back,
            read_back_miss_arcsec=told.miss_arcsec,
            elapsed_s=equipment.clock.monotonic_s() - began,
        )

    # -- looks ---------------------------------------------------------------------------------------

    async def _look(self) -> Look:
        policy = self._policy
        resting = replace(
            policy.persistence, tactics=policy.persistence.tactics - {Tactic.NEIGHBOR, Tactic.WIDER}
        )
        looking = PersistentLook(
            self._equipment, policy, resting, used="first light", anywhere=True, teaches=self._synced
        )
        self._looks += 1
        return (await looking.look(self._exposure_s)).look

    async def _seen(self) -> Look:
        """Where it truly looks, by two frames that agree; refused where that can't be."""
        equipment = self._equipment
        _, found, apart = await two_that_agree(equipment, self._policy, self._look)
        altitude_deg = require_above_ground(found, self._limits, equipment.site, equipment.air)
        require_rightly_set(found, equipment.mount, device=equipment.name)
        off_deg = found.offset.total_arcsec / 3600.0
        if off_deg > FURTHEST_DEG:
            raise OffsetTooLarge(
                f"the tube looks {off_deg:.1f}° from where the mount believes (a first light goes to "
                f"{FURTHEST_DEG:g}°)",
                device=equipment.name,
                advice="nothing was synced; set clock, time zone and longitude of the mount right, and of "
                "this machine and [site]; put the tube at its home or park position by hand, say trust, and "
                "order first light again",
            )
        facts = {
            "look_id": found.look_id,
            "ra_deg": found.seen.ra_deg,
            "dec_deg": found.seen.dec_deg,
            "apart_arcsec": apart,
            "offset_arcsec": found.offset.total_arcsec,
            "altitude_deg": altitude_deg,
        }
        equipment.listen("confirmed", facts)
        kill_point("first light: seen")
        return found

    # -- motions -------------------------------------------------------------------------------------

    async def _to_a_good_place(self, found: Look) -> Look:
        """Leave the pole, where no frame shows how the axes lie, and places too low for a step."""
        here = self._hour_angle(found)
        lowest_deg = self._limits.min_altitude_deg + _ROOM_DEG + found.offset.total_arcsec / 3600.0
        altitude_deg = self._altitude_deg(found.seen, found)
        if 90.0 - abs(here.dec_deg) >= AWAY_FROM_POLE_DEG and altitude_deg >= lowest_deg:
            return found
        north = math.copysign(1.0, self._equipment.site.latitude_deg)
        highest_dec = 90.0 - AWAY_FROM_POLE_DEG - found.offset.total_arcsec / 3600.0
        near = math.copysign(1.0, here.ha_deg)
        aims = [
            (side * near * ha_deg, north * min(dec_deg, highest_dec))
            for dec_deg in (55.0, 40.0, 65.0, 20.0)
            for side in (1, -1)
            for ha_deg in (35.0, 55.0)
        ]
        await self._to_the_first(aims)
        return await self._seen()

    async def _to_the_first(self, aims: list[tuple[float, float]]) -> None:
        refused: OutsideLimits | None = None
        equipment = self._equipment
        for ha_deg, dec_deg in aims:
            now = equipment.clock.utc()
            place = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, now), equipment.site, equipment.air)
            try:
                await self._slewing.slew(place)
            except OutsideLimits as error:
                refused = refused or error
            else:
                return
        assert refused is not None
        raise refused

    async def _moved_as_told(self, found: Look) -> Look:
        """Move a little in declination; the look there, if the tube went where the mount says."""
        again = await self._stepped(found, self._ways(found))
        told = offset_arcsec(again.believed, found.believed)
        seen = offset_arcsec(again.seen, found.seen)
        length = told.total_arcsec
        along = (told.east_arcsec * seen.east_arcsec + told.north_arcsec * seen.north_arcsec) / length
        miss = math.hypot(seen.east_arcsec - told.east_arcsec, seen.north_arcsec - told.north_arcsec)
        equipment = self._equipment
        if miss <= FOLLOWS * length:
            return again
        words = f"the mount says that it moved {length:.0f}″, the tube went {seen.total_arcsec:.0f}″"
        if along < -0.5 * length:
            raise SyncRefused(
                f"{words}, in the opposite direction: it believes that it is on the other side of the pier",
                device=equipment.name,
                advice="nothing was synced; let it find its home, or put the tube at its home or park "
                "position by hand, say trust, and order first light again",
                doubts=(SyncDoubt.WRONG_SIDE,),
            )
        raise TargetNotReached(
            f"{words}, {miss:.0f}″ from there",
            device=equipment.name,
            advice="nothing was synced; is a clutch open, does the camera sit firmly? then order first "
            "light again",
            reason=NotReached.STUCK,
        )

    async def _stepped(self, found: Look, ways: list[tuple[float, float]]) -> Look:
        """Move by a small step the first way that is allowed, and look."""
        equipment, refused = self._equipment, None
        arcsec = 3600.0 * STEP_DEG
        for east, north in ways:
            now = from_mount((await equipment.mount.reading()).place)
            try:
                # both where it looks and where it believes to look
                there = displaced(found.seen, arcsec * east, arcsec * north)
                self._require_within(there)
                await self._slewing.slew(displaced(now, arcsec * east, arcsec * north))
            except OutsideLimits as error:
                refused = refused or error
                continue
            looked = await self._look()
            kill_point("first light: stepped")
            return looked
        assert refused is not None
        raise refused

    def _require_within(self, place: Icrs) -> None:
        equipment = self._equipment
        limits = replace(self._limits, margin_deg=0.0)
        limits.check(place, equipment.clock.utc(), equipment.site, equipment.air)

    def _ways(self, found: Look) -> list[tuple[float, float]]:
        """In declination alone: first up, away from the horizon."""

        def altitude_deg(north: float) -> float:
            return self._altitude_deg(displaced(found.seen, 0.0, 3600.0 * STEP_DEG * north), found)

        near_pole = 90.0 - abs(self._hour_angle(found).dec_deg) < AWAY_FROM_POLE_DEG + 2.0 * STEP_DEG
        north = math.copysign(1.0, self._equipment.site.latitude_deg)
        ways = sorted((1.0, -1.0), key=altitude_deg, reverse=True)
        if near_pole:
            ways = sorted(ways, key=lambda one: one * north)
        return [(0.0, way) for way in ways]

    async def _verified(self, told: RecoverySync) -> Look:
        """Two more looks, a small step apart: what was synced holds, and the camera's angle is learned.

        Raises
        ------
        OffsetTooLarge
            The tube doesn't look where the mount was synced: the sync stays, and the position doesn't count.
        """
        equipment = self._equipment
        allowed = 0.1 * 3600.0 * STEP_DEG + 2.0 * equipment.mount.resolution_arcsec
        off = Offset(0.0, 0.0) if told.outcome.seen else told.look.offset
        found = await self._look()
        for ways in (_HALVES, (*_HALVES[2:], *_HALVES[:2])):
            miss_arcsec = math.hypot(
                found.offset.east_arcsec - off.east_arcsec, found.offset.north_arcsec - off.north_arcsec
            )
            if miss_arcsec > allowed:
                words = f"after the sync the tube looks {miss_arcsec:.0f}″ from where it was told"
                equipment.mount.distrust(words)
                raise OffsetTooLarge(
                    words,
                    device=equipment.name,
                    advice="its position is not trusted: does a clutch slip, does it take syncs as it "
                    "should? then order first light again",
                )
            with contextlib.suppress(OutsideLimits):
                found = await self._stepped(found, list(ways))
        return found

    def _altitude_deg(self, place: Icrs, found: Look) -> float:
        equipment = self._equipment
        return icrs_to_observed(place, found.mid_exposure_utc, equipment.site, equipment.air).alt_deg

    def _hour_angle(self, found: Look) -> HourAngle:
        equipment = self._equipment
        return icrs_to_hour_angle(found.seen, found.mid_exposure_utc, equipment.site, equipment.air)


__all__ = ["FURTHEST_DEG", "first_light"]
