"""Sources: a list of places prepared for preliminary identification [S23 §2.1]."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.identification.preliminary_settings import PreliminarySettings
from mountnav.identification.selection import all_finite, rank_in_cell, star_like
from mountnav.measuring.measurements import Measurements

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_SOURCES = 300
"""So many of the brightest make the final shift; more cost time and gain nothing."""
UNKNOWN_SIGMA_PX = 0.5
FEWEST_STAR_LIKE = 8
"""With fewer star-like measurements than this the flagged ones are taken as well."""


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
        """The first strobe's radius: R_rej, or narrower where `chance_most` asks for it."""
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
    """Prepare a list of places, brightest first.

    Parameters
    ----------
    x_px, y_px, sigma_px : ndarray, shape (n,)
        Finite places; errors that are not known may be NaN.
    index : ndarray of int, shape (n,)
        What the caller calls them.
    box : (float, float, float, float)
        Left, low, right, high edge of the area.
    settings : PreliminarySettings

    Returns
    -------
    Sources
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

    Parameters
    ----------
    measurements : Measurements
    settings : PreliminarySettings

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
