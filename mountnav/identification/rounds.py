"""What is tried in turn: the cheap and likely first, each round with a bound on its work."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

from mountnav.frames import Hint
from mountnav.identification.settings import IdentificationSettings, Stage

Scales = tuple[float, float]

SCALE_LEAST_ARCSEC_PX = 0.3
"""Finest scale that is searched where none is known, by triangles and in the index."""
SCALE_MOST_ARCSEC_PX = 200.0
"""Coarsest scale that is searched where none is known: a frame of 1,000 px is 56° wide then, and the tangent
plane ends at some 60°."""
SCALE_STEP = 1.6
"""With no scale given, it is sought in windows this wide. Wider ones have more tiles than a coarse scale
needs; narrower ones more rounds."""
WIDER = 1.3
"""When the hinted scale fails, its bounds are widened by this factor before it is taken as unknown. Chosen by
hand."""
INDEX_LEAST_DEG = 0.6
"""Fields narrower than this are hardly ever found by the index."""
INDEX_MOST_DEG = 40.0
"""Nor is it promised for wider ones (docs/explanation/blind.md)."""
OUTWARD_BESIDE_INDEX = 2.0
"""So many shorter frame sides beyond the hinted radius triangles seek the center where the index was asked
too: of lists in which three of four sources are false they find some that it doesn't. Doubled, a hopeless
frame with a hint of 5° at 2 ″/px costs half a second more; halved, hints that are off by more lose such
frames."""
NEAREST_TRIANGLES = 2_000_000
"""Work of a round that looks at the nearest tiles only, in catalog triangles; about a second."""
WHOLE_TRIANGLES = 20_000_000
"""Work of a round over the whole hinted area. Doubled, a hopeless frame costs so much more time."""
COSTLY_NEAREST_TRIANGLES = 700_000
"""Work of a costly round by the inner stars of the nearest tiles: 25 tiles of the middle stage, 7 of the
last, as many as `NEAREST_TRIANGLES` are with all their stars."""
COSTLY_TRIANGLES = 6_700_000
"""Work of the middle stage over the whole hinted area: 243 tiles, two seconds. Doubled, a hopeless frame with
a hint of 5° at 3 ″/px costs a second more; halved, its rim is searched by bright stars only."""
LAST_TRIANGLES = 4_000_000
"""Work of the last and most costly round: 43 tiles, two seconds. Doubled, a hopeless frame costs so much
more."""


@dataclass(frozen=True, slots=True)
class Round:
    """One pass over a part of the search area.

    Attributes
    ----------
    stage : (int, int)
        How many of the brightest measurements and of a tile's stars make triangles.
    scales : (float, float)
        Bounds of the scale, arcsec per pixel.
    inner_deg, outer_deg : float
        Tiles between these distances from the assumed center.
    flagged : bool
        Also measurements that look like no stars take part.
    most_triangles : int
        The round ends when its tiles have made so many catalog triangles: the same on any machine.
    most_tiles : int
        And after so many tiles.
    inner : bool
        Triangles are made of the stars of a tile's inner part only (`corner_radius`).
    from_triangles : int
        The nearest tiles, up to so many catalog triangles, are passed over: an earlier round was there.
    """

    stage: Stage
    scales: Scales
    inner_deg: float
    outer_deg: float
    flagged: bool = False
    most_triangles: int = WHOLE_TRIANGLES
    most_tiles: int = 4000
    from_triangles: int = 0
    inner: bool = False


def scale_windows(low: float | None, high: float | None) -> list[Scales]:
    """Cut a range of scales in windows of `SCALE_STEP`, the coarsest first: it has the fewest tiles.

    Parameters
    ----------
    low, high : float or None
        Bounds, arcsec per pixel; None means `SCALE_LEAST_ARCSEC_PX` and `SCALE_MOST_ARCSEC_PX`.
    """
    least = low if low is not None else SCALE_LEAST_ARCSEC_PX
    most = high if high is not None else SCALE_MOST_ARCSEC_PX
    if most <= least:
        return []
    steps = max(1, math.ceil(math.log(most / least) / math.log(SCALE_STEP)))
    edges = [least * (most / least) ** (i / steps) for i in range(steps + 1)]
    return list(pairwise(edges))[::-1]


def in_index(scales: Scales, shorter_px: int) -> bool:
    """Whether frames of these scales have fields that the index of the whole sky is made for.

    Parameters
    ----------
    shorter_px : int
        The frame's shorter side.
    """
    least_deg, most_deg = (shorter_px * scale / 3600.0 for scale in scales)
    return least_deg >= INDEX_LEAST_DEG and most_deg <= INDEX_MOST_DEG


def outward_deg(
    hint: Hint, scale_arcsec_px: float, shorter_px: int, settings: IdentificationSettings
) -> float:
    """How far out the center is sought when it is not within the hinted radius.

    Parameters
    ----------
    shorter_px : int
        The frame's shorter side.
    settings : IdentificationSettings
        `outward_fields` and `outward_max_deg`.

    Returns
    -------
    float
        Degrees from the hinted center.
    """
    field_deg = shorter_px * scale_arcsec_px / 3600.0
    wanted = hint.radius_deg + settings.outward_fields * field_deg
    return max(hint.radius_deg, min(wanted, hint.radius_deg + settings.outward_max_deg))


def plan(
    hint: Hint, shorter_px: int, settings: IdentificationSettings, *, flagged: bool, indexed: bool = False
) -> list[list[Round]]:
    """Rounds to be tried, in three parts: what the hint says; what may be else; both again, deeper.

    Parameters
    ----------
    shorter_px : int
        The frame's shorter side.
    flagged : bool
        Whether there are flagged measurements that could take part: a sharp frame's stars may all look
        like hot pixels.
    indexed : bool
        The whole sky is searched in the index before the second part. It finds frames of the fields that it
        is made for at any place and scale: triangles are left with what the hint says, and other fields.

    Returns
    -------
    list of three lists of Round
        The parts of several hints are tried one after the other: all first parts, then all second ones, and
        last the costly ones, so that a wrong hint doesn't use up the time before the right one is tried.
    """
    low, high, radius = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px, hint.radius_deg
    stages = settings.stages
    if low is None or high is None:
        windows = scale_windows(low, high)
        # the cheap stage over all scales before the costly one over any, and the near tiles before the far
        # ones
        first = [
            Round(stage, window, 0.0, radius, most_triangles=NEAREST_TRIANGLES)
            for stage in stages[:2]
            for window in windows
        ]
        second = [
            Round(
                stage,
                window,
                0.0,
                radius,
                from_triangles=NEAREST_TRIANGLES if stage in stages[:2] else 0,
                most_triangles=LAST_TRIANGLES if indexed else WHOLE_TRIANGLES,
            )
            for stage in stages
            for window in windows
            if not (indexed and in_index(window, shorter_px))
        ]
        near = [
            replace(step, most_triangles=COSTLY_NEAREST_TRIANGLES)
            if indexed and in_index(step.scales, shorter_px)
            else step
            for step in first[len(windows) :]
        ]
        return [first[: len(windows)], [], near + second]
    window = (low, high)
    first = [Round(stages[0], window, 0.0, radius)]
    first += [
        Round(stage, window, 0.0, radius, most_triangles=COSTLY_TRIANGLES, inner=True)
        for stage in stages[1:2]
    ]
    # the nearest tiles with all their stars: most hints mean these
    first += [Round(stage, window, 0.0, radius, most_triangles=NEAREST_TRIANGLES) for stage in stages[2:]]
    sides = [(high, high * WIDER), (low / WIDER, low)]
    if indexed:
        sides = [side for side in sides if not in_index(side, shorter_px)]
    second = [Round(stages[0], side, 0.0, radius, most_triangles=NEAREST_TRIANGLES) for side in sides]
    if flagged:
        second += [
            Round(stage, window, 0.0, radius, flagged=True, most_triangles=NEAREST_TRIANGLES)
            for stage in stages[:2]
        ]
    far = outward_deg(hint, math.sqrt(low * high), shorter_px, settings)
    if indexed and in_index(window, shorter_px):
        far = min(far, radius + OUTWARD_BESIDE_INDEX * shorter_px * math.sqrt(low * high) / 3600.0)
    if far > radius:
        second.append(Round(stages[0], window, radius, far))
    others = scale_windows(high * WIDER, SCALE_MOST_ARCSEC_PX) + scale_windows(
        SCALE_LEAST_ARCSEC_PX, low / WIDER
    )
    if indexed:
        others = [scales for scales in others if not in_index(scales, shorter_px)]
    likely = sorted(others, key=lambda one: abs(math.log(one[0] * one[1] / (low * high))))
    second += [
        Round(stages[0], scales, 0.0, radius, most_triangles=NEAREST_TRIANGLES // 4, most_tiles=200)
        for scales in likely
    ]
    second += [
        Round(stage, side, 0.0, radius, most_triangles=COSTLY_NEAREST_TRIANGLES, inner=True)
        for stage in stages[1:2]
        for side in sides
    ]
    second += [
        Round(
            stage,
            window,
            0.0,
            radius,
            from_triangles=COSTLY_NEAREST_TRIANGLES,
            most_triangles=LAST_TRIANGLES,
            inner=True,
        )
        for stage in stages[2:]
    ]
    cheap = [step for step in second if step.stage == stages[0]]
    costly = [step for step in second if step.stage != stages[0]]
    return [first[:1], cheap, first[1:] + costly]
