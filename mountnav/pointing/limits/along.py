"""Limits along the path of a target that moves: which one it reaches first, and all that will happen on it.

A path answers where its target stands at an instant. It is looked at in steps that are as fine as its target
is fast, where a limit is near: a comet each minute, a satellite some times a second. A mount that tracks
stays on its side of the pier, and its first axis turns on without end, as it does while it tracks a star
(`tracked`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import PierSide
from mountnav.errors import BadRequest, LimitKind
from mountnav.pointing.limits.directions import Directions, Floats, of_axes, of_body
from mountnav.pointing.limits.postures import Mounting, Standing
from mountnav.pointing.limits.scene import Depths, Scene
from mountnav.pointing.limits.tracked import (
    AT_POLE_DEG,
    OF_BODIES,
    VACUUM,
    Reached,
    crossing_s,
    standing_for,
)
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Site
from mountnav.sky.german_axes import through_pole_dec_deg

if TYPE_CHECKING:
    from mountnav.pointing.limits.bounds import Limits

__all__ = ["Path", "SkyEvent", "SkyEventKind", "forecast", "reached_along", "reached_by_axes"]

Path = Callable[[datetime], Icrs]
"""Where a target stands at an aware instant: topocentric and astrometric, as an `Ephemeris` answers."""

_STEP_S = 60.0
"""The longest step, s: the sky turns 0.25° in it, as `tracked` has it. Doubled, a thin obstacle may be
missed, and a path that turns back within a minute."""
_FINE_DEG = 0.3
"""Where a limit is near, no step of the target or of an axis is longer than this, °: a little more than a
star goes in a minute. Doubled, a wall of half a degree may be stepped over by a satellite."""
_BOWED = 1.5
"""A path between two looks may come so many times as far from both as they are apart. Chosen by hand: the
great circle of a pass bows less. Doubled, twice as many steps are looked at finely."""
_SHORTEST_S = 0.05
"""No step is shorter, s: the fastest satellites go 0.1° in it. It bounds the steps by the pole and the
zenith, where an axis turns as fast as it likes. Doubled, one there is seen 0.2° coarser."""
_MOST_LOOKS = 12_000
"""A path that wants more looks than this is not judged: they take about 3 s. Eight nights of a star, or some
hundred passes of a satellite. Doubled, an order may keep the service waiting twice as long."""
_ROUNDS = 6
"""So often the looks are made finer: each time as fine as they have to be by what is known."""
_SCENE_S = 600.0
"""Sun and Moon are found again after so long, s: their mean motions in the hour angle miss the Moon by up to
0.04° in it. Doubled, by twice as much."""
_EXACT_S = 0.5
"""Instants of a forecast are found to this, s. Doubled, they may be a second off."""
_ALTITUDE_ZERO_DEG = 0.0
"""Rising and setting are told for this observed altitude of the center, refraction included."""
_ANGLES = (0, 2, 4)
"""Columns of angles that count on through whole turns: hour angle with refraction and without, azimuth."""
_OF_AXES = frozenset({LimitKind.MERIDIAN, LimitKind.HOUR_ANGLE, LimitKind.UNREACHABLE})


class SkyEventKind(StrEnum):
    """What happens to a target on its path."""

    RISES = "rises"
    SETS = "sets"
    MERIDIAN = "meridian"
    """It crosses the meridian above the pole."""
    LOWER_MERIDIAN = "lower-meridian"
    SUN_NEAR = "sun-near"
    """It comes within the Sun's cone, or is in it from the beginning."""
    SUN_FAR = "sun-far"
    LIMIT = "limit"
    """It comes outside of a limit, or is so from the beginning."""
    WITHIN_LIMIT = "within-limit"
    """It comes within a limit again."""


_WORDS = {
    SkyEventKind.RISES: "rises",
    SkyEventKind.SETS: "sets",
    SkyEventKind.MERIDIAN: "crosses the meridian",
    SkyEventKind.LOWER_MERIDIAN: "crosses the meridian below the pole",
    SkyEventKind.SUN_NEAR: "comes within the Sun's cone",
    SkyEventKind.SUN_FAR: "leaves the Sun's cone",
    SkyEventKind.LIMIT: "comes outside the limit",
    SkyEventKind.WITHIN_LIMIT: "comes within the limit",
}


@dataclass(frozen=True, slots=True)
class SkyEvent:
    """Something that will happen on a path.

    Attributes
    ----------
    utc : datetime
        To half a second.
    alt_deg, az_deg : float
        Observed place then.
    limit : LimitKind or None
        Which limit, if it is about one.
    """

    kind: SkyEventKind
    utc: datetime
    alt_deg: float
    az_deg: float
    limit: LimitKind | None = None

    @property
    def words(self) -> str:
        """The same for people."""
        limit = f" ({self.limit})" if self.limit not in (None, LimitKind.SUN) else ""
        return (
            f"{_WORDS[self.kind]}{limit} at {self.utc:%Y-%m-%d %H:%M:%S} UTC, altitude {self.alt_deg:.1f}°, "
            f"azimuth {self.az_deg:.0f}°"
        )


def reached_along(
    limits: Limits,
    path: Path,
    utc: datetime,
    site: Site,
    air: Air,
    *,
    mounting: Mounting | None = None,
    side: PierSide | None = None,
    within_s: float,
) -> Reached | None:
    """Which limit tracking along a path reaches first, and when; None if none within that time.

    For a path that stays in one place of the sky that is what `Limits.reached` says, but for refraction,
    which is that of each instant here.

    Parameters
    ----------
    path : callable
        It must answer from `utc` on for `within_s`.
    utc : datetime
        Aware.
    mounting : {"german", "fork", "altaz"}, optional
        None: not known.
    side : PierSide, optional
        On which the tube hangs all the time; None: as German mounts usually do at its begin.
    within_s : float
        At least 0.

    Raises
    ------
    BadRequest
        The instant is naive, the path doesn't answer, or it is so long and fast that it can't be judged.
    """
    track = _Track(limits, path, utc, site, air, mounting, side)
    track.look(max(within_s, 0.0))
    later_s, depths = track.later_s, track.depths()
    first: tuple[float, LimitKind] | None = None
    for limit, depth in depths.items():
        after_s = crossing_s(depth, later_s, limit in OF_BODIES)
        if after_s is not None and (first is None or after_s < first[0]):
            first = after_s, limit
    if first is None:
        return None
    index = int(np.searchsorted(later_s, first[0]))
    seen = track.directions()
    return Reached(
        first[1],
        first[0],
        float(np.mod(seen.azimuth_deg[index], 360.0)),
        float(seen.altitude_deg[index]),
    )


def forecast(
    limits: Limits,
    path: Path,
    utc: datetime,
    until_utc: datetime,
    site: Site,
    air: Air,
    *,
    mounting: Mounting | None = None,
    side: PierSide | None = None,
) -> tuple[SkyEvent, ...]:
    """What will happen to a target on its path: it rises, sets, crosses the meridian, reaches limits.

    What it is outside of at the beginning is told at the beginning. Parameters and errors are those of
    `reached_along`.

    Returns
    -------
    tuple of SkyEvent
        In the sequence of time.
    """
    seconds = (until_utc - utc).total_seconds()
    if not seconds > 0.0:
        return ()
    track = _Track(limits, path, utc, site, air, mounting, side, all_events=True)
    track.look(seconds)
    return tuple(sorted(track.events(), key=lambda event: event.utc))


def reached_by_axes(
    scene: Scene,
    here: HourAngle,
    bare: HourAngle,
    rates_deg_s: tuple[float, float],
    *,
    mounting: Mounting | None,
    side: PierSide | None,
    tracks: bool,
    within_s: float,
) -> Reached | None:
    """Which limit axes that are moved on at a speed reach first, and when; None if none within that time.

    Parameters
    ----------
    here, bare : HourAngle
        Where the mount points, with refraction and without.
    rates_deg_s : (float, float)
        Speeds as `mountnav.devices.MovesAxes` counts them: positive to greater right ascension (azimuth), and
        to greater declination (altitude). The second axis isn't moved through the pole, or the zenith.
    tracks : bool
        Whether that comes on top of tracking; of an alt-az mount it may.
    """
    stands, reckoned = (standing_for(scene, place, mounting, side) for place in (here, bare))
    primary, secondary = rates_deg_s
    count = 2 + math.ceil(within_s * max(abs(primary), abs(secondary), SIDEREAL_DEG_S) / _FINE_DEG)
    later_s = np.linspace(0.0, max(within_s, 0.0), min(count, _MOST_LOOKS))
    if stands.mounting == "altaz":
        first_deg_s, second_deg_s = primary, secondary
    else:
        first_deg_s = (SIDEREAL_DEG_S if tracks else 0.0) - primary
        # beyond the pole the declination axis counts on, where declinations come down again
        second_deg_s = -secondary if abs(stands.second_deg) > 90.0 else secondary
    depths: Depths = {}
    seen: Directions | None = None
    for standing in (stands, reckoned):
        first = standing.first_deg + first_deg_s * later_s
        second = standing.second_deg + second_deg_s * later_s
        looks = of_axes(first, second, _as_axes(standing), scene.site.latitude_deg)
        seen = seen or looks
        found = scene.depths(looks, standing=True, later_s=later_s) | scene.axis_depths(
            standing, first, second
        )
        if secondary:
            # beyond the pole (the zenith) directions turn round
            beyond = np.abs(second) - 90.0
            through = -beyond if abs(standing.second_deg) > 90.0 else beyond
            found[LimitKind.UNREACHABLE] = np.maximum(found[LimitKind.UNREACHABLE], through)
        for limit, depth in found.items():
            depths[limit] = np.maximum(depths[limit], depth) if limit in depths else depth
    assert seen is not None
    first_found: tuple[float, LimitKind] | None = None
    for limit, depth in depths.items():
        after_s = crossing_s(depth, later_s, limit in OF_BODIES)
        if after_s is not None and (first_found is None or after_s < first_found[0]):
            first_found = after_s, limit
    if first_found is None:
        return None
    index = int(np.searchsorted(later_s, first_found[0]))
    return Reached(
        first_found[1],
        first_found[0],
        float(np.mod(seen.azimuth_deg[index], 360.0)),
        float(seen.altitude_deg[index]),
    )


def _as_axes(standing: Standing) -> Mounting:
    return "altaz" if standing.mounting == "altaz" else "fork"


class _Track:
    """A path as a mount on its pier sees it, at the instants at which it was looked at."""

    def __init__(
        self,
        limits: Limits,
        path: Path,
        utc: datetime,
        site: Site,
        air: Air,
        mounting: Mounting | None,
        side: PierSide | None,
        *,
        all_events: bool = False,
    ) -> None:
        self._limits, self._path, self._utc, self._site, self._air = limits, path, utc, site, air
        self._mounting, self._side, self._all_events = mounting, side, all_events
        self.later_s: Floats = np.zeros(0)
        # hour angle and declination, refracted, then without refraction, and azimuth; see `_ANGLES`
        self._places: Floats = np.zeros((0, 5))
        self._stands = tuple(self._standing(one) for one in (air, VACUUM))

    # -- looking -----------------------------------------------------------------------------------

    def look(self, within_s: float) -> None:
        """Look at the path so often that nothing is missed. Raises `BadRequest`."""
        count = max(2, math.ceil(within_s / _STEP_S) + 1)
        self._take(np.linspace(0.0, within_s, count) if within_s > 0.0 else np.zeros(1))
        for _ in range(_ROUNDS):
            between = self._where_finer()
            if not between.size:
                return
            self._take(between)

    def _take(self, later_s: Floats) -> None:
        if self.later_s.size + later_s.size > _MOST_LOOKS:
            raise BadRequest(
                "the path is too long, and its target too fast, to be held against the limits as a whole",
                advice="let it end earlier, for a satellite after one pass",
            )
        rows = [self._row(float(one)) for one in later_s]
        times = np.concatenate((self.later_s, later_s))
        order = np.argsort(times, kind="stable")
        self.later_s = times[order]
        places = np.concatenate((self._places, np.array(rows).reshape(-1, 5)))[order]
        for column in _ANGLES:
            places[:, column] = np.degrees(np.unwrap(np.radians(places[:, column])))
        self._places = places

    def _row(self, later_s: float) -> tuple[float, float, float, float, float]:
        at = self._utc + timedelta(seconds=later_s)
        place = self._path(at)
        seen = icrs_to_hour_angle(place, at, self._site, self._air)
        bare = icrs_to_hour_angle(place, at, self._site, VACUUM)
        az_deg = float(of_body(seen, self._site.latitude_deg).azimuth_deg)
        return seen.ha_deg, seen.dec_deg, bare.ha_deg, bare.dec_deg, az_deg

    def _where_finer(self) -> Floats:
        """Instants between those that are too far apart for the limits that are near."""
        if self.later_s.size < 2:
            return np.zeros(0)
        seen = self.directions()
        steps_s = np.diff(self.later_s)
        chord = Directions(seen.north[:-1], seen.east[:-1], seen.up[:-1]).separation_deg(
            Directions(seen.north[1:], seen.east[1:], seen.up[1:])
        )
        first, second = self._axes(bare=False)
        turned = np.maximum(np.abs(np.diff(first)), np.abs(np.diff(second)))
        near_sky = np.zeros(chord.shape, dtype=np.bool_)
        near_axes = np.zeros(chord.shape, dtype=np.bool_)
        deep = np.zeros(chord.shape, dtype=np.bool_)
        for limit, depth in self.depths().items():
            if limit in _OF_AXES:
                near_axes |= _within(depth, _BOWED * turned)
            elif limit is LimitKind.HORIZON:
                # between two azimuths anything may stand, but nothing is higher than its highest point
                horizon = self._limits.horizon
                assert horizon is not None
                free = seen.altitude_deg - self._limits.margin_deg - horizon.highest_deg
                near_sky |= np.minimum(free[:-1], free[1:]) <= _BOWED * chord
            else:
                near_sky |= _within(depth, _BOWED * chord)
                if limit is LimitKind.ALTITUDE:
                    deep = np.minimum(depth[:-1], depth[1:]) > _BOWED * chord
        if self._all_events:
            near_sky |= _within(seen.altitude_deg - _ALTITUDE_ZERO_DEG, _BOWED * chord)
            deep &= ~near_sky
            near_axes |= turned > 90.0  # which way round it goes has to be seen
        parts = np.maximum(
            np.where(near_sky & ~deep, chord / _FINE_DEG, 1.0),
            np.where(near_axes & ~deep, turned / _FINE_DEG, 1.0),
        )
        parts = np.ceil(np.minimum(parts, steps_s / _SHORTEST_S)).astype(np.int64)
        added = [
            self.later_s[index] + steps_s[index] * np.arange(1, parts[index]) / parts[index]
            for index in np.flatnonzero(parts > 1)
        ]
        return np.concatenate(added) if added else np.zeros(0)

    # -- what was seen -----------------------------------------------------------------------------

    def directions(self) -> Directions:
        """Observed directions."""
        return of_axes(self._places[:, 0], self._places[:, 1], "fork", self._site.latitude_deg)

    def _standing(self, air: Air) -> Standing:
        """How the mount stands at the beginning."""
        place = icrs_to_hour_angle(self._path(self._utc), self._utc, self._site, air)
        return standing_for(Scene(self._limits, self._utc, self._site), place, self._mounting, self._side)

    def _axes(self, *, bare: bool) -> tuple[Floats, Floats]:
        """Angles of both axes on the way, as `postures` counts them; `bare`: as without refraction."""
        stands = self._stands[bare]
        if stands.mounting == "altaz":
            return self._places[:, 4], self.directions().altitude_deg
        ha_deg, dec_deg = (self._places[:, 2 * bare + one] for one in (0, 1))
        first = stands.first_deg + (ha_deg - ha_deg[0])
        if stands.mounting == "german" and stands.side is PierSide.WEST:
            return first, through_pole_dec_deg(dec_deg, self._site.latitude_deg)
        return first, dec_deg

    def depths(self) -> Depths:
        """Depths outside all limits, ° (above 0: outside), at all looks; margins as for tracked stars."""
        seen = self.directions()
        found: Depths = {}
        scenes = np.floor(self.later_s / _SCENE_S).astype(np.int64)
        if Scene(self._limits, self._utc, self._site).bodies is None:
            scenes[:] = 0
        for number in np.unique(scenes):
            mask: NDArray[np.bool_] = scenes == number
            begins_s = float(number) * _SCENE_S
            scene = Scene(self._limits, self._utc + timedelta(seconds=begins_s), self._site)
            some = scene.depths(seen.chosen(mask), standing=True, later_s=self.later_s[mask] - begins_s)
            for limit, depth in some.items():
                found.setdefault(limit, np.zeros(self.later_s.shape))[mask] = depth
        scene = Scene(self._limits, self._utc, self._site)
        stands, reckoned_stands = self._stands
        found |= scene.axis_depths(stands, *self._axes(bare=False))
        if stands.mounting != "altaz":
            away = 90.0 - np.abs(self._places[:, 3]) > AT_POLE_DEG
            reckoned = scene.axis_depths(reckoned_stands, *self._axes(bare=True))
            for limit, depth in reckoned.items():
                found[limit] = np.where(away, np.maximum(found[limit], depth), found[limit])
        return found

    # -- what happens ------------------------------------------------------------------------------

    def events(self) -> Iterable[SkyEvent]:
        """All that happens."""
        seen, depths = self.directions(), self.depths()
        for limit, depth in depths.items():
            out, back = (
                (SkyEventKind.SUN_NEAR, SkyEventKind.SUN_FAR)
                if limit is LimitKind.SUN
                else (SkyEventKind.LIMIT, SkyEventKind.WITHIN_LIMIT)
            )
            if depth[0] > 0.0:
                yield self._event(out, 0.0, limit)

            def of_limit(track: _Track, limit: LimitKind = limit) -> Floats:
                return track.depths()[limit]

            for index in _changes(depth):
                kind = out if depth[index + 1] > 0.0 else back
                yield self._event(kind, self._instant(index, of_limit), limit)
        height = seen.altitude_deg - _ALTITUDE_ZERO_DEG
        for index in _changes(height):
            kind = SkyEventKind.RISES if height[index + 1] > 0.0 else SkyEventKind.SETS
            yield self._event(kind, self._instant(index, lambda track: track.directions().altitude_deg))
        # half turns of the hour angle: even ones are the meridian, odd ones the lower one
        halves = np.floor(self._places[:, 0] / 180.0)
        for index in map(int, np.flatnonzero(np.diff(halves) != 0.0)):
            crossed = max(halves[index], halves[index + 1])
            kind = SkyEventKind.MERIDIAN if crossed % 2 == 0 else SkyEventKind.LOWER_MERIDIAN

            def of_meridian(track: _Track, at: float = float(crossed) * 180.0) -> Floats:
                return track._places[:, 0] - at

            yield self._event(kind, self._instant(index, of_meridian))

    def _instant(self, index: int, value: Callable[[_Track], Floats]) -> float:
        """When a value changes its sign between two looks, by halving."""
        low_s, high_s = float(self.later_s[index]), float(self.later_s[index + 1])
        # what counts as outside is above 0
        begins = bool(value(self)[index] > 0.0)
        while high_s - low_s > _EXACT_S:
            middle_s = 0.5 * (low_s + high_s)
            between = self._with(middle_s)
            at = int(np.searchsorted(between.later_s, middle_s))
            if bool(value(between)[at] > 0.0) is begins:
                low_s = middle_s
            else:
                high_s = middle_s
        return high_s

    def _with(self, later_s: float) -> _Track:
        """The same path, looked at once more near an instant, from its beginning on."""
        other = _Track(self._limits, self._path, self._utc, self._site, self._air, self._mounting, self._side)
        index = int(np.searchsorted(self.later_s, later_s))
        keep = np.unique([0, index - 1, min(index, self.later_s.size - 1)])
        other.later_s, other._places = self.later_s[keep], self._places[keep].copy()
        row = np.array(self._row(later_s))
        at = int(np.searchsorted(other.later_s, later_s))
        for column in _ANGLES:
            near = other._places[at - 1, column]
            row[column] = near + (row[column] - near + 180.0) % 360.0 - 180.0
        other.later_s = np.insert(other.later_s, at, later_s)
        other._places = np.insert(other._places, at, row, axis=0)
        return other

    def _event(self, kind: SkyEventKind, later_s: float, limit: LimitKind | None = None) -> SkyEvent:
        ha_deg, dec_deg, *_ = self._row(later_s)
        seen = of_axes(np.array([ha_deg]), np.array([dec_deg]), "fork", self._site.latitude_deg)
        return SkyEvent(
            kind,
            self._utc + timedelta(seconds=later_s),
            float(seen.altitude_deg[0]),
            float(np.mod(seen.azimuth_deg[0], 360.0)),
            limit,
        )


def _within(value: Floats, reach: Floats) -> NDArray[np.bool_]:
    """Whether a value may be 0 between two looks: it is no farther from it, at either, than it may go."""
    return np.asarray(np.minimum(np.abs(value[:-1]), np.abs(value[1:])) <= reach)


def _changes(value: Floats) -> list[int]:
    """Indices before which a value is at or below 0 and above 0 after, or the other way round."""
    return [int(index) for index in np.flatnonzero(np.diff(value > 0.0))]
