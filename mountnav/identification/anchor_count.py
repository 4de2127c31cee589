"""How many two-star anchors there are in what was searched: each could have fixed a wrong plate."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.reading_depth import depth_for
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import Catalog, Stars
from mountnav.identification.area import WIDEST_DEG
from mountnav.identification.plate import ARCSEC_PER_RAD
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEVELS: Final = (6, 12, 24, 48, 96, 192)
"""Anchors are counted among so many of the brightest measurements, each level for itself."""
PARTS_OF_LIMIT: Final = (1 / 4, 1 / 4, 1 / 4, 1 / 8, 1 / 16, 1 / 16)
"""What each level has of the limit: few stars are found by bright ones."""
APART: Final = 0.25
"""Least distance of an anchor's measurements, in shorter frame sides."""
ANCHOR_STARS: Final = 30
"""Anchors are the catalog's stars so deep that a poor frame holds so many."""
SHARE: Final = 0.15
"""Share of the limit that belongs to this test: the other's sum Σ 1/(n(1 + ln n)²) is 1.69 < 2·(1 − 0.15)."""
PASSES: Final = 7
"""A frame is looked at so often: at a glance, and in full, twice with each of up to three catalogs."""
MOST_STARS: Final = 5000
"""In an area with more stars the anchors are so many that this test decides nothing."""


@dataclass(frozen=True, slots=True)
class Area:
    """A part of what is searched: where the frame's center may be, and at what scale.

    Attributes
    ----------
    center : Icrs
    radius_deg : float
    scales : (float, float)
        Arcsec per pixel.
    measured : int
        How many measurements took part: another list is searched anew.
    """

    center: Icrs
    radius_deg: float
    scales: tuple[float, float]
    measured: int

    def covers(self, other: Area) -> bool:
        """Whether all of the other area was in this one."""
        return (
            (self.center, self.measured) == (other.center, other.measured)
            and self.radius_deg >= other.radius_deg
            and self.scales[0] <= other.scales[0]
            and self.scales[1] >= other.scales[1]
        )


@dataclass(frozen=True, slots=True)
class Sources:
    """The measurements that take part, and the frame's size.

    Attributes
    ----------
    x_px, y_px : ndarray, shape (n,)
        Brightest first.
    mag : ndarray, shape (n,)
        Magnitudes of an unknown zero point; NaN where there is no flux.
    width_px, height_px : int
    piece_of : ndarray of int, shape (n,), or None
        Which source each measurement is a piece of (`combs.pieces`); None: each is a source of its own.
    """

    x_px: Array
    y_px: Array
    mag: Array
    width_px: int
    height_px: int
    piece_of: Index | None = None

    @classmethod
    def of(cls, measurements: Measurements, usable: Index, piece_of: Index | None = None) -> Sources:
        """Those that take part, brightest first."""
        flux = np.asarray(measurements.flux, dtype=float)[usable]
        with np.errstate(divide="ignore", invalid="ignore"):
            mag = np.where(flux > 0, -2.5 * np.log10(flux), np.nan)
        x, y = measurements.x_px[usable], measurements.y_px[usable]
        return cls(x, y, mag, measurements.width_px, measurements.height_px, piece_of)

    def with_pieces(self, some: Index) -> NDArray[np.bool_]:
        """Which measurements are some of these, or pieces of the same sources."""
        if self.piece_of is None:
            one: NDArray[np.bool_] = np.isin(np.arange(self.x_px.size), some)
            return one
        return np.isin(self.piece_of, self.piece_of[some])

    def apart(self, most: int) -> Array:
        """Distances (pixels) of all pairs among the brightest that are wide enough for an anchor."""
        z = self.x_px[:most] + 1j * self.y_px[:most]
        i, j = np.triu_indices(z.size, 1)
        distance = np.abs(z[i] - z[j])
        wide: Array = distance[distance >= self.least_px()]
        return wide

    def least_px(self) -> float:
        """Least distance of an anchor's measurements."""
        return APART * min(self.width_px, self.height_px)


@dataclass(frozen=True, slots=True)
class _Sky:
    """Stars of an area that may be anchors: where they are, how deep, and their mutual chords, ascending."""

    middle: Array
    chord: float
    mag_limit: float
    chords: Array


@dataclass(slots=True)
class Anchors:
    """How many two-star anchors there are in all that was searched so far.

    Attributes
    ----------
    areas : list of Area
        In the order searched. The order and extent follow from the hint alone, never from a match.
    chances : dict of (int, int, bytes) to ndarray
        What hypotheses came to: the same pairs are often proposed again.
    """

    areas: list[Area] = field(default_factory=list)
    _skies: dict[Area, _Sky | None] = field(default_factory=dict)
    _counts: dict[tuple[Area, int], Array] = field(default_factory=dict)
    chances: dict[tuple[int, int, bytes], Array] = field(default_factory=dict)

    def searched(self, area: Area) -> None:
        """Remember that an area is searched from now on."""
        if not any(one.covers(area) for one in self.areas):
            self.areas.append(area)

    def odds(
        self, chances: Array, sources: Sources, catalog: Catalog, epoch_yr: float, limit: float
    ) -> float:
        """Odds of the best of the anchors at hand.

        With n anchors searched so far and n₀ in the first area the chance of one is multiplied by
        2·n·(1 + ln n/n₀)²: the first area's anchors take half of the limit, ∫ dn/(2n(1 + ln n/n₀)²) = ½ is
        left for all that follow, however far the search goes and wherever it stops.

        Parameters
        ----------
        chances : ndarray, shape (levels,)
            The best anchor's of each of `LEVELS`.
        sources : Sources
        catalog : Catalog
        epoch_yr : float
        limit : float
            The counting ends when the odds exceed this.

        Returns
        -------
        float
            At most 1; at least this if it exceeds the limit; 1 where an area is too rich to be counted.
        """
        first, total, odds = np.zeros(0), np.zeros(len(LEVELS)), 1.0
        for area in self.areas:
            total = total + self._count(area, sources, catalog, epoch_yr)
            if not np.isfinite(total).all():
                return 1.0
            if first.size == 0:
                first = np.maximum(total, 1.0)
            total = np.maximum(total, first)
            factor = 2.0 * total * (1.0 + np.log(total / first)) ** 2
            odds = float(np.min(chances * factor / PARTS_OF_LIMIT)) * PASSES / SHARE
            if odds > limit:
                break
        return min(odds, 1.0)

    def _sky(self, area: Area, sources: Sources, catalog: Catalog, epoch_yr: float) -> _Sky | None:
        """Fetch an area's stars once."""
        if area not in self._skies:
            self._skies[area] = _sky(area, sources, catalog, epoch_yr)
        return self._skies[area]

    def _count(self, area: Area, sources: Sources, catalog: Catalog, epoch_yr: float) -> Array:
        """Measurement pairs × ordered star pairs within the scales × two parities, for each level."""
        key = (area, int(sources.x_px.size))
        if key not in self._counts:
            sky = self._sky(area, sources, catalog, epoch_yr)
            counts = np.full(len(LEVELS), np.inf)
            if sky is not None:
                for number, level in enumerate(LEVELS):
                    apart = sources.apart(level)
                    lower, upper = (_chord(apart * one / ARCSEC_PER_RAD) for one in area.scales)
                    below = np.searchsorted(sky.chords, lower, side="right")
                    pairs = np.searchsorted(sky.chords, upper, side="right") - below
                    counts[number] = 4.0 * float(pairs.sum())  # either way round, either parity
            self._counts[key] = counts
        return self._counts[key]

    def counted(
        self,
        first: Array,
        second: Array,
        apart_px: Array,
        mag: Array,
        sources: Sources,
        catalog: Catalog,
        epoch_yr: float,
    ) -> NDArray[np.bool_]:
        """Tell which anchors are among those counted.

        Parameters
        ----------
        first, second : ndarray, shape (n, 3)
            Unit vectors of the stars.
        apart_px : ndarray, shape (n,)
            Distance of the measurements.
        mag : ndarray, shape (n,)
            The fainter star's.
        sources : Sources
        catalog : Catalog
        epoch_yr : float

        Returns
        -------
        ndarray of bool, shape (n,)
            All False when an area is too rich to be counted.
        """
        among = np.zeros(apart_px.size, dtype=bool)
        chord = np.linalg.norm(first - second, axis=1)
        for area in self.areas:
            sky = self._sky(area, sources, catalog, epoch_yr)
            if sky is None:
                return np.zeros(apart_px.size, dtype=bool)
            low, high = (_chord(apart_px * one / ARCSEC_PER_RAD) for one in area.scales)
            inside = [np.linalg.norm(one - sky.middle, axis=1) <= sky.chord for one in (first, second)]
            among |= inside[0] & inside[1] & (chord > low) & (chord <= high) & (mag <= sky.mag_limit)
        return among


def _sky(area: Area, sources: Sources, catalog: Catalog, epoch_yr: float) -> _Sky | None:
    """Stars of an area that may be anchors; None if there are too many."""
    width, height = sources.width_px, sources.height_px
    pixel_deg = float(np.sqrt(area.scales[0] * area.scales[1])) / 3600.0
    reach_deg = area.radius_deg + 0.52 * float(np.hypot(width, height)) * area.scales[1] / 3600.0
    frame_deg2 = width * height * pixel_deg**2
    if reach_deg > WIDEST_DEG or np.pi * reach_deg**2 > MOST_STARS / ANCHOR_STARS * frame_deg2:
        return None
    limit = depth_for(catalog, area.center, ANCHOR_STARS, frame_deg2)
    stars = catalog.cone(area.center, reach_deg, epoch_yr=epoch_yr, mag_limit=limit)
    if len(stars) > MOST_STARS:
        return None
    middle = np.asarray(unit_vectors(area.center.ra_deg, area.center.dec_deg), dtype=float).ravel()
    chord = float(_chord(np.radians(np.array([reach_deg])))[0])
    axes = axes_of(stars).reshape(-1, 3)
    widest = np.array([np.hypot(width, height) * area.scales[1] / ARCSEC_PER_RAD])
    pairs = cKDTree(axes).query_pairs(float(_chord(widest)[0]) * 1.01, output_type="ndarray")
    chords = np.sort(np.linalg.norm(axes[pairs[:, 0]] - axes[pairs[:, 1]], axis=1))
    return _Sky(middle, chord, np.inf if limit is None else limit, chords)


def axes_of(stars: Stars) -> Array:
    """Unit vectors, shape (n, 3)."""
    return np.asarray(unit_vectors(stars.ra_deg, stars.dec_deg), dtype=float).T


def _chord(angle_rad: Array) -> Array:
    """Chord of an angle, on the unit sphere."""
    chord: Array = 2.0 * np.sin(np.minimum(angle_rad, np.pi) / 2.0)
    return chord
