"""A model run: the allowed sky, points spread over it in a short way, and the file of the run.

Allowed sky: the limits that are constant in time, evaluated for azimuth, altitude and side of the pier. Sun,
Moon and daylight are not among them: those are checked, with everything else, when the telescope is sent.

Points: spread evenly over the allowed sky and both sides of the pier, ordered so that the way is short.

File: the plan and each point's outcome are comments between the observations. So the file is a file of
observations for every other reader, and an interrupted run resumes from it.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.files import MOST_RECORD_BYTES, read_bytes, read_text
from mountnav.parsing import json_of
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.terms import Array
from mountnav.pointing.observation import PointingObservation, observation_record, read_observations
from mountnav.sky.chain import observed_to_hour_angle
from mountnav.sky.coordinates import Observed, Site
from mountnav.sky.german_axes import first_axis_deg, through_pole_deg

MARGIN_DEG = 1.0
"""Kept from all limits: between planning and looking the sky turns, and the telescope points wrong still."""


def allowed_by(limits: Limits, site: Site, *, margin_deg: float = MARGIN_DEG) -> Allowed:
    """Make the question that `planning.plan` asks."""

    def allowed(az_deg: float, alt_deg: float, side: PierSide) -> bool:
        # at the zenith there is nothing to keep away from
        highest = limits.max_altitude_deg - (margin_deg if limits.max_altitude_deg < 90.0 else 0.0)
        if not limits.min_altitude_deg + margin_deg <= alt_deg <= highest:
            return False
        if limits.horizon is not None and alt_deg < limits.horizon.altitude_at(az_deg) + margin_deg:
            return False
        place = observed_to_hour_angle(Observed(az_deg, alt_deg, ANY_TIME), site)
        for bounds, value in (
            (limits.hour_angle_deg, place.ha_deg),
            (limits.declination_deg, place.dec_deg),
        ):
            if bounds is not None and not bounds[0] + margin_deg <= value <= bounds[1] - margin_deg:
                return False
        return _on_its_side(limits, place.ha_deg, side, margin_deg)

    return allowed


def _on_its_side(limits: Limits, ha_deg: float, side: PierSide, margin_deg: float) -> bool:
    """Whether the tube doesn't look too far past the meridian; past the lower one neither."""
    if limits.past_meridian_deg is None or side is PierSide.UNKNOWN:
        return True
    past = max(limits.past_meridian_deg[0 if side is PierSide.EAST else 1] - margin_deg, 0.0)
    # east of the pier, in the normal posture, it looks west
    looks = ha_deg if side is PierSide.EAST else -ha_deg
    return looks >= -past or looks <= -180.0 + past


Allowed = Callable[[float, float, PierSide], bool]
"""Whether the telescope may look at an azimuth and an altitude (degrees) from a side of the pier."""

# Share of a run's points that only check the model. Chosen: one in five, as in `acceptance`.
HELD_OUT = 0.2
# Attempts to find the density that gives the number of points asked for. Chosen by hand.
_MOST_ROUNDS = 60
ANY_TIME = datetime(2000, 1, 1, tzinfo=UTC)
"""Azimuth and hour angle of a place stay together at all times."""


@dataclass(frozen=True, slots=True)
class RunPoint:
    """One point of a run.

    Attributes
    ----------
    number : int
        In the order of the way, from 1.
    az_deg, alt_deg : float
        Where to look; the same place at any hour.
    ha_deg, dec_deg : float
        Of that place.
    side : PierSide
        From which it will be seen; unknown for mounts with one posture.
    held_out : bool
        It has no part in the fit, and judges it.
    """

    number: int
    az_deg: float
    alt_deg: float
    ha_deg: float
    dec_deg: float
    side: PierSide
    held_out: bool


@dataclass(frozen=True, slots=True)
class RunPlan:
    """A run's points in order, and how far the axes turn.

    Attributes
    ----------
    way_deg : float
        Sum of the larger of both axes' turns, between neighbors.
    """

    points: tuple[RunPoint, ...]
    way_deg: float


def spiral(count: int, lowest_deg: float = 0.0, highest_deg: float = 90.0) -> list[tuple[float, float]]:
    """Golden spiral over a zone of the sky: azimuths and altitudes, each with the same area round it."""
    low, high = math.sin(math.radians(lowest_deg)), math.sin(math.radians(highest_deg))
    turn = 180.0 * (3.0 - math.sqrt(5.0))
    return [
        ((index * turn) % 360.0, math.degrees(math.asin(low + (high - low) * (index + 0.5) / count)))
        for index in range(count)
    ]


def scattered(
    count: int, rng: np.random.Generator, lowest_deg: float = 0.0, highest_deg: float = 90.0
) -> list[tuple[float, float]]:
    """Random places over a zone of the sky, evenly by area."""
    low, high = math.sin(math.radians(lowest_deg)), math.sin(math.radians(highest_deg))
    return [
        (float(rng.uniform(0.0, 360.0)), math.degrees(math.asin(float(rng.uniform(low, high)))))
        for _ in range(count)
    ]


def plan(
    count: int,
    site: Site,
    allowed: Allowed,
    *,
    mounting: Literal["german", "fork", "altaz"] | None = None,
    kind: Literal["spiral", "random"] = "spiral",
    both_sides_each: bool = False,
    held_out: float = HELD_OUT,
    seed: int = 0,
    start: tuple[float, float] | None = None,
) -> RunPlan:
    """Plan a model run.

    Parameters
    ----------
    count : int
        How many points, about; at least 3.
    allowed : callable
        ``allowed(az_deg, alt_deg, side)``; asked for both sides of a German mount, else for the unknown one.
    kind : {"spiral", "random"}
        A golden spiral; or places at random.
    both_sides_each : bool
        See each place of a German mount from every side from which it is allowed, for mounts that take
        orders about the side. Else from the one that looks its way, as mounts choose it by themselves; where
        that one is not allowed, from the other.
    held_out : float
        Share of the points that judge the model and have no part in it.
    seed : int
        The same plan for the same seed.
    start : (az_deg, alt_deg), optional
        Where the telescope stands; the way begins at the point next to it.

    Raises
    ------
    BadRequest
        Too few points, or the allowed sky has no room for them.
    """
    if count < 3:
        raise BadRequest(f"{count} points make no model", advice="take 3 at least; 12 to 30 are good")
    rng = np.random.default_rng(seed)
    found: list[tuple[float, float, PierSide]] = []
    tried = count
    for _ in range(_MOST_ROUNDS):
        places = spiral(tried) if kind == "spiral" else scattered(tried, rng)
        found = [
            (az, alt, side)
            for az, alt in places
            for side in _sides(az, alt, site, allowed, mounting, both_sides_each)
        ]
        if len(found) >= count:
            break
        # nearly all sky is allowed, or nearly none: come to it in steps
        tried = max(tried + 1, min(4 * tried, math.ceil(tried * count / max(len(found), 1))))
        if tried > 2000 * count:
            break
    if len(found) < 3:
        raise BadRequest(
            "the allowed sky has no room for a model run", advice="look at the limits of this telescope"
        )
    if len(found) > count:
        kept = rng.permutation(len(found))[:count] if kind == "random" else _thinned(len(found), count)
        found = [found[index] for index in sorted(int(one) for one in kept)]
    axes = np.array([_axes(az, alt, side, site, mounting) for az, alt, side in found])
    first = None if start is None else np.array(_axes(*start, PierSide.UNKNOWN, site, mounting))
    wraps = mounting != "german"
    order = shortest(axes, first, wraps=wraps)
    out = _held_out(len(order), held_out, rng)
    points = []
    for number, index in enumerate(order, start=1):
        az, alt, side = found[index]
        ha_deg, dec_deg = _hour_angle(az, alt, site)
        points.append(RunPoint(number, az, alt, ha_deg, dec_deg, side, number - 1 in out))
    return RunPlan(tuple(points), way_deg(axes[order], wraps=wraps))


def _thinned(many: int, count: int) -> Array:
    """Numbers evenly spread over a range."""
    return np.floor(np.arange(count) * many / count)


def _held_out(count: int, share: float, rng: np.random.Generator) -> set[int]:
    """One out of each stretch of the way, so that they are spread over the sky as well."""
    wanted = round(share * count)
    if wanted <= 0:
        return set()
    edges = np.linspace(0, count, wanted + 1)
    return {int(rng.integers(int(a), max(int(b), int(a) + 1))) for a, b in pairwise(edges)}


def _hour_angle(az_deg: float, alt_deg: float, site: Site) -> tuple[float, float]:
    place = observed_to_hour_angle(Observed(az_deg, alt_deg, ANY_TIME), site)
    return place.ha_deg, place.dec_deg


def _sides(
    az: float, alt: float, site: Site, allowed: Allowed, mounting: str | None, each: bool
) -> list[PierSide]:
    if mounting != "german":
        return [PierSide.UNKNOWN] if allowed(az, alt, PierSide.UNKNOWN) else []
    ha_deg, _ = _hour_angle(az, alt, site)
    own = PierSide.EAST if ha_deg >= 0.0 else PierSide.WEST
    other = own.other
    free = [side for side in (own, other) if allowed(az, alt, side)]
    return free if each else free[:1]


def _axes(az: float, alt: float, side: PierSide, site: Site, mounting: str | None) -> tuple[float, float]:
    """Angles of both axes, deg; the German hour angle axis within half a turn of the counterweight down."""
    if mounting == "altaz":
        return az, alt
    ha_deg, dec_deg = _hour_angle(az, alt, site)
    if mounting != "german":
        return ha_deg, dec_deg
    if side is PierSide.UNKNOWN:
        side = PierSide.EAST if ha_deg >= 0.0 else PierSide.WEST
    if side is PierSide.WEST:
        return through_pole_deg(ha_deg, dec_deg, site.latitude_deg)
    return first_axis_deg(ha_deg), dec_deg


def _turns(axes: Array, to: Array, wraps: bool) -> Array:
    """The larger of both axes' turns between places (..., 2), deg: how long a slew takes."""
    turn = np.abs(axes - to)
    if wraps:
        turn[..., 0] = np.minimum(turn[..., 0] % 360.0, 360.0 - turn[..., 0] % 360.0)
    return np.asarray(np.max(turn, axis=-1))


def way_deg(axes: Array, *, wraps: bool) -> float:
    """Length of a way through axis angles of shape (n, 2)."""
    return float(np.sum(_turns(axes[:-1], axes[1:], wraps)))


def shortest(axes: Array, start: Array | None, *, wraps: bool) -> list[int]:
    """Order places into a short way: always to the nearest, then uncross (2-opt) until nothing gets shorter.

    Parameters
    ----------
    axes : ndarray, shape (n, 2)
        Axis angles, deg.
    start : ndarray, shape (2,), optional
        Where the way comes from; else all beginnings are tried.
    wraps : bool
        Whether the first axis turns all round.
    """
    n = len(axes)
    apart = _turns(axes[:, None, :], axes[None, :, :].copy(), wraps)
    from_start = np.zeros(n) if start is None else _turns(axes, start[None, :].copy(), wraps)
    begins = range(min(n, 20)) if start is None else [int(np.argmin(from_start))]
    best: list[int] = []
    shortest_deg = math.inf
    for begin in begins:
        order = _uncrossed(_nearest(apart, begin), apart, from_start)
        length = float(from_start[order[0]] + np.sum(apart[order[:-1], order[1:]]))
        if length < shortest_deg:
            best, shortest_deg = order.tolist(), length
    return best


def _nearest(apart: Array, begin: int) -> Array:
    n = len(apart)
    left = np.ones(n, dtype=np.bool_)
    order = [begin]
    left[begin] = False
    while len(order) < n:
        step = np.where(left, apart[order[-1]], np.inf)
        order.append(int(np.argmin(step)))
        left[order[-1]] = False
    return np.array(order)


def _uncrossed(order: Array, apart: Array, from_start: Array) -> Array:
    """2-opt on an open way: turn round the stretch that gains most, until none does."""
    order = order.copy()
    n = len(order)
    for _ in range(20 * n):
        came = np.concatenate([[0.0], apart[order[:-1], order[1:]]])
        came[0] = from_start[order[0]]
        # turning i..j: the way into i now comes to j, the way out of j now starts at i
        into = np.vstack([from_start[order][None, :], apart[np.ix_(order[:-1], order)]])
        out = np.hstack([apart[np.ix_(order, order[1:])], np.zeros((n, 1))])
        left = np.append(came[1:], 0.0)
        gain = came[:, None] + left[None, :] - into - out
        gain[np.tril_indices(n)] = -np.inf
        i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[i, j] <= 1e-9:
            break
        order[i : j + 1] = order[i : j + 1][::-1]
    return order


PLAN, POINT = "# mountnav model run ", "# point "

Part = Literal["fit", "held-out", "fresh"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one point.

    Attributes
    ----------
    number : int
        Of the plan.
    look_id : str or None
        Of its observation, if it was solved.
    problem : str or None
        Why not.
    """

    number: int
    look_id: str | None
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class RunFile:
    """A run as far as it has come.

    Attributes
    ----------
    fresh : frozenset of int
        Numbers of the points for the last check.
    """

    telescope: str
    points: tuple[RunPoint, ...]
    fresh: frozenset[int]
    outcomes: tuple[Outcome, ...]
    observations: tuple[PointingObservation, ...]

    @property
    def left(self) -> tuple[RunPoint, ...]:
        """Points that nothing has come of yet."""
        done = {one.number for one in self.outcomes}
        return tuple(one for one in self.points if one.number not in done)

    def part(self, observation: PointingObservation) -> Part | None:
        """What an observation is for; None if its point was not ended."""
        for one in self.outcomes:
            if one.look_id is not None and one.look_id == observation.look_id:
                if one.number in self.fresh:
                    return "fresh"
                held_out = any(point.number == one.number and point.held_out for point in self.points)
                return "held-out" if held_out else "fit"
        return None

    def of_part(self, part: Part) -> list[PointingObservation]:
        """The observations for one purpose."""
        return [one for one in self.observations if self.part(one) == part]


def begin(path: Path, telescope: str, points: Sequence[RunPoint], fresh: Iterable[int]) -> None:
    """Write the plan into a new file.

    Raises
    ------
    BadRequest
        There is such a file.
    """
    plan = {
        "telescope": telescope,
        "points": [asdict(one) for one in points],
        "fresh": sorted(fresh),
    }
    try:
        with path.open("x", encoding="utf-8") as out:
            out.write(PLAN + json.dumps(plan, allow_nan=False) + "\n")
    except FileExistsError as cause:
        raise BadRequest(f"{path} is there already") from cause
    except OSError as cause:
        raise BadRequest(f"{path} can't be written: {cause.strerror}") from cause


def add(path: Path, outcome: Outcome, observation: PointingObservation | None) -> None:
    """Write what came of a point; its outcome last, so that it counts only if all of it was written."""
    lines = ""
    if observation is not None:
        lines = json.dumps(observation_record(observation), allow_nan=False) + "\n"
    lines += POINT + json.dumps(asdict(outcome), allow_nan=False) + "\n"
    with path.open("a", encoding="utf-8") as out:
        out.write(lines)
        out.flush()
        os.fsync(out.fileno())


def mend(path: Path) -> None:
    """Cut off a last line that was not written whole, as after a kill; the point is taken again."""
    content = read_bytes(path, MOST_RECORD_BYTES)
    whole = content.rfind(b"\n") + 1
    if whole != len(content):
        with path.open("r+b") as out:
            out.truncate(whole)


def read_run(path: Path) -> RunFile | None:
    """Read a run; None if the file is no run but plain observations.

    Raises
    ------
    BadRequest
        The file can't be read, or is damaged.
    """
    try:
        lines = read_text(path, MOST_RECORD_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise BadRequest(f"{path} can't be read: {cause}") from cause
    plan: dict[str, Any] | None = None
    outcomes: list[Outcome] = []
    for number, line in enumerate(lines, start=1):
        try:
            if line.startswith(PLAN):
                plan = json_of(line.removeprefix(PLAN))
            elif line.startswith(POINT):
                outcomes.append(Outcome(**json_of(line.removeprefix(POINT))))
        except (ValueError, TypeError) as cause:
            raise BadRequest(f"{path}, line {number}: a damaged line of a model run") from cause
    if plan is None:
        return None
    try:
        points = tuple(RunPoint(**{**one, "side": PierSide(one["side"])}) for one in plan["points"])
        fresh = frozenset(int(one) for one in plan["fresh"])
        telescope = str(plan["telescope"])
    except (KeyError, TypeError, ValueError) as cause:
        raise BadRequest(f"{path} holds a damaged plan of a model run: {cause}") from cause
    written = tuple(read_observations(path)) if any(one.look_id for one in outcomes) else ()
    return RunFile(telescope, points, fresh, tuple(outcomes), written)
