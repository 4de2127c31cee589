"""The shift between two source lists, refined: pairs, narrowing strobes, mean and error [S23 eq. 3, 4]."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.identification.selection import all_finite, rank_in_cell, star_like
from mountnav.identification.settings import PreliminarySettings
from mountnav.measuring.measurements import Measurements
from mountnav.measuring.medians import median

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_SOURCES = 300
"""So many of the brightest make the final shift; more cost time and gain nothing."""
UNKNOWN_SIGMA_PX = 0.5
"""Error per coordinate of a position that states none, pixels. Chosen by hand."""
FEWEST_STAR_LIKE = 8
"""With fewer star-like measurements than this the flagged ones are taken as well. Chosen by hand."""


@dataclass(frozen=True, slots=True)
class Sources:
    """Places in pixels, brightest first, with what the search needs of them.

    Attributes
    ----------
    x_px, y_px, sigma_px : ndarray, shape (n,)
        Places and their errors per coordinate.
    index : ndarray of int, shape (n,)
        Which measurements (or stars) these are.
    box : (float, float, float, float)
        Left, low, right and high edge of the area that the list covers.
    proposing, confirming : ndarray of int
        Evenly spread brightest that make hypotheses and strobes, and those that may fill strobes.
    confirming_tree, tree : cKDTree
        Of the confirming, and of the brightest `MOST_SOURCES`.
    """

    x_px: Array
    y_px: Array
    sigma_px: Array
    index: Index
    box: tuple[float, float, float, float]
    proposing: Index
    confirming: Index
    confirming_tree: cKDTree = field(repr=False)
    tree: cKDTree = field(repr=False)

    def holds(self, x_px: Array, y_px: Array) -> NDArray[np.bool_]:
        """Whether places lie in the area; shape (n,)."""
        left, low, right, high = self.box
        inside: NDArray[np.bool_] = (x_px > left) & (x_px < right) & (y_px > low) & (y_px < high)
        return inside

    def density_px2(self, count: int) -> float:
        """Places per square pixel if `count` of them lay evenly."""
        left, low, right, high = self.box
        return max(count, 1) / ((right - left) * (high - low))

    def strobe_px(self, other: Sources, settings: PreliminarySettings) -> float:
        """The first strobe's radius: R_rej, or narrower where `chance_most` requires it."""
        if settings.chance_most >= 1.0:
            return settings.r_rej_px
        filled = -math.log(1.0 - settings.chance_most)
        reach = math.sqrt(filled / (math.pi * other.density_px2(other.confirming.size)))
        return min(settings.r_rej_px, max(2.0, reach))


def make_sources(
    x_px: Array,
    y_px: Array,
    sigma_px: Array,
    index: Index,
    box: tuple[float, float, float, float],
    settings: PreliminarySettings,
) -> Sources:
    """Prepare a list of positions, brightest first.

    Parameters
    ----------
    x_px, y_px, sigma_px : ndarray, shape (n,)
        Finite places; errors that are not known may be NaN.
    index : ndarray of int, shape (n,)
        What the caller calls them.
    box : (float, float, float, float)
        Left, low, right, high edge of the area.
    """
    rank = _rank_in_region(x_px, y_px, box, settings.m_reg)
    proposing = np.flatnonzero(rank < settings.n_mea_reg)
    if settings.confirm_factor > 0:
        confirming = np.flatnonzero(rank < settings.confirm_factor * settings.n_mea_reg)
    else:
        confirming = np.arange(x_px.size)
    places = np.column_stack((x_px, y_px))
    return Sources(
        x_px=x_px,
        y_px=y_px,
        sigma_px=np.where(np.isfinite(sigma_px) & (sigma_px > 0), sigma_px, UNKNOWN_SIGMA_PX),
        index=index,
        box=box,
        proposing=proposing,
        confirming=confirming,
        confirming_tree=cKDTree(places[confirming]),
        tree=cKDTree(places[:MOST_SOURCES]),
    )


def sources_of(measurements: Measurements, settings: PreliminarySettings) -> Sources:
    """Prepare a frame's measurements.

    Returns
    -------
    Sources
        Its area is the frame.
    """
    m = measurements
    chosen = all_finite(m)
    if settings.use_flags:
        clean = star_like(m)
        chosen = clean if clean.size >= FEWEST_STAR_LIKE else chosen
    return make_sources(
        m.x_px[chosen],
        m.y_px[chosen],
        np.sqrt(0.5 * (m.x_sigma_px[chosen] ** 2 + m.y_sigma_px[chosen] ** 2)),
        chosen,
        (-0.5, -0.5, m.width_px - 0.5, m.height_px - 0.5),
        settings,
    )


def _rank_in_region(x: Array, y: Array, box: tuple[float, float, float, float], regions: int) -> Index:
    """How many brighter places each one's region holds; shape (n,)."""
    left, low, right, high = box
    column = np.clip((x - left) / (right - left) * regions, 0, regions - 1).astype(np.int64)
    row = np.clip((y - low) / (high - low) * regions, 0, regions - 1).astype(np.int64)
    return rank_in_cell(row * regions + column)


LEAST_PAIRS = 3
"""Fewer pairs give no shift: two agree by chance."""
NARROWEST_PX = 1.0
"""No strobe is narrowed below this radius. Chosen by hand: centroids of faint sources scatter by some tenths
of a pixel."""
FLOOR_PX = 0.01
"""Error added to every pair's: what centroids don't know of. Chosen by hand."""
CUT_SIGMA = 4.0
"""Pairs farther off the mean than so many of their errors are left out: one honest pair in 3,000 (two
coordinates)."""
CHANCE_IN_PAIRS = 0.2
"""The first pairing's radius is such that chance makes at most this share of pairs. Chosen by hand."""
SETTLED = 0.7
"""A strobe that narrows to no less than this share isn't narrowed again."""
RIVAL_BINS = 128
"""Rival shifts are counted in no more bins than this along each coordinate: a limit of memory."""
CROWD = 100
"""So many pairs vote on where the differences crowd. The brightest. Time grows with its square."""
LEAST_RIVAL = 4
"""Fewer pairs make no rival shift: among hundreds of differences some agree by chance. Chosen by hand."""


@dataclass(frozen=True, slots=True)
class Pairing:
    """Pairs of two lists and their mean shift: x1 = x2 + dx, y1 = y2 + dy [S23 eq. 1-4].

    Attributes
    ----------
    dx_px, dy_px : float
        The final shift.
    dx_sigma_px, dy_sigma_px : float
        Its standard error.
    mean_dx_px, mean_dy_px : float
        The plain mean over pairs within the first strobe, as (3, 4) say.
    first, second : ndarray of int, shape (n,)
        The pairs, as positions in the two `Sources`.
    weight : ndarray, shape (n,)
        Weights of the mean, px^-2; all 1 for the plain mean.
    strobe_px : float
        Radius of the last strobe.
    """

    dx_px: float
    dy_px: float
    dx_sigma_px: float
    dy_sigma_px: float
    mean_dx_px: float
    mean_dy_px: float
    first: Index
    second: Index
    weight: Array
    strobe_px: float

    def __len__(self) -> int:
        return int(self.first.size)


def paired(
    first: Sources, second: Sources, shift: Array, radius_px: float, settings: PreliminarySettings
) -> Pairing | None:
    """Identify pairs at a conditional shift and average them.

    Parameters
    ----------
    shift : ndarray, shape (2,)
        Conditional shift, pixels.
    radius_px : float
        Radius of the strobes.

    Returns
    -------
    Pairing or None
        None when fewer than three pairs hold.
    """
    strobes = first.proposing
    places = np.column_stack((first.x_px[strobes], first.y_px[strobes])) - shift
    distance, nearest = second.confirming_tree.query(places, distance_upper_bound=radius_px)
    held = np.isfinite(np.asarray(distance))
    one, two = strobes[held], second.confirming[np.asarray(nearest)[held]]
    if one.size < LEAST_PAIRS:
        return None
    dx, dy = first.x_px[one] - second.x_px[two], first.y_px[one] - second.y_px[two]
    mean_dx, mean_dy = float(dx.mean()), float(dy.mean())
    if not settings.narrowing:
        root = math.sqrt(one.size)
        return Pairing(
            dx_px=mean_dx,
            dy_px=mean_dy,
            dx_sigma_px=float(dx.std(ddof=1)) / root,
            dy_sigma_px=float(dy.std(ddof=1)) / root,
            mean_dx_px=mean_dx,
            mean_dy_px=mean_dy,
            first=one,
            second=two,
            weight=np.ones(one.size),
            strobe_px=radius_px,
        )
    return _narrowed(first, second, shift, radius_px, (mean_dx, mean_dy))


def _narrowed(
    first: Sources, second: Sources, shift: Array, radius_px: float, mean: tuple[float, float]
) -> Pairing | None:
    """Pair all bright sources with narrower strobes; weighted mean without outliers."""
    density = second.density_px2(min(second.x_px.size, MOST_SOURCES))
    wide = min(radius_px, max(NARROWEST_PX, math.sqrt(CHANCE_IN_PAIRS / (math.pi * density))))
    center, strobe = shift, wide
    for step in range(3):  # to find how narrow it may be, and again with the pairs found so
        one, two = mutual_pairs(first, second, center, strobe)
        if one.size < LEAST_PAIRS:
            return None
        d = _differences(first, second, one, two)
        center = np.median(d[_near(d, _crowd(d, strobe), strobe)], axis=0)
        deviation = np.hypot(d[:, 0] - center[0], d[:, 1] - center[1])
        narrower = _least_likely_strobe(deviation, strobe, density)
        settled = step > 0 and narrower > SETTLED * strobe
        strobe = narrower
        if settled:
            break
    keep = deviation <= strobe
    variance = first.sigma_px[one] ** 2 + second.sigma_px[two] ** 2 + FLOOR_PX**2
    # no pair, however bright, makes the mean alone: seeing and optics move bright stars as well
    variance = np.maximum(variance, 0.25 * median(variance))
    for _ in range(5):
        if int(keep.sum()) < LEAST_PAIRS:
            return None
        weight = np.where(keep, 1.0 / variance, 0.0)
        center = (weight[:, None] * d).sum(axis=0) / weight.sum()
        z2 = ((d - center) ** 2).sum(axis=1) / variance
        spread = max(1.0, median(z2[keep]) / 1.386)  # the median of two squared normal deviates
        again = (z2 <= CUT_SIGMA**2 * spread) & (deviation <= strobe)
        if np.array_equal(again, keep):
            break
        keep = again
    one, two, weight, d = one[keep], two[keep], weight[keep], d[keep]
    free = max(one.size - 1, 1)
    chi2 = (weight[:, None] * (d - center) ** 2).sum(axis=0) / free
    sigma = np.sqrt(np.maximum(chi2, 1.0) / weight.sum())
    return Pairing(
        dx_px=float(center[0]),
        dy_px=float(center[1]),
        dx_sigma_px=float(sigma[0]),
        dy_sigma_px=float(sigma[1]),
        mean_dx_px=mean[0],
        mean_dy_px=mean[1],
        first=one,
        second=two,
        weight=weight,
        strobe_px=strobe,
    )


def mutual_pairs(first: Sources, second: Sources, shift: Array, radius_px: float) -> tuple[Index, Index]:
    """Mutually nearest pairs of the brightest sources at a shift.

    Parameters
    ----------
    first, second : Sources
        Of each the `MOST_SOURCES` brightest.
    shift : ndarray, shape (2,)
        Pixels.

    Returns
    -------
    first, second : ndarray of int, shape (n,)
        Positions in the two `Sources`.
    """
    a = first.tree.data - shift
    distance, nearest = (np.asarray(part) for part in second.tree.query(a, distance_upper_bound=radius_px))
    found = np.flatnonzero(np.isfinite(distance))
    partners = nearest[found].astype(np.int64)
    back = np.asarray(first.tree.query(second.tree.data[partners] + shift)[1])
    same = back == found
    return found[same], partners[same]


def _differences(first: Sources, second: Sources, one: Index, two: Index) -> Array:
    """First minus second of pairs; shape (n, 2) [S23 eq. 1, 2]."""
    return np.column_stack((first.x_px[one] - second.x_px[two], first.y_px[one] - second.y_px[two]))


def _near(d: Array, center: Array, reach_px: float) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.hypot(d[:, 0] - center[0], d[:, 1] - center[1]) <= reach_px
    return near


def _crowd(d: Array, strobe_px: float) -> Array:
    """The difference with most others about it: true pairs crowd there, false ones lie evenly."""
    reach = max(NARROWEST_PX, strobe_px / 4.0)
    d = d[:CROWD]  # the brightest
    across, along = d[:, 0, None] - d[None, :, 0], d[:, 1, None] - d[None, :, 1]
    squared = across * across + along * along
    most = int(np.argmax((squared <= reach**2).sum(axis=1)))
    return np.asarray(np.median(d[squared[most] <= reach**2], axis=0))


def _least_likely_strobe(deviation: Array, strobe_px: float, density_px2: float) -> float:
    """The radius whose content is least likely by chance, widened by half for the tail of the true."""
    radii = strobe_px * 0.7 ** np.arange(12)
    radii = radii[radii >= NARROWEST_PX] if strobe_px > NARROWEST_PX else radii[:1]
    count = deviation.size
    share = (deviation[None, :] <= radii[:, None]).sum(axis=1) / count
    chance = -np.expm1(-density_px2 * math.pi * radii**2)
    share = np.clip(share, chance, 1.0 - 1e-9)
    # Kullback-Leibler divergence: the exponent of the binomial tail
    divergence = share * np.log(share / chance) + (1.0 - share) * np.log((1.0 - share) / (1.0 - chance))
    return float(min(strobe_px, max(NARROWEST_PX, 1.5 * radii[int(np.argmax(divergence))])))


def rival_share(first: Sources, second: Sources, pairing: Pairing) -> float:
    """Pairs that the best other shift would make, as a share of those of this one.

    Parameters
    ----------
    pairing : Pairing
        The shift in question.

    Returns
    -------
    float
        Above some 0.5 the two lists repeat themselves, or hold two populations (stars and hot pixels).
        0 where the best other shift makes fewer than four pairs.
    """
    dx = (first.x_px[first.proposing, None] - second.x_px[None, second.confirming]).ravel() - pairing.dx_px
    dy = (first.y_px[first.proposing, None] - second.y_px[None, second.confirming]).ravel() - pairing.dy_px
    strobe = max(pairing.strobe_px, 1.0)
    hits = int((np.hypot(dx, dy) <= strobe).sum())
    if hits == 0:
        return 1.0
    far = np.maximum(np.abs(dx), np.abs(dy)) > 2.0 * strobe
    span = max(second.box[2] - second.box[0], second.box[3] - second.box[1])
    # squares of the strobe's size, so that a rival has the room that the shift had; large frames: coarser
    side = max(2.0 * strobe, span / RIVAL_BINS)
    column, row = np.floor(dx[far] / side).astype(np.int64), np.floor(dy[far] / side).astype(np.int64)
    if column.size == 0:
        return 0.0
    column, row = column - column.min(), row - row.min()
    rival = int(np.bincount(row * (int(column.max()) + 1) + column).max())
    return rival / hits if rival >= LEAST_RIVAL else 0.0
