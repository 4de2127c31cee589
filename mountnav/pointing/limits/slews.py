"""A slew checked before it is ordered: the target, all ways the mount may take, the tracking afterwards.

Which posture a German mount will take is asked from it where it can tell. Where it can't, it is expected on
the side that looks the target's way, or, if the axes don't reach it from there, on the other one; near the
meridian it may as well stay where it is, and then both have to be allowed as far as the axes reach.
Elsewhere it is seen and stopped if it stays; so far that has to be allowed. A mount of which nothing is
known is checked as a fork or, if it says on which side its tube hangs, as a German one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from mountnav.devices import PierSide
from mountnav.errors import LimitKind, OutsideLimits
from mountnav.pointing.limits import refusing
from mountnav.pointing.limits.postures import (
    Mounting,
    Standing,
    Way,
    from_the_meridian_deg,
    side_by_rule,
    standing_at,
    ways_between,
)
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.tracked import AT_POLE_DEG, VACUUM, reached_from
from mountnav.pointing.limits.ways import Trouble, trouble_on
from mountnav.sky.chain import hour_angle_to_observed, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Observed, Site
from mountnav.sky.german_axes import COUNTERWEIGHT_DOWN_DEG

if TYPE_CHECKING:
    from mountnav.pointing.limits.bounds import Limits

SIDE_DOUBT_DEG = 15.0
"""So near to the meridian a German mount may look at a target from either side, as its maker likes."""

POLE_DOUBT_DEG = 88.0
"""Nearer to the pole than this the place doesn't tell how the hour angle axis stands."""

SEEN_AFTER_DEG = 30.0
"""So far an axis may have turned before a mount is stopped that goes another way than expected."""

FACES_DOUBT_DEG = 2.0
"""So near to the meridian, °, a mount may count a place on the other half of the sky: by its clock, its site,
its zero points. Doubled, more mounts that don't tell their side have both of them reckoned with."""

STAYS_ROOM_DEG = 1.0
"""A mount that stays on its side for a place does so for one that much, °, farther past the meridian: targets
drift between two tries. Doubled, hardly more places are gone round."""

_SIDES = (PierSide.EAST, PierSide.WEST)
_Pair = tuple[PierSide, PierSide]


@dataclass(frozen=True, slots=True)
class SlewCheck:
    """What was checked.

    Attributes
    ----------
    mounting : {"german", "fork", "altaz"}
        As which it was checked.
    ways : tuple of str
        All that the mount may take; each was allowed.
    refused : tuple of str
        Those that weren't, and that it isn't expected to take.
    sides : tuple of PierSide
        On which it may arrive; empty if not German.
    expected : tuple of Way
        All ways that are allowed, as angles of the axes: also those that it isn't expected to take.
    sure : bool
        Whether nothing had to be guessed of them. Otherwise it has to be watched that it takes one of them.
    unasked : tuple of Way
        Those that aren't allowed and that a German mount may take unasked: it stays on its side, or changes.
    ends_deg : tuple of float
        Angles of the first axis at which the expected ways end, by where the target is seen and as a mount
        reckons it that knows nothing of refraction: by the pole they differ by degrees.
    """

    mounting: Mounting
    ways: tuple[str, ...]
    refused: tuple[str, ...]
    sides: tuple[PierSide, ...]
    expected: tuple[Way, ...] = ()
    sure: bool = True
    unasked: tuple[Way, ...] = ()
    ends_deg: tuple[float, ...] = ()

    @property
    def facts(self) -> dict[str, object]:
        """For the journal."""
        return {
            "checked_as": self.mounting,
            "ways": list(self.ways),
            "not_expected": list(self.refused),
            "sides": [str(side) for side in self.sides],
        }


@dataclass(frozen=True, slots=True)
class _Judged:
    way: Way
    limit: LimitKind | None
    text: str
    tracked: bool = False


def check_slew(
    limits: Limits,
    start: Icrs,
    target: Icrs,
    utc: datetime,
    site: Site,
    air: Air,
    *,
    mounting: Mounting | None,
    side: PierSide | None,
    either: bool = False,
    destination: PierSide | None,
    track_for_s: float,
) -> SlewCheck:
    """Check a slew; see `Limits.check_slew`."""
    refusing.check_place(limits, target, utc, site, air)
    scene = Scene(limits, utc, site)
    here = icrs_to_hour_angle(start, utc, site, air)
    there, bare = (icrs_to_hour_angle(target, utc, site, one) for one in (air, VACUUM))
    known = side if side in _SIDES else None
    kind: Mounting = mounting or ("german" if known or destination in _SIDES else "fork")
    expected, others = _sides(scene, here, there, kind, known, destination, either)

    def judged(pairs: list[_Pair]) -> list[_Judged]:
        track_s = limits.slew_takes_s + track_for_s
        return [one for pair in pairs for one in _judged(scene, here, there, bare, kind, pair, track_s)]

    ways = judged(expected)
    told = destination in _SIDES
    starts = [known or side_by_rule(here.ha_deg)]
    if either and known is None:
        starts = [*dict.fromkeys(pair[0] for pair in expected)]
    # unasked it may stay; where it was seen to stay, it may change
    astray = {
        (one, side_by_rule(there.ha_deg))
        if _seen_to_stay(_stayed(scene, here, one, known), there)
        else (one, one)
        for one in starts
    }
    begun = [] if told else [_begun(scene, here, there, pair) for pair in others if pair in astray]
    bad = [one for one in [*ways, *begun] if one.limit is not None]
    if bad:
        _refuse(scene, bad[0], [one for one in [*ways, *judged(others)] if one.text != bad[0].text])
    # what it isn't expected to do, but may, needs no stopping
    unasked = [] if kind != "german" or told else judged(others)
    spare = [one for one in unasked if one.limit is None]
    going = [*ways, *spare]
    reckoned = [_standing(scene, bare, kind, one.way.end.side).first_deg for one in going]
    return SlewCheck(
        kind,
        tuple(dict.fromkeys(one.text for one in ways)),
        tuple(one.text for one in begun),
        _arrives_on([*(one.way for one in ways), *(one.way for one in spare)], there)
        if kind == "german"
        else (),
        tuple(one.way for one in going),
        sure=kind != "german" or told,
        unasked=tuple(one.way for one in unasked if one.limit is not None),
        ends_deg=tuple(dict.fromkeys([*(one.way.end.first_deg for one in going), *reckoned])),
    )


def _arrives_on(ways: list[Way], there: HourAngle) -> tuple[PierSide, ...]:
    """Sides on which it may arrive by these ways: none leads it to change to the side that looks away."""
    near = from_the_meridian_deg(there.ha_deg) <= FACES_DOUBT_DEG
    faces = side_by_rule(there.ha_deg)
    sides = [one.end.side for one in ways if near or one.end.side in (one.start.side, faces)]
    return tuple(dict.fromkeys(sides or [one.end.side for one in ways]))


def _sides(
    scene: Scene,
    here: HourAngle,
    there: HourAngle,
    kind: Mounting,
    known: PierSide | None,
    destination: PierSide | None,
    either: bool,
) -> tuple[list[_Pair], list[_Pair]]:
    """Pairs of sides (now, then) that are to be expected, and the others."""
    if kind != "german":
        return [(PierSide.UNKNOWN, PierSide.UNKNOWN)], []
    starts = [known] if known else _likely(scene, here, either)
    expected = [
        (start, end)
        for start in starts
        for end in _ends(_stayed(scene, here, start, known), there, start, destination)
    ]
    pairs = [(start, end) for start in starts for end in _SIDES]
    return expected, [pair for pair in pairs if pair not in expected]


def _ends(scene: Scene, there: HourAngle, start: PierSide, destination: PierSide | None) -> list[PierSide]:
    """Sides on which a slew may end that starts on one."""
    if destination is not None and destination in _SIDES:
        return [destination]
    usual = side_by_rule(there.ha_deg)
    reached = [side for side in _SIDES if _reaches(scene, there, side)]
    if usual not in reached:
        return reached or [usual]
    if _seen_to_stay(scene, there):
        return [start]
    # near the meridian it may as well stay; but none changes to the side that looks the other way
    may_stay = start in reached and from_the_meridian_deg(there.ha_deg) <= SIDE_DOUBT_DEG
    return list(dict.fromkeys([usual, start] if may_stay else [usual]))


def _seen_to_stay(scene: Scene, place: HourAngle) -> bool:
    """Whether for a place so far past the meridian the mount was seen to stay on its side."""
    return from_the_meridian_deg(place.ha_deg) <= scene.limits.stays_to_deg


def _stayed(scene: Scene, here: HourAngle, start: PierSide, known: PierSide | None) -> Scene:
    """The scene for a mount of which it is supposed that it hangs on one side.

    If that is the one that looks the other way, it has stayed on it as far past the meridian as it points.
    """
    if known is not None or start is side_by_rule(here.ha_deg):
        return scene
    past_deg = max(scene.limits.stays_to_deg, from_the_meridian_deg(here.ha_deg) + STAYS_ROOM_DEG)
    return replace(scene, limits=replace(scene.limits, stays_to_deg=past_deg))


def _likely(scene: Scene, here: HourAngle, either: bool) -> list[PierSide]:
    """Sides on which the tube of a mount may hang that doesn't tell it."""
    usual = side_by_rule(here.ha_deg)
    other = next(side for side in _SIDES if side is not usual)
    near = from_the_meridian_deg(here.ha_deg) <= SIDE_DOUBT_DEG
    # no order led where the axes aren't allowed
    stayed = (either or _seen_to_stay(scene, here)) and _reaches(scene, here, other)
    return [usual, other] if near or stayed else [usual]


def _reaches(scene: Scene, there: HourAngle, side: PierSide) -> bool:
    standing = _standing(scene, there, "german", side)
    return all(depth[0] <= 0.0 for depth in scene.axis_depths(standing).values())


def _standing(scene: Scene, place: HourAngle, kind: Mounting, side: PierSide) -> Standing:
    seen = hour_angle_to_observed(place, scene.site)
    return standing_at(place, seen, kind, side, scene.site.latitude_deg)


def _judged(
    scene: Scene,
    here: HourAngle,
    there: HourAngle,
    bare: HourAngle,
    kind: Mounting,
    sides: tuple[PierSide, PierSide],
    track_s: float,
) -> list[_Judged]:
    end = _standing(scene, there, kind, sides[1])
    return [
        _judge(scene, way, there, bare, track_s)
        for start in _starts(_standing(scene, here, kind, sides[0]), here)
        for way in ways_between(start, end, scene.limits.first_axis_deg)
    ]


def _starts(start: Standing, here: HourAngle) -> list[Standing]:
    """How the axes may stand now.

    At the pole the place says next to nothing of the hour angle axis: refraction alone turns it by a right
    angle. There a mount usually stands at home, with the counterweight down or a fork on the meridian.
    """
    if start.mounting == "altaz" or abs(here.dec_deg) < POLE_DOUBT_DEG:
        return [start]
    home_deg = COUNTERWEIGHT_DOWN_DEG if start.mounting == "german" else 0.0
    return [start, replace(start, first_deg=home_deg)]


def _begun(scene: Scene, here: HourAngle, there: HourAngle, sides: _Pair) -> _Judged:
    """The beginning of the way of a German mount that stays on its side or changes, though it shouldn't.

    Before it has gone farther it is seen and stopped, but so far it has to be allowed.
    """
    start, end = _standing(scene, here, "german", sides[0]), _standing(scene, there, "german", sides[1])
    # at the pole it stands at home, most likely
    start = _starts(start, here)[-1]
    first_deg, second_deg = (
        begin + max(-SEEN_AFTER_DEG, min(SEEN_AFTER_DEG, to - begin))
        for begin, to in ((start.first_deg, end.first_deg), (start.second_deg, end.second_deg))
    )
    # until then it has not changed
    way = Way(start, replace(start, first_deg=first_deg, second_deg=second_deg))
    text = f"{Way(start, end).label}, which it may do unasked"
    stands = scene.axis_depths(start)
    for limit, depth in scene.axis_depths(way.end).items():
        if depth[0] > max(0.0, stands[limit][0]):
            return _Judged(way, limit, f"{text}: before it is stopped it might be too far past the meridian")
    trouble = trouble_on(way, scene)
    if trouble is None:
        return _Judged(way, None, f"{text}: watched for")
    return _Judged(way, trouble.limit, f"{text}: {_on_the_way(scene, trouble)}")


def _judge(scene: Scene, way: Way, there: HourAngle, bare: HourAngle, track_s: float) -> _Judged:
    label = way.label or "the direct way"
    ends = [way.end]
    if way.end.mounting == "german" and 90.0 - abs(bare.dec_deg) <= AT_POLE_DEG:
        # where it tracks there its place tells nothing of the axes; where it is sent the mount's count does
        ends.append(_standing(scene, bare, "german", way.end.side))
    for limit, depth in (one for end in ends for one in scene.axis_depths(end).items()):
        # each axis turns one way: within at the end it comes no deeper outside, if it stands there
        if depth[0] > 0.0:
            seen = hour_angle_to_observed(there, scene.site)
            return _Judged(
                way,
                limit,
                f"{label}: the target would be {refusing.why(scene.limits, limit, depth[0], seen)}",
            )
    trouble = trouble_on(way, scene)
    if trouble is not None:
        return _Judged(way, trouble.limit, f"{label}: {_on_the_way(scene, trouble)}")
    later = reached_from(
        scene,
        there,
        bare=bare,
        mounting=way.end.mounting,
        side=way.end.side,
        within_s=track_s,
        step_s=20.0,
        settled=True,
    )
    if later is not None:
        seen = Observed(later.az_deg, later.alt_deg, scene.utc)
        when = scene.utc + timedelta(seconds=later.after_s)
        return _Judged(
            way,
            later.limit,
            f"{label}: from {when.astimezone(UTC):%H:%M:%SZ} on ({later.after_s:.0f} s from now) it would be "
            f"{refusing.why(scene.limits, later.limit, 0.0, seen)}",
            tracked=True,
        )
    return _Judged(way, None, label)


def _on_the_way(scene: Scene, trouble: Trouble) -> str:
    place = Observed(trouble.az_deg, trouble.alt_deg, scene.utc)
    limits = scene.limits
    if limits.way_min_altitude_deg is not None:
        limits = replace(limits, min_altitude_deg=min(limits.min_altitude_deg, limits.way_min_altitude_deg))
    deeper = ", deeper outside than it stands now" if trouble.started_outside else ""
    return (
        f"after {100.0 * trouble.share:.0f} % of the way the tube might be at altitude "
        f"{trouble.alt_deg:.1f}°, azimuth {trouble.az_deg:.0f}°, "
        f"{refusing.why(limits, trouble.limit, trouble.depth_deg, place)}{deeper}"
    )


def _refuse(scene: Scene, first: _Judged, others: list[_Judged]) -> None:
    assert first.limit is not None
    told = "".join(
        f"; {one.text}" if one.limit is not None else f"; {one.text} would be allowed" for one in others
    )
    raise OutsideLimits(
        f"the slew isn't allowed: {first.text}{told}", advice=_advice(scene, first), limit=first.limit
    )


def _advice(scene: Scene, first: _Judged) -> str:
    if first.limit in (LimitKind.MERIDIAN, LimitKind.UNREACHABLE):
        return "flip to the other side of the pier first, wait, or choose another target"
    if first.limit is LimitKind.DAYLIGHT:
        return "wait for the night"
    if first.tracked:
        return "the target soon leaves the limits: choose another one"
    pole_deg = abs(scene.site.latitude_deg)
    flips = first.way.end.side is not first.way.start.side
    if first.limit is LimitKind.ALTITUDE and flips and pole_deg < scene.limits.min_altitude_deg + 10.0:
        return (
            f"a German mount changes sides by way of the pole, which is {pole_deg:.0f}° high here: set "
            f"limits.way_min_altitude_deg lower than that, if nothing stands in the way there"
        )
    return (
        "choose another target, or go there in two slews by way of a place that stands high; with the axes' "
        "rates set (limits.axis_rates_deg_s) fewer ways have to be reckoned with"
    )
