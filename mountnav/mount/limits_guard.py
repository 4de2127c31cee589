"""What a mount's readings mean to its limits: where it stands, whether it may go, when it has to stop.

On which side of the pier a German mount's tube hangs is what its readings say; where they don't, it is
followed from one reading to the next, from where a slew should have led; before the first one it is taken
to be where German mounts usually are.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from mountnav.devices import Epoch, MountAxis, MountReading, PierSide, for_mount, from_mount
from mountnav.errors import LimitKind, OutsideLimits
from mountnav.mount.axis_rates import Braking, RatesSeen, Unlike
from mountnav.mount.path_ahead import PathAhead
from mountnav.mount.pier_side import LOOK_AT_IT, STRAYS_DEG, SideFollowed, SideProof, SidesKept, SideUnproven
from mountnav.pointing.limits import Limits, Mounting, Reached, SlewCheck
from mountnav.pointing.limits.along import reached_by_axes
from mountnav.pointing.limits.bodies import SUN_DEG_PER_S, bodies
from mountnav.pointing.limits.detours import legs_to
from mountnav.pointing.limits.directions import of_body
from mountnav.pointing.limits.postures import Standing, from_the_meridian_deg, side_by_rule
from mountnav.pointing.limits.refusing import require_night, why
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.slews import FACES_DOUBT_DEG, POLE_DOUBT_DEG
from mountnav.pointing.limits.tracked import AT_POLE_DEG, VACUUM, standing_for, tracked_depths
from mountnav.pointing.limits.ways import strays_deg
from mountnav.sky.chain import icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site
from mountnav.sky.german_axes import COUNTERWEIGHT_DOWN_DEG
from mountnav.sky.sphere import separation_arcsec

BELOW_GROUND_DEG = -2.0
"""Lower than this no telescope looks, whatever refraction and an uneven horizon do. Refraction lifts by 0.6°
there, a hill's horizon sinks by about 1°. Doubled, a sync on a place under the ground passes."""

_SIDES = (PierSide.EAST, PierSide.WEST)
_WAYS_ROUND = 6
"""So many first places of ways round are asked of a mount that foretells its side. Doubled, a refusal takes
some seconds longer."""
_TAKES_SYNCS_S = 15.0
"""A sync may show so late, s. Doubled, a motion by hand right after one is taken for it."""
_AT_ITS_END_DEG = 2.0
"""So near to where it was sent, °, an axis doesn't turn away: 10′ from the pole a step of 20″ is as much.
Doubled, one that runs on past its end is stopped that much later."""
_OF_AXES = frozenset({LimitKind.MERIDIAN, LimitKind.UNREACHABLE})
_MISREPORTED = (
    "if the tube is on the other side of the pier than the mount says (look at it), set swap_sides = true "
    "of the mount"
)
_EITHER = (
    "nothing has shown which side of the pier the tube is on: order home, or park and unpark; if that is "
    "at the pole, it shows it when it leaves"
)


@dataclass(frozen=True, slots=True)
class Plan:
    """A slew that may be made.

    Attributes
    ----------
    legs : tuple of Icrs
        Places to slew to, one after the other; the last one is the target.
    check : SlewCheck
        Of the first leg.
    """

    legs: tuple[Icrs, ...]
    check: SlewCheck


class LimitsGuard:
    """The limits of one mount, applied to its readings.

    Parameters
    ----------
    mounting : {"german", "fork", "altaz"} or None
        None: not known.
    proof : SideProof, optional
        Of the side that the mount reports.
    """

    def __init__(
        self,
        limits: Limits,
        site: Site,
        air: Air,
        mounting: Mounting | None,
        proof: SideProof | None = None,
    ) -> None:
        self.limits = limits
        self.site = site
        self.air = air
        self.mounting = mounting
        self._followed = SideFollowed()
        self._latest: MountReading | None = None
        self._told_anew_utc: datetime | None = None
        self._rates = RatesSeen()
        self._kept = SidesKept()
        self.proof = proof or SideProof()
        self._set_out = False
        self.following: PathAhead | None = None
        """What it follows while rates beside the stars' are in force."""

    def set_out(self) -> None:
        """An order to move goes out: it isn't where it was switched on any more."""
        self._set_out = True
        self._told_anew_utc = None

    def saw(self, reading: MountReading) -> None:
        """Take in a reading: a mount that doesn't report its side is followed by it."""
        self._latest = reading
        if self.mounting != "german" or _told(reading):
            return
        place = from_mount(reading.place)
        bare = icrs_to_hour_angle(place, reading.utc, self.site, VACUUM)
        if abs(bare.dec_deg) >= POLE_DOUBT_DEG and (not self._set_out or self._followed.home):
            # by the pole the place says nothing of the axes; there it was switched on, or is about to leave
            pole_deg = math.copysign(90.0, bare.dec_deg)
            self._followed.at_home(
                reading.utc, Standing("german", PierSide.EAST, COUNTERWEIGHT_DOWN_DEG, pole_deg)
            )
            return
        told = self._told_anew_utc
        anew = told is not None and (reading.utc - told).total_seconds() <= _TAKES_SYNCS_S
        self._followed.seen(reading.utc, self._standings(reading, "german"), told_anew=anew)

    def told_anew(self, utc: datetime) -> None:
        """A sync goes out: soon after, until a slew, its place may change without a motion of its axes."""
        self._told_anew_utc = utc

    def stood(self, reading: MountReading) -> bool:
        """Take in where it stands before an order; whether that has proven the side that it reports."""
        if not _told(reading) or reading.slewing or self.mounting in ("fork", "altaz"):
            return False
        scene = Scene(self.limits, reading.utc, self.site)
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        return self.proof.stood(scene, standing_for(scene, here, "german", reading.pier_side))

    def side(self, reading: MountReading) -> PierSide | None:
        """On which side the tube hangs: as the mount says, or as it was followed."""
        return reading.pier_side if _told(reading) else self._followed.side

    def arrived(self, check: SlewCheck) -> None:
        """A slew has ended as it was checked: on which side the tube hangs now, and whether it kept it."""
        reading = self._latest
        self._followed.arrived(check.sides, self._faces(reading))
        if check.mounting != "german" or check.sure or reading is None or reading.slewing:
            return
        side = self.side(reading)
        if side is None or (_told(reading) and not self.proof.proven):
            return
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        if abs(here.dec_deg) < POLE_DOUBT_DEG:
            self._kept.hangs(side, here.ha_deg)

    def _faces(self, reading: MountReading | None) -> PierSide | None:
        """The side that faces where it points; None near the meridian and the pole."""
        if reading is None or reading.slewing:
            return None
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        if abs(here.dec_deg) >= POLE_DOUBT_DEG or from_the_meridian_deg(here.ha_deg) <= FACES_DOUBT_DEG:
            return None
        return side_by_rule(here.ha_deg)

    def lost_sight(self) -> None:
        """Nobody knows what became of it meanwhile."""
        self._followed.lost()
        self._kept.forget()

    def chooses_anew(self) -> None:
        """Somebody moves it by hand: it may take either side then, whatever it kept before."""
        self._kept.forget()

    def at_station(self) -> None:
        """It has come to its park position or its home: as if it had been switched on there."""
        self._set_out = False
        self._kept.forget()

    async def plan(
        self,
        reading: MountReading,
        target: Icrs,
        utc: datetime,
        destination: PierSide | None,
        foretold: Callable[[Icrs], Awaitable[PierSide | None]] | None = None,
    ) -> Plan:
        """How to get to a target: directly, or by way of other places if that isn't allowed.

        Parameters
        ----------
        destination : PierSide or None
            On which side the mount says that it would look at the target.
        foretold : callable, optional
            Asks it that of another place.

        Raises
        ------
        OutsideLimits
            Of the direct way, if no other is allowed.
        DeviceError
        """
        try:
            return Plan((target,), self.check_slew(reading, target, utc, destination))
        except SideUnproven:
            raise  # no way round shows it
        except OutsideLimits as refusal:
            tried: list[Icrs] = []
            plan = await self._way_round(reading, target, utc, foretold, None, tried)
            if plan is None and destination in _SIDES and self.side(reading) is None:
                # a mount that foretells its side shows it by where it comes to; on its word alone a way
                # is taken last, and only where nothing else tells where the tube hangs
                plan = await self._way_round(reading, target, utc, foretold, destination, tried)
            if plan is not None:
                return plan
            raise refusal from None

    async def _way_round(
        self,
        reading: MountReading,
        target: Icrs,
        utc: datetime,
        foretold: Callable[[Icrs], Awaitable[PierSide | None]] | None,
        destination: PierSide | None,
        tried: list[Icrs],
    ) -> Plan | None:
        """A plan by way of other places, of which the mount was asked of the first; `tried` grows."""
        for _ in range(_WAYS_ROUND):
            # it may take some tenths of a second, and a stop doesn't wait for it
            legs = await asyncio.to_thread(
                legs_to,
                self._reckoned,
                from_mount(reading.place),
                target,
                utc,
                self.site,
                self.air,
                self.mounting,
                self.side(reading),
                self._followed.either,
                tuple(tried),
                destination,
            )
            if not legs or (self.proof.wrong and _told(reading)):
                return None
            self._require_legs(reading, legs, utc)
            side = None if foretold is None else await foretold(legs[0])
            try:
                return Plan(legs, self.check_slew(reading, legs[0], utc, side, passing=True))
            except OutsideLimits:
                tried.append(legs[0])
        return None

    def check_slew(
        self,
        reading: MountReading,
        target: Icrs,
        utc: datetime,
        destination: PierSide | None,
        *,
        passing: bool = False,
    ) -> SlewCheck:
        """Check one slew from where the mount stands. Raises `OutsideLimits`.

        `passing`: it goes on from there at once, and doesn't track.
        """
        try:
            check = self._reckoned.check_slew(
                from_mount(reading.place),
                target,
                utc,
                self.site,
                self.air,
                mounting=self.mounting,
                side=self.side(reading),
                either=self._followed.either,
                destination=destination,
                track_for_s=0.0 if passing else None,
            )
        except OutsideLimits as refusal:
            told = _told(reading) or destination in _SIDES
            advice = [
                *([self._kept.advice] if self._kept.to_deg and refusal.limit in _OF_AXES else []),
                *([_EITHER] if self.mounting == "german" and self._followed.either else []),
                *([_MISREPORTED] if self.mounting == "german" and told and not self.proof.stated else []),
            ]
            if not advice:
                raise
            raise OutsideLimits(
                refusal.what,
                device=refusal.device,
                advice="; ".join([refusal.advice or "", *advice]),
                limit=refusal.limit,
            ) from None
        if check.mounting == "german" and _told(reading):
            self._require_on_both_sides(reading, check, passing=passing)
        return check

    def _require_on_both_sides(self, reading: MountReading, check: SlewCheck, *, passing: bool) -> None:
        """Refuse a way that isn't allowed if the reported side is wrong. Raises `OutsideLimits`."""
        if self.proof.wrong:
            raise OutsideLimits(
                "the slew isn't allowed: the mount reports the sides of the "
                "pier the wrong way round: it says "
                "that it points west with its tube on the west side, counterweight up",
                advice="look at the tube while it points west; if it is on the east side, set "
                "swap_sides = true of the mount, else swap_sides = false",
                limit=LimitKind.MERIDIAN,
            )
        scene = Scene(self.limits, reading.utc, self.site)
        ways = check.expected
        # at the pole, and not slewed there by us: it stands at home, its counterweight down
        from_home = not self._set_out and any(
            abs(abs(way.start.second_deg) - 90.0) < 90.0 - POLE_DOUBT_DEG for way in ways
        )
        if from_home:
            ways = tuple(way for way in ways if way.start.first_deg == COUNTERWEIGHT_DOWN_DEG) or ways
        for way in ways:
            self.proof.require(scene, way.start, way.end, from_home=from_home)
            if not passing:
                track_s = self.limits.slew_takes_s + self.limits.track_for_s
                self.proof.require_to_track(scene, way.end, track_s)

    def _may_be_misreported(self, reading: MountReading) -> bool:
        return _told(reading) and not self.proof.stated

    def advice_astray(self, reading: MountReading) -> str:
        """What to do about a mount that went another way than it was checked for."""
        advice = "send it to a place farther from the meridian first, or let it change sides by hand"
        return f"{advice}; {_MISREPORTED}" if self._may_be_misreported(reading) else advice

    def advice_beyond(self, reading: MountReading, limit: LimitKind) -> str:
        """What to do about a mount that came outside a limit on its way."""
        advice = "see where it stands; it took another path than expected (side of the pier, rates)"
        misreported = limit is LimitKind.MERIDIAN and self._may_be_misreported(reading)
        return f"{advice}; {_MISREPORTED}" if misreported else advice

    def _require_legs(self, reading: MountReading, legs: tuple[Icrs, ...], utc: datetime) -> None:
        """Refuse a way round if a later part hangs on a side that isn't proven. Raises `SideUnproven`."""
        if not self.unproven(reading):
            return
        scene = Scene(self.limits, utc, self.site)
        start, side = from_mount(reading.place), self.side(reading)
        for leg in legs:
            check = self._reckoned.check_slew(
                start, leg, utc, self.site, self.air, mounting=self.mounting, side=side, track_for_s=0.0
            )
            for way in check.expected:
                self.proof.require(scene, way.start, way.end)
            if len(check.sides) != 1:
                return
            start, side = leg, check.sides[0]

    @property
    def _reckoned(self) -> Limits:
        """The limits, with ways for the rates at which the axes were seen to turn."""
        return self._kept.reckoned(self._rates.reckoned(self.limits))

    @staticmethod
    def for_mount(place: Icrs, epoch: Epoch, utc: datetime) -> Apparent | Icrs:
        """A place as the mount wants it."""
        return for_mount(place, epoch, utc)

    def require_above_ground(self, place: Icrs, utc: datetime) -> None:
        """Refuse a place where no telescope at this site can point at this hour. Raises `OutsideLimits`."""
        seen = icrs_to_observed(place, utc, self.site, self.air)
        if seen.alt_deg < BELOW_GROUND_DEG:
            raise OutsideLimits(
                f"the place is at altitude {seen.alt_deg:.1f}° at this hour: no telescope can point there",
                advice="nothing was synced; check this machine's clock, the site and the frame's time",
            )

    def require_night(self, utc: datetime) -> None:
        """Refuse what isn't done by day, if the limits say so. Raises `OutsideLimits`."""
        require_night(self.limits, utc, self.site)

    def reached(self, reading: MountReading, *, within_s: float = 43200.0) -> Reached | None:
        """Which limit tracking from where the mount stands reaches first, and when."""
        found = [self._reached(reading, side, within_s) for side in self.sides(reading)]
        return min(
            (reached for reached in found if reached is not None),
            key=lambda reached: reached.after_s,
            default=None,
        )

    def _reached(self, reading: MountReading, side: PierSide | None, within_s: float) -> Reached | None:
        if self.following is not None:
            return self.following.reached(self.limits, reading, side, within_s)
        return self.limits.reached(
            from_mount(reading.place),
            reading.utc,
            self.site,
            self.air,
            mounting=self.mounting,
            side=side,
            within_s=within_s,
        )

    def sides(self, reading: MountReading) -> list[PierSide | None]:
        """On which sides its tube may hang: both while the one it says isn't proven."""
        return [*_SIDES] if self.unproven(reading) else [self.side(reading)]

    def left_alone(self, reading: MountReading, utc: datetime) -> tuple[Icrs, float]:
        """Where a mount that tracks or follows comes to until then, and how many ″ the rates lead it."""
        place = from_mount(reading.place)
        if self.following is None:
            return place, 0.0
        there = self.following.leads(reading)(utc)
        return there, separation_arcsec(place, there)

    def turns_into(
        self, reading: MountReading, rates_deg_s: Mapping[MountAxis, float], within_s: float
    ) -> Reached | None:
        """Which limit axes that turn at these speeds, beside tracking, reach first, and when.

        Speeds are those of `MovesAxes.move_axis`: right ascension (azimuth), and declination (altitude).
        """
        sides = self.sides(reading)
        if self.mounting == "german" and not _told(reading) and self._followed.either:
            sides = [*_SIDES]
        here, bare = (
            icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, air)
            for air in (self.air, VACUUM)
        )
        found = [
            reached_by_axes(
                Scene(self.limits, reading.utc, self.site),
                here,
                bare,
                (rates_deg_s.get("primary", 0.0), rates_deg_s.get("secondary", 0.0)),
                mounting=self.mounting,
                side=side,
                tracks=reading.tracking is not False,
                within_s=within_s,
            )
            for side in sides
        ]
        return min(
            (reached for reached in found if reached is not None),
            key=lambda reached: reached.after_s,
            default=None,
        )

    def unproven(self, reading: MountReading) -> bool:
        """Whether its tube may hang on the other side than it reports, and limits depend on it."""
        if not _told(reading) or self.mounting in ("fork", "altaz"):
            return False
        scene = Scene(self.limits, reading.utc, self.site)
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        return self.proof.ambiguous(scene, standing_for(scene, here, "german", reading.pier_side))

    def check_tracking(self, reading: MountReading, utc: datetime, lead_s: float) -> None:
        """Refuse to begin to track where that leads out of the limits at once. Raises `OutsideLimits`."""
        soon = self.reached(reading, within_s=max(lead_s, 60.0))
        if soon is None or soon.after_s > lead_s:
            return
        place = Observed(soon.az_deg, soon.alt_deg, utc)
        advice = "slew to a place within the limits first"
        if soon.limit is LimitKind.MERIDIAN and self.unproven(reading):
            advice = f"{advice}; nothing has shown yet which side of the pier the tube is on: {LOOK_AT_IT}"
        raise OutsideLimits(
            f"tracking here leads in {soon.after_s:.0f} s to altitude {soon.alt_deg:.1f}°, azimuth "
            f"{soon.az_deg:.0f}°, {why(self.limits, soon.limit, 0.0, place)}",
            advice=advice,
            limit=soon.limit,
        )

    def depths(self, reading: MountReading, *, passing: bool) -> dict[LimitKind, float]:
        """How deep outside each limit the mount stands (above 0: outside), margins left out.

        Parameters
        ----------
        passing : bool
            Whether it is on its way: what holds for standing only is left out.
        """
        scene = Scene(self.limits, reading.utc, self.site)
        place = from_mount(reading.place)
        here, bare = (icrs_to_hour_angle(place, reading.utc, self.site, air) for air in (self.air, VACUUM))
        depths, _ = tracked_depths(
            scene,
            here,
            np.zeros(1),
            bare=bare,
            mounting=self.mounting,
            side=self.side(reading),
            standing=not passing,
        )
        found = {limit: float(depth[0]) for limit, depth in depths.items()}
        if passing:
            gone = [LimitKind.HOUR_ANGLE, LimitKind.DAYLIGHT]
            if self.mounting == "german" and not _told(reading):
                # on which side it is on its way nobody knows
                gone += [LimitKind.MERIDIAN, LimitKind.UNREACHABLE]
            for limit in gone:
                found.pop(limit, None)
        return found

    def strays(self, reading: MountReading, check: SlewCheck) -> bool:
        """Whether a mount of which the way had to be guessed goes another one."""
        if check.sure:
            return False
        stands = self._stands(reading, check)
        if min(strays_deg(check.expected, standing) for standing in stands) <= STRAYS_DEG:
            return False
        if not self._kept.strayed(check, stands, self.side(reading)):
            # then it didn't begin on that side, if it doesn't report its side
            self._followed.lost(astray=True)
        return True

    def unlike(self, before: MountReading, reading: MountReading, check: SlewCheck) -> Unlike | None:
        """Whether its axes turn, between two readings on the way, at other rates than it was checked for."""
        scene = Scene(self.limits, reading.utc, self.site)
        then, now = (self._stands(read, check) for read in (before, reading))
        return self._rates.unlike(check.expected, then, now, scene)

    def overruns(self, braking: Braking, reading: MountReading, check: SlewCheck) -> float | None:
        """Where its first axis would come to rest beyond a limit, if it were stopped now; None: within.

        It brakes by itself before an end of the ways that are allowed; only what turns away from all of them
        has to be stopped. One that doesn't report its side has its axes anywhere.
        """
        if check.mounting != "german" or not _told(reading):
            return None
        scene = Scene(self.limits, reading.utc, self.site)
        place = from_mount(reading.place)
        bare = icrs_to_hour_angle(place, reading.utc, self.site, VACUUM)
        if 90.0 - abs(bare.dec_deg) <= AT_POLE_DEG:
            return None
        # as the mount reckons: by the pole refraction alone seems to turn the axis
        now = standing_for(scene, bare, check.mounting, reading.pier_side)
        rests_deg = braking.rests_at_deg(reading.utc, now)
        if rests_deg is None:
            return None
        turns = math.copysign(1.0, rests_deg - now.first_deg)
        if any(turns * (end_deg - now.first_deg) > -_AT_ITS_END_DEG for end_deg in check.ends_deg):
            return None
        stands, rests = (
            scene.axis_depths(now, np.array([angle_deg])) for angle_deg in (now.first_deg, rests_deg)
        )
        deeper = any(
            depth[0] > max(0.0, stands[limit][0]) for limit, depth in rests.items() if limit in _OF_AXES
        )
        return rests_deg if deeper else None

    def _stands(self, reading: MountReading, check: SlewCheck) -> list[Standing]:
        """How it may stand on a way: on both sides of the pier, where it doesn't report its side."""
        return [*self._standings(reading, check.mounting).values()]

    def _standings(self, reading: MountReading, kind: Mounting) -> dict[PierSide, Standing]:
        scene = Scene(self.limits, reading.utc, self.site)
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        told = reading.pier_side if _told(reading) else None
        return {side: standing_for(scene, here, kind, side) for side in ([told] if told else _SIDES)}

    def sun_would_come(self, reading: MountReading, within_s: float = 10800.0) -> bool:
        """Whether a tube that stands still where it is would have the Sun come nearer."""
        latitude_deg = self.site.latitude_deg
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        later = np.linspace(0.0, within_s * SUN_DEG_PER_S, 37)
        sun = of_body(bodies(reading.utc, self.site).sun, latitude_deg, later)
        apart = sun.separation_deg(of_body(here, latitude_deg))
        return float(apart.min()) < float(apart[0]) - 1.0

    def sun_is_down(self, utc: datetime, doubt_deg: float) -> bool:
        """Whether the Sun stands in nobody's way, even if the hour angle is wrong by so much."""
        if self.limits.sun_cone_deg <= 0.0:
            return True
        turned = np.array([-abs(doubt_deg), 0.0, abs(doubt_deg)])
        sun = of_body(bodies(utc, self.site).sun, self.site.latitude_deg, turned)
        return bool(sun.altitude_deg.max() < self.limits.sun_cone_from_altitude_deg)

    def seen(self, reading: MountReading) -> Observed:
        """Where the mount points, as the horizon counts."""
        return icrs_to_observed(from_mount(reading.place), reading.utc, self.site, self.air)


def _told(reading: MountReading) -> bool:
    return reading.pier_side in _SIDES
