"""Odds that don't ask how a place was searched for: two stars fix a plate, all others must fall in place."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Catalog, Stars
from mountnav.identification.anchor_count import ANCHOR_STARS, LEVELS, Anchors, Sources, axes_of
from mountnav.identification.confirmation import (
    FEW_MEASUREMENTS,
    LEAST_CHANCE,
    LINEAR_PAIRS,
    MANY_MEASUREMENTS,
    NEAREST_PX,
)
from mountnav.identification.odds import density, together
from mountnav.identification.plate import SIMILARITY, Plate, fit_plate

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ASKED: Final = 40
"""So many of the brightest other stars are asked."""
TRIED: Final = 12
"""So many anchors of each level are tried for a hypothesis, the widest first: all are counted anyway."""
ENOUGH: Final = 1e-20
"""After an anchor of this chance no other is asked."""
ALIKE_MAG: Final = 0.75
"""A measurement is as bright as a star if its magnitude, by the pairs' zero point, is as near as this."""
LEARNED: Final = 0.01
"""A star this near to a measurement takes part in the plate that predicts the next one."""
LEAST_PAIRS: Final = 5
"""An anchor and two more prove nothing."""
PARTS: Final = 4
"""The frame is cut in PARTS × PARTS parts to see where it is crowded."""


def anchored_odds(
    plate: Plate,
    stars: Stars,
    sources: Sources,
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
    pairs found before have refined the plate, since they are left out. `together` tells how probable the
    distances are; times the looks, times the anchors, it bounds the probability.

    Parameters
    ----------
    plate : Plate
        The hypothesis; only its pairs matter.
    stars : Stars
        Of the whole frame, brightest first.
    sources : Sources
    anchors : Anchors
    catalog : Catalog
        Asked for the stars of the areas searched, once.
    epoch_yr : float
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
            for one in able[np.argsort(-apart[able], kind="stable")][:TRIED]:
                if chances.min() > ENOUGH:
                    chances[number] = min(chances[number], case.chance(a[one], b[one]))
        anchors.chances[key] = np.maximum(chances, LEAST_CHANCE)
    return anchors.chances[key]


class Case:
    """A hypothesis, its pairs, and what an anchor among them says about all other stars."""

    def __init__(self, plate: Plate, stars: Stars, sources: Sources, match_px: float) -> None:
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
            np.asarray(one) for one in cKDTree(np.column_stack((mx, my))).query(np.column_stack((x, y)))
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
        others = seen[~np.isin(seen, star)][:ASKED]
        if others.size == 0:
            return 1.0
        middle_x, middle_y = self.sources.x_px[measurement].mean(), self.sources.y_px[measurement].mean()
        order = np.argsort(np.hypot(x[others] - middle_x, y[others] - middle_y), kind="stable")
        others = others[order]
        many, few = max(MANY_MEASUREMENTS, 2 * int(seen.size)), max(FEW_MEASUREMENTS, 3 * int(seen.size))
        counts = {min(count, int(self.sources.x_px.size)) for count in (many, few)}
        looks = [(count, np.inf) for count in sorted(counts)] + [(int(self.sources.x_px.size), ALIKE_MAG)]
        least = min(self._followed(plate, star, measurement, others, x, y, *look) for look in looks)
        return len(looks) * least

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
        """Ask the others in turn, each with the plate of all that were found before."""
        mx, my = self.sources.x_px[:brightest], self.sources.y_px[:brightest]
        part = self._part(mx, my)
        width, height = self.sources.width_px, self.sources.height_px
        dense = density(mx, my, x[others], y[others], width_px=width, height_px=height)
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
            if chance < LEARNED:
                free &= ~self.sources.with_pieces(np.array([nearest]))[: mx.size]
                if distance <= self._match_px:
                    star, measurement = np.append(star, one), np.append(measurement, nearest)
                    plate = self._fit(star, measurement)
        return together(np.array(chances))

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
