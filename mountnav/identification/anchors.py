"""Odds from two-star anchors: how many could have fixed a wrong plate, and what all other stars say."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.star_counts import depth_for
from mountnav.catalog.stars import Catalog, Stars
from mountnav.identification.odds import (
    FEW_MEASUREMENTS,
    LEAST_CHANCE,
    LINEAR_PAIRS,
    MANY_MEASUREMENTS,
    NEAREST_PX,
    berk_jones_p,
    local_density,
)
from mountnav.identification.plate import SIMILARITY, Plate, fit_plate
from mountnav.identification.search_area import WIDEST_FRAME_DEG
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEVELS: Final = (6, 12, 24, 48, 96, 192)
"""Anchors are counted among so many of the brightest measurements, each level for itself."""
PARTS_OF_LIMIT: Final = (1 / 4, 1 / 4, 1 / 4, 1 / 8, 1 / 16, 1 / 16)
"""What each level has of the limit: few stars are found by bright ones."""
APART: Final = 0.25
"""Least distance of an anchor's measurements, in shorter frame sides. Halved, an anchor's plate is twice as
uncertain on the frame's far side, and there are more anchors to count."""
ANCHOR_STARS: Final = 30
"""Anchors are the catalog's stars so deep that a poor frame holds so many. More stars make more anchors, and
with them odds that prove less."""
SHARE: Final = 0.15
"""Share of the limit that belongs to this test: the other's sum Σ 1/(n(1 + ln n)²) is 1.69 < 2·(1 − 0.15).
Doubled, the two tests together would exceed the limit."""
PASSES: Final = 7
"""Number of searches of one frame: fast, and in full, twice with each of up to three catalogs. The odds are
multiplied for them; halved, they would promise too much."""
MOST_STARS: Final = 5000
"""In an area with more stars the anchors are so many that this test decides nothing. It saves the
counting."""


@dataclass(frozen=True, slots=True)
class SearchedPart:
    """A part of what is searched: where the frame's center may be, and at what scale.

    Attributes
    ----------
    scales : (float, float)
        Arcsec per pixel.
    measured : int
        How many measurements took part: another list is another search.
    """

    center: Icrs
    radius_deg: float
    scales: tuple[float, float]
    measured: int

    def covers(self, other: SearchedPart) -> bool:
        """Whether all of the other area was in this one."""
        return (
            (self.center, self.measured) == (other.center, other.measured)
            and self.radius_deg >= other.radius_deg
            and self.scales[0] <= other.scales[0]
            and self.scales[1] >= other.scales[1]
        )


@dataclass(frozen=True, slots=True)
class AnchorSources:
    """The measurements that take part, and the frame's size.

    Attributes
    ----------
    x_px, y_px : ndarray, shape (n,)
        Brightest first.
    mag : ndarray, shape (n,)
        Magnitudes of an unknown zero point; NaN where there is no flux.
    piece_of : ndarray of int, shape (n,), or None
        Which source each measurement is a piece of (`selection.trail_pieces`); None: each is a source of its
        own.
    """

    x_px: Array
    y_px: Array
    mag: Array
    width_px: int
    height_px: int
    piece_of: Index | None = None

    @classmethod
    def of(cls, measurements: Measurements, usable: Index, piece_of: Index | None = None) -> AnchorSources:
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
class _AnchorStars:
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

    areas: list[SearchedPart] = field(default_factory=list)
    _skies: dict[SearchedPart, _AnchorStars | None] = field(default_factory=dict)
    _counts: dict[tuple[SearchedPart, int], Array] = field(default_factory=dict)
    chances: dict[tuple[int, int, bytes], Array] = field(default_factory=dict)

    def searched(self, area: SearchedPart) -> None:
        """Remember that an area is searched from now on."""
        if not any(part.covers(area) for part in self.areas):
            self.areas.append(area)

    def odds(
        self, chances: Array, sources: AnchorSources, catalog: Catalog, epoch_yr: float, limit: float
    ) -> float:
        """Odds of the best of the hypothesis' anchors.

        With n anchors searched so far and n₀ in the first area the chance of one is multiplied by
        2·n·(1 + ln n/n₀)²: the first area's anchors take half of the limit, ∫ dn/(2n(1 + ln n/n₀)²) = ½ is
        left for all that follow, however far the search goes and wherever it stops.

        Parameters
        ----------
        chances : ndarray, shape (levels,)
            The best anchor's of each of `LEVELS`.
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

    def _sky(
        self, area: SearchedPart, sources: AnchorSources, catalog: Catalog, epoch_yr: float
    ) -> _AnchorStars | None:
        """Fetch an area's stars once."""
        if area not in self._skies:
            self._skies[area] = _anchor_stars(area, sources, catalog, epoch_yr)
        return self._skies[area]

    def _count(self, area: SearchedPart, sources: AnchorSources, catalog: Catalog, epoch_yr: float) -> Array:
        """Measurement pairs × ordered star pairs within the scales × two parities, for each level."""
        key = (area, int(sources.x_px.size))
        if key not in self._counts:
            sky = self._sky(area, sources, catalog, epoch_yr)
            counts = np.full(len(LEVELS), np.inf)
            if sky is not None:
                for number, level in enumerate(LEVELS):
                    apart = sources.apart(level)
                    lower, upper = (_chord(apart * scale / ARCSEC_PER_RAD) for scale in area.scales)
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
        sources: AnchorSources,
        catalog: Catalog,
        epoch_yr: float,
    ) -> NDArray[np.bool_]:
        """Which anchors are among those counted.

        Parameters
        ----------
        first, second : ndarray, shape (n, 3)
            Unit vectors of the stars.
        apart_px : ndarray, shape (n,)
            Distance of the measurements.
        mag : ndarray, shape (n,)
            The fainter star's.

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
            low, high = (_chord(apart_px * scale / ARCSEC_PER_RAD) for scale in area.scales)
            inside = [np.linalg.norm(axes - sky.middle, axis=1) <= sky.chord for axes in (first, second)]
            among |= inside[0] & inside[1] & (chord > low) & (chord <= high) & (mag <= sky.mag_limit)
        return among


def _anchor_stars(
    area: SearchedPart, sources: AnchorSources, catalog: Catalog, epoch_yr: float
) -> _AnchorStars | None:
    """Stars of an area that may be anchors; None if there are too many."""
    width, height = sources.width_px, sources.height_px
    pixel_deg = float(np.sqrt(area.scales[0] * area.scales[1])) / 3600.0
    reach_deg = area.radius_deg + 0.52 * float(np.hypot(width, height)) * area.scales[1] / 3600.0
    frame_deg2 = width * height * pixel_deg**2
    if reach_deg > WIDEST_FRAME_DEG or np.pi * reach_deg**2 > MOST_STARS / ANCHOR_STARS * frame_deg2:
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
    return _AnchorStars(middle, chord, np.inf if limit is None else limit, chords)


def axes_of(stars: Stars) -> Array:
    """Unit vectors, shape (n, 3)."""
    return np.asarray(unit_vectors(stars.ra_deg, stars.dec_deg), dtype=float).T


def _chord(angle_rad: Array) -> Array:
    """Chord of an angle, on the unit sphere."""
    chord: Array = 2.0 * np.sin(np.minimum(angle_rad, np.pi) / 2.0)
    return chord


MEASUREMENTS_ASKED: Final = 40
"""Number of the brightest other stars whose nearest measurements are counted. Chosen by hand."""
ANCHORS_TRIED: Final = 12
"""Number of anchors of each level that are tried for a hypothesis, the widest first. As all anchors are
counted, the number changes time and power of the test, not its honesty."""
SURE_BELOW: Final = 1e-20
"""An anchor of this chance ends the search for a better one: no solution is allowed less than 1e-9."""
ALIKE_MAG: Final = 0.75
"""A measurement is as bright as a star if its magnitude, by the pairs' zero point, is as near as this. Chosen
by hand: catalog bands differ from a camera's by some tenths of a magnitude."""
TAKEN_BELOW: Final = 0.01
"""A star this near to a measurement takes part in the plate that predicts the next one. Larger, chance pairs
would bend that plate."""
LEAST_PAIRS: Final = 5
"""Fewest pairs, the anchor's two included, with which a hypothesis is tested: an anchor and two more pairs
prove nothing."""
PARTS: Final = 4
"""The frame is cut in PARTS × PARTS parts to see where it is crowded."""


def anchored_odds(
    plate: Plate,
    stars: Stars,
    sources: AnchorSources,
    anchors: Anchors,
    catalog: Catalog,
    epoch_yr: float,
    *,
    match_px: float,
    limit: float = 1.0,
) -> float:
    """Probability that anything searched so far would be confirmed as well as this if all of it were wrong.

    Two pairs of a star and a measurement fix a similarity. All such anchors of the searched area are
    counted, so one may be chosen freely from the pairs at hand. Its plate predicts the other stars, one
    after the other from the anchor's middle outward: for a wrong sky the distance to the nearest
    measurement that has no part in the plate is distributed as the density has it, and stays so when the
    pairs found before have refined the plate, since they are left out. `berk_jones_p` gives the
    probability of the distances; times the ways of asking, times the anchors, it bounds the probability.

    Parameters
    ----------
    plate : Plate
        The hypothesis; only its pairs matter.
    stars : Stars
        Of the whole frame, brightest first.
    catalog : Catalog
        Asked for the stars of the areas searched, once.
    match_px : float
        How far off the hypothesis may be.
    limit : float
        Of interest is only whether the odds exceed it.

    Returns
    -------
    float
        1 if the hypothesis holds no anchor that was counted; no more than the odds if they exceed the limit.
    """
    case = Case(plate, stars, sources, match_px)
    if len(case.pairs) < LEAST_PAIRS:
        return 1.0
    chances = _best(case, anchors, stars, catalog, epoch_yr)
    if chances.min() >= 1.0:
        return 1.0
    return anchors.odds(chances, sources, catalog, epoch_yr, limit)


def _best(case: Case, anchors: Anchors, stars: Stars, catalog: Catalog, epoch_yr: float) -> Array:
    """Least chance among a case's anchors, for each of `LEVELS`; remembered for the same pairs."""
    key = (len(anchors.areas), int(case.sources.x_px.size), case.pairs.tobytes())
    if key not in anchors.chances:
        level, a, b = case.candidates()
        x, y = case.sources.x_px, case.sources.y_px
        apart = np.hypot(x[a[:, 1]] - x[b[:, 1]], y[a[:, 1]] - y[b[:, 1]])
        axes = axes_of(stars)
        fainter = np.maximum(stars.mag[a[:, 0]], stars.mag[b[:, 0]])
        among = anchors.counted(axes[a[:, 0]], axes[b[:, 0]], apart, fainter, case.sources, catalog, epoch_yr)
        chances = np.ones(len(LEVELS))
        for number in range(len(LEVELS)):
            able = np.flatnonzero(among & (level == number))
            for anchor in able[np.argsort(-apart[able], kind="stable")][:ANCHORS_TRIED]:
                if chances.min() > SURE_BELOW:
                    chances[number] = min(chances[number], case.chance(a[anchor], b[anchor]))
        anchors.chances[key] = np.maximum(chances, LEAST_CHANCE)
    return anchors.chances[key]


class Case:
    """A hypothesis, its pairs, and what an anchor among them says about all other stars."""

    def __init__(self, plate: Plate, stars: Stars, sources: AnchorSources, match_px: float) -> None:
        self._plate, self.sources, self._mag = plate.moved_to(plate.center()), sources, stars.mag
        self._match_px = match_px
        self._xi, self._eta = self._plate.project(stars.ra_deg, stars.dec_deg)
        x, y = self._plate.pixels(self._xi, self._eta)
        self._seen = np.flatnonzero(self._inside(x, y))
        bright = self._seen[: 2 * ANCHOR_STARS]
        self.pairs = self._paired(bright, x[bright], y[bright])

    def _inside(self, x: Array, y: Array) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = (
            (x > -0.5) & (x < self.sources.width_px - 0.5) & (y > -0.5) & (y < self.sources.height_px - 0.5)
        )
        return inside

    def _paired(self, star: Index, x: Array, y: Array) -> Index:
        """Bright stars and the nearest of the brightest measurements; shape (n, 2)."""
        bright = slice(0, LEVELS[-1])
        mx, my = self.sources.x_px[bright], self.sources.y_px[bright]
        if x.size == 0 or mx.size == 0:
            return np.zeros((0, 2), dtype=np.int64)
        distance, nearest = (
            np.asarray(part) for part in cKDTree(np.column_stack((mx, my))).query(np.column_stack((x, y)))
        )
        near = np.flatnonzero(distance <= self._match_px)
        return np.column_stack((star[near], nearest[near])).astype(np.int64)

    def candidates(self) -> tuple[Index, Index, Index]:
        """Level and two pairs (star, measurement) of each anchor that could be chosen."""
        i, j = np.triu_indices(len(self.pairs), 1)
        one, other = self.pairs[i, 1], self.pairs[j, 1]
        x, y = self.sources.x_px, self.sources.y_px
        wide = np.hypot(x[one] - x[other], y[one] - y[other]) >= self.sources.least_px()
        level = np.searchsorted(np.array(LEVELS), np.maximum(one, other), side="right")
        return level[wide].astype(np.int64), self.pairs[i[wide]], self.pairs[j[wide]]

    def chance(self, a: Index, b: Index) -> float:
        """Probability that a wrong anchor's plate finds the other stars so near to measurements."""
        star, measurement = np.array([a[0], b[0]]), np.array([a[1], b[1]])
        plate = self._fit(star, measurement)
        x, y = plate.pixels(self._xi, self._eta)
        seen = np.flatnonzero(self._inside(x, y))
        others = seen[~np.isin(seen, star)][:MEASUREMENTS_ASKED]
        if others.size == 0:
            return 1.0
        middle_x, middle_y = self.sources.x_px[measurement].mean(), self.sources.y_px[measurement].mean()
        order = np.argsort(np.hypot(x[others] - middle_x, y[others] - middle_y), kind="stable")
        others = others[order]
        many, few = max(MANY_MEASUREMENTS, 2 * int(seen.size)), max(FEW_MEASUREMENTS, 3 * int(seen.size))
        counts = {min(count, int(self.sources.x_px.size)) for count in (many, few)}
        ways = [(count, np.inf) for count in sorted(counts)] + [(int(self.sources.x_px.size), ALIKE_MAG)]
        least = min(self._followed(plate, star, measurement, others, x, y, *way) for way in ways)
        return len(ways) * least

    def _followed(
        self,
        plate: Plate,
        star: Index,
        measurement: Index,
        others: Index,
        x: Array,
        y: Array,
        brightest: int,
        alike_mag: float,
    ) -> float:
        """Predict the others one after the other, each with the plate of all that were found before."""
        mx, my = self.sources.x_px[:brightest], self.sources.y_px[:brightest]
        part = self._part(mx, my)
        width, height = self.sources.width_px, self.sources.height_px
        dense = local_density(mx, my, x[others], y[others], width_px=width, height_px=height)
        # the pieces of one trail are one event
        free = ~self.sources.with_pieces(measurement)[: mx.size]
        chances = []
        for number, one in enumerate(others):
            at_x, at_y = plate.pixels(self._xi[one : one + 1], self._eta[one : one + 1])
            if not self._inside(at_x, at_y)[0]:
                continue
            crowd, able = float(dense[number]), free
            if np.isfinite(alike_mag):
                zero = float(np.mean(self._mag[star] - self.sources.mag[measurement]))
                alike = np.abs(self.sources.mag[:brightest] + zero - self._mag[one]) <= alike_mag
                able = free & alike
                crowd = self._crowd(alike, part == self._part(at_x, at_y)[0], crowd)
            if not able.any():
                chances.append(1.0)
                continue
            away = np.where(able, np.hypot(mx - at_x, my - at_y), np.inf)
            nearest = int(away.argmin())
            distance = max(float(away[nearest]), NEAREST_PX)
            chance = float(-np.expm1(-crowd * np.pi * distance**2))
            chances.append(chance)
            if chance < TAKEN_BELOW:
                free &= ~self.sources.with_pieces(np.array([nearest]))[: mx.size]
                if distance <= self._match_px:
                    star, measurement = np.append(star, one), np.append(measurement, nearest)
                    plate = self._fit(star, measurement)
        return berk_jones_p(np.array(chances))

    def _crowd(self, alike: NDArray[np.bool_], near: NDArray[np.bool_], crowd: float) -> float:
        """How densely measurements of one brightness lie in a part of the frame, where `crowd` of any do."""
        area = self.sources.width_px * self.sources.height_px
        count = int(alike.sum())
        # one may be the very match that is judged; and a crowd's bright ones crowd as its others do
        others = int((alike & near).sum()) - 1
        return max(count / area, others * PARTS**2 / area, crowd * count / alike.size)

    def _part(self, x: Array, y: Array) -> Index:
        """In which of PARTS × PARTS parts of the frame places lie."""
        column = np.clip((x + 0.5) / self.sources.width_px * PARTS, 0, PARTS - 1).astype(np.int64)
        row = np.clip((y + 0.5) / self.sources.height_px * PARTS, 0, PARTS - 1).astype(np.int64)
        return row * PARTS + column

    def _fit(self, star: Index, measurement: Index) -> Plate:
        """The plate through pairs; two make a similarity."""
        x, y = self.sources.x_px[measurement], self.sources.y_px[measurement]
        degree = 1 if star.size >= LINEAR_PAIRS else SIMILARITY
        return fit_plate(self._plate, x, y, self._xi[star], self._eta[star], np.ones(star.size), degree)
