"""The probability that a match is chance, counted over stars that had no part in making the plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import betainc

from mountnav.catalog.stars import Stars
from mountnav.identification.plate import SIMILARITY, Plate, fit_plate

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def binomial_sf(hits: Array, trials: Array, chance: Array | float) -> Array:
    """Binomial tail: the probability of `hits` or more of `trials` when each succeeds with `chance`.

    Parameters
    ----------
    hits, trials : ndarray of numbers, shape (n,)
        Counts; `hits` of 0 or less are certain.
    chance : float or ndarray, shape (n,)
        Probability of one trial's success, 0 to 1.

    Returns
    -------
    ndarray, shape (n,)
        1 for no hits, 0 for more hits than trials.
    """
    k = np.asarray(hits, dtype=float)
    n = np.asarray(trials, dtype=float)
    safe_k = np.clip(k, 1.0, np.maximum(n, 1.0))
    tail = betainc(safe_k, np.maximum(n - safe_k + 1.0, 1.0), chance)
    return np.asarray(np.where(k <= 0, 1.0, np.where(k > n, 0.0, tail)), dtype=float)


def _counts_in_parts(x_px: Array, y_px: Array, width_px: int, height_px: int, cells: int) -> Array:
    """How many points lie in each of cells × cells parts of the frame; shape (cells, cells), rows first."""
    column = np.floor((x_px + 0.5) * (cells / width_px)).astype(np.int64)
    row = np.floor((y_px + 0.5) * (cells / height_px)).astype(np.int64)
    inside = (column >= 0) & (column < cells) & (row >= 0) & (row < cells)
    counts = np.bincount((row * cells + column)[inside], minlength=cells**2)
    return counts.reshape(cells, cells).astype(float)


def strobe_chances(
    x_px: Array, y_px: Array, radius_px: float, *, width_px: int, height_px: int, cells: int = 4
) -> Array:
    """Chance that a point falls within a radius of a measurement, for each of cells × cells parts.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The measurements.
    width_px, height_px : int
        Size of the frame.

    Returns
    -------
    ndarray, shape (cells, cells)
        1 − exp(−density·π·radius²) with the density of the part or of the frame, whichever is more: stars
        of the catalog crowd where measurements crowd, and chance matches with them.
    """
    counts = _counts_in_parts(x_px, y_px, width_px, height_px, cells)
    per_part = width_px * height_px / cells**2
    density = np.maximum(counts, x_px.size / cells**2) / per_part
    share: Array = 1.0 - np.exp(-density * np.pi * radius_px**2)
    return share


def local_density(
    x_px: Array,
    y_px: Array,
    at_x_px: Array,
    at_y_px: Array,
    *,
    width_px: int,
    height_px: int,
    cells: int = 4,
    neighbors: int = 6,
) -> Array:
    """How densely the measurements lie where a star is predicted; never less than in the whole frame.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The measurements.
    at_x_px, at_y_px : ndarray, shape (k,)
        Predicted places inside the frame.
    cells : int
        The frame is cut in cells × cells parts.
    neighbors : int
        Number of nearest measurements that show a crowd smaller than a part: a cluster laid on another
        cluster makes many close pairs by chance.

    Returns
    -------
    ndarray, shape (k,)
        Measurements per square pixel: the most of the frame's mean, the part's, and the crowd's.
    """
    counts = _counts_in_parts(x_px, y_px, width_px, height_px, cells)
    column = np.clip(((at_x_px + 0.5) / width_px * cells).astype(int), 0, cells - 1)
    row = np.clip(((at_y_px + 0.5) / height_px * cells).astype(int), 0, cells - 1)
    per_part = width_px * height_px / cells**2
    dense: Array = np.maximum(counts[row, column], x_px.size / cells**2) / per_part
    if x_px.size >= neighbors and at_x_px.size:
        tree = cKDTree(np.column_stack((x_px, y_px)))
        away = np.asarray(tree.query(np.column_stack((at_x_px, at_y_px)), k=[neighbors])[0])[:, 0]
        # the nearest of all may be the very match that is judged; the others of the crowd give its density
        dense = np.maximum(dense, (neighbors - 1) / (np.pi * np.maximum(away, 1.0) ** 2))
    return dense


def berk_jones_p(chances: Array) -> float:
    """Probability that chance brings so many so small uniform values [Berk & Jones 1979].

    The k-th smallest of n uniform values falls below p with the binomial probability of k or more successes
    in n trials of chance p. The least of these over all k is multiplied by n, the number of tests: neither a
    strobe nor the number of true pairs has to be known beforehand, and closer pairs count for more.

    Parameters
    ----------
    chances : ndarray, shape (n,)
        Each uniform, or larger, if the plate is wrong.

    Returns
    -------
    float
        At most 1; 1 for an empty array.
    """
    n = int(chances.size)
    if n == 0:
        return 1.0
    ranked = np.sort(np.clip(chances, 0.0, 1.0))
    k = np.arange(1, n + 1)
    tails = betainc(k, n - k + 1.0, ranked)
    return float(min(1.0, n * float(tails.min())))


def trials_factor(hypotheses: int) -> float:
    """Factor by which the chance of one hypothesis is multiplied when so many were tried one after the other.

    A search that stops at the first hypothesis n with n·chance below a limit is fooled with up to
    limit·(1 + 1/2 + ... + 1/n), which grows with the search. With 2·n·(1 + ln n)² in place of n the sum stays
    below the limit however long the search: Σ 1/(n·(1 + ln n)²) < 2.
    """
    tried = max(hypotheses, 1)
    return float(2.0 * tried * (1.0 + np.log(tried)) ** 2)


MOST_STARS = 150
"""Number of catalog stars predicted in the frame that are tested, the brightest. More cost time: the odds of
a true plate are below any limit by then."""
FEW_STARS = 40
"""With fewer stars than this they are dealt in three hands, so that two thirds are tested at a time, and the
triangle also predicts alone. Chosen by hand."""
LINEAR_PAIRS = 7
"""With fewer pairs than this, the triangle's three included, the plate of a hand is a similarity: a linear
one would follow single wrong pairs. Chosen by hand."""
MANY_MEASUREMENTS = 60
"""Number of the brightest measurements that are used: at least so many, and twice as many as stars. Chosen by
hand; with more, chance pairs get closer, and stars fainter than the catalog add nothing."""
FEW_MEASUREMENTS = 15
"""Where few of the measurements can be catalog stars the brightest are tested once more alone: so many, or
three times as many as stars. It costs a factor of two in the odds."""
NEAREST_PX = 0.1
"""No pair counts as closer than this: centroids are no better, and real ones may sit on a raster."""
LEAST_CHANCE = 1e-300
"""Least probability that is reported."""


@dataclass(frozen=True, slots=True)
class Corners:
    """The three pairs of a triangle: they made the plate, so they prove nothing.

    Attributes
    ----------
    x_px, y_px, ra_deg, dec_deg : ndarray, shape (3,)
        The pairs, in pixels and ICRS.
    """

    x_px: Array
    y_px: Array
    ra_deg: Array
    dec_deg: Array


class Confirmation:
    """Measurements and stars that had no part in one hypothesis, and the odds that they confirm it by chance.

    Parameters
    ----------
    plate : Plate
        What the triangle proposed, untouched by any fit to other stars.
    stars : Stars
        Of the whole frame, brightest first.
    x_px, y_px : ndarray, shape (n,)
        Star-like measurements, brightest first.
    match_px : float
        How far off the triangle's plate may be.
    source : ndarray of int, shape (n,), optional
        Which source each measurement is a piece of (`selection.trail_pieces`): a source counts once, and not
        at all if a piece of it made the plate. Each is a source of its own if this is left out.
    """

    def __init__(
        self,
        plate: Plate,
        corners: Corners,
        stars: Stars,
        x_px: Array,
        y_px: Array,
        *,
        width_px: int,
        height_px: int,
        match_px: float,
        source: Index | None = None,
    ) -> None:
        self._plate = plate.moved_to(plate.center())
        self._width, self._height, self._match_px = width_px, height_px, match_px
        xi, eta = self._plate.project(stars.ra_deg, stars.dec_deg)
        x, y = self._plate.pixels(xi, eta)
        seen = np.flatnonzero(self._inside(x, y))[:MOST_STARS]
        corner = _among(stars.ra_deg[seen], corners.ra_deg) & _among(stars.dec_deg[seen], corners.dec_deg)
        seen = seen[~corner]
        self._xi, self._eta = xi[seen], eta[seen]
        bright = slice(0, max(MANY_MEASUREMENTS, 2 * int(seen.size)))
        taken = _among(x_px[bright], corners.x_px) & _among(y_px[bright], corners.y_px)
        source = np.arange(x_px.size, dtype=np.int64)[bright] if source is None else source[bright]
        free = ~np.isin(source, source[taken])
        self._x, self._y, self._source = x_px[bright][free], y_px[bright][free], source[free]
        few = max(FEW_MEASUREMENTS, 3 * int(seen.size))
        # a poor catalog's stars are the brightest in the frame; among fewer measurements a pair says more
        self._numbers_tested = (self._x.size, few) if few < self._x.size else (self._x.size,)
        corner_xi, corner_eta = self._plate.project(corners.ra_deg, corners.dec_deg)
        self._corners = (corners.x_px, corners.y_px, corner_xi, corner_eta)

    def _inside(self, x: Array, y: Array) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = (
            (x > -0.5) & (x < self._width - 0.5) & (y > -0.5) & (y < self._height - 0.5)
        )
        return inside

    def chance(self) -> float:
        """Probability that a wrong plate would be confirmed this well; for one hypothesis.

        The stars predicted in the frame are dealt in two hands (three if they are few). One hand teaches:
        the triangle and that hand's pairs make a plate, and all other stars are predicted with it. For a
        wrong plate the distance from a predicted star to the nearest measurement that had no part in the
        plate is distributed as the density there has it, so the chance of one as near is uniform;
        `berk_jones_p` gives the probability of all of them. Neither the triangle's three stars and
        measurements, nor anything fit to the stars tested, takes part. Each hand teaches once, if stars are
        few the triangle also alone, and the brightest measurements are also tested alone: the least
        probability is multiplied by the number of tests.

        Returns
        -------
        float
            Never below 1e-300.
        """
        count = int(self._xi.size)
        if count == 0 or self._x.size == 0:
            return 1.0
        few = count < FEW_STARS
        hands = 3 if few else 2
        hand = np.arange(count) % hands
        lessons = [hand == teaching for teaching in range(hands)]
        if few:
            lessons.append(np.zeros(count, dtype=bool))
        least = 1.0
        for teaching in lessons:
            taught, used = self._taught(teaching)
            x, y = taught.pixels(self._xi[~teaching], self._eta[~teaching])
            inside = self._inside(x, y)
            for brightest in self._numbers_tested:
                least = min(least, self._agreement(x[inside], y[inside], used, brightest))
        return float(np.clip(len(lessons) * len(self._numbers_tested) * least, LEAST_CHANCE, 1.0))

    def _agreement(self, x: Array, y: Array, used: Index, brightest: int) -> float:
        """How probable it is that predicted positions lie so near to the brightest measurements by chance."""
        unused = ~np.isin(self._source, self._source[used])
        mx, my = self._x[:brightest][unused[:brightest]], self._y[:brightest][unused[:brightest]]
        source = np.unique(self._source[:brightest][unused[:brightest]], return_inverse=True)[1]
        if x.size == 0 or mx.size == 0:
            return 1.0
        distance, nearest = (
            np.asarray(part) for part in cKDTree(np.column_stack((mx, my))).query(np.column_stack((x, y)))
        )
        dense = local_density(
            self._x[:brightest], self._y[:brightest], x, y, width_px=self._width, height_px=self._height
        )
        chance = -np.expm1(-dense * np.pi * np.maximum(distance, NEAREST_PX) ** 2)
        # a source confirms one star: two stars of a pair at the same position are one event, and so are two
        # stars that lie as far apart as the pieces of a trail
        order = np.argsort(chance, kind="stable")
        best = np.full(mx.size, -1)
        best[source[nearest[order[::-1]]]] = order[::-1]
        once = np.ones(chance.size)
        once[best[best >= 0]] = chance[best[best >= 0]]
        return berk_jones_p(once)

    def _taught(self, teaching: NDArray[np.bool_]) -> tuple[Plate, Index]:
        """The plate of the triangle and the pairs of one hand, and which measurements made it."""
        plate, used = self._plate, np.zeros(0, dtype=np.int64)
        if not teaching.any():
            return plate, used
        strobe_px = max(2.5, min(self._match_px, 0.006 * min(self._width, self._height)))
        tree = cKDTree(np.column_stack((self._x, self._y)))
        for radius in (self._match_px, strobe_px):
            x, y = plate.pixels(self._xi[teaching], self._eta[teaching])
            distance, nearest = (np.asarray(part) for part in tree.query(np.column_stack((x, y))))
            near = distance <= radius
            found = np.flatnonzero(teaching)[near]
            used = nearest[near].astype(np.int64)
            corner_x, corner_y, corner_xi, corner_eta = self._corners
            pair_x = np.concatenate((corner_x, self._x[used]))
            pair_y = np.concatenate((corner_y, self._y[used]))
            pair_xi = np.concatenate((corner_xi, self._xi[found]))
            pair_eta = np.concatenate((corner_eta, self._eta[found]))
            degree = 1 if pair_x.size >= LINEAR_PAIRS else SIMILARITY
            plate = fit_plate(self._plate, pair_x, pair_y, pair_xi, pair_eta, np.ones(pair_x.size), degree)
            if plate.parity != self._plate.parity:
                return self._plate, np.zeros(0, dtype=np.int64)
        return plate, used


def _among(values: Array, few: Array) -> NDArray[np.bool_]:
    """Which of the values are among a few others."""
    among: NDArray[np.bool_] = (values[:, None] == few).any(axis=1)
    return among
