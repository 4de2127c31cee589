"""The lens of a wide frame: fitted first to the stars about its middle, then outward, ring after ring.

About its middle any lens is nearly a plane, and the ordinary search finds the stars there. What the lens does
farther out follows from them with an error that is known; stars are looked for within that error only, so
that each ring makes the next one certain. Where a ring's stars aren't found (a horizon, a dome) it ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.lens import MOST_TERMS, Lens
from mountnav.identification.pairing import Pairs, mutually_nearest
from mountnav.identification.plate import Plate
from mountnav.measuring.measurements import Measurements
from mountnav.measuring.medians import median
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced
from mountnav.sky.wcs import places_at_pixels
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Index = NDArray[np.int64]

StarsRound = Callable[[Icrs, float, int], Stars]
"""From a center, a radius in degrees and a number to so many of the brightest stars there, or more."""

TERM_SIGMA = (1.0, 0.4, 0.2, 0.1, 0.05)
"""How large θ³, θ⁵, ... are expected to be, one sigma, θ in radians: tan θ has 0.33, 0.13, 0.05, 0.02, 0.01,
fisheyes less, and a lens bent by 10 % at 24° has 0.6 more of the first. Wider ones make rings smaller."""
AXIS_SHARE = 0.01
"""How far the axis is expected from the frame's center, one sigma, in diagonals: sensors are centered to a
percent or so."""
RING = 1.15
"""Each ring reaches so many times as far as the last. Chosen by hand; at 1.3 bent lenses lose stars."""
LEAST_TOLERANCE_PX, TOLERANCE_SIGMAS, MOST_TOLERANCE_SPACINGS = 1.5, 4.0, 0.2
"""A star is looked for within so many sigmas of its predicted place, at least so far, and at most this share
of the mean distance of stars: at 0.2 a false source lies there for one star in eight."""
RING_STARS, RING_SHARE = 6, 0.35
"""A ring of so many stars and more, of which fewer than this share are found, ends the frame's sky."""
FEWEST_STARS, MOST_STARS = 150, 800
"""Stars that are looked for in the whole frame; as many as sources that were measured, within these."""
SOURCES_A_STAR = 3
"""Of the brightest sources so many a star are looked at."""
TAIL_Z2 = 8.0
"""As in `camera_fit`: pairs farther off lose weight."""
OUT_SIGMAS = 4.0
"""Pairs farther off than this aren't kept in the last fit: of 1,000 honest ones it leaves out one."""
FEWEST_PAIRS = 12
"""A lens of so many unknowns isn't held by fewer pairs."""
_STEPS = 8
"""Steps of a fit at most; three suffice mostly."""
_FLOOR_PX = 0.01
"""Least error of a pair beyond the known, so that no perfect pair counts for all."""
_LINEAR = 8
"""Parameters before the terms: axis on the sky (2), matrix (4), axis on the detector (2)."""


@dataclass(frozen=True, slots=True)
class LensFit:
    """A lens and the pairs that hold it.

    Attributes
    ----------
    pairs : Pairs
        Into the measurements and into `stars`.
    dx_px, dy_px : ndarray, shape (n,)
        Measured minus predicted.
    sigma_px : ndarray, shape (n,)
        Expected error per coordinate: centroid, catalog, and what neither knows of.
    extra_px : float
        That last part.
    reach_rad : float
        Stars were found out to this angle from the axis.
    found_share : float
        Of the stars predicted within the reach.
    corner_sigma_px : float
        Error of where the lens puts the sky at the worst corner, one sigma.
    left_out : int
        Pairs that were too far off.
    leverage : ndarray, shape (n,)
        How much each pair holds the lens at its own position, mean of both coordinates.
    center_covariance_px2 : ndarray, shape (2, 2)
        Of where the position at the frame's center falls.
    """

    lens: Lens
    pairs: Pairs
    stars: Stars
    dx_px: Array
    dy_px: Array
    sigma_px: Array
    extra_px: float
    reach_rad: float
    found_share: float
    corner_sigma_px: float
    left_out: int
    leverage: Array
    center_covariance_px2: Array

    @property
    def rms_px(self) -> float:
        """Of both coordinates in quadrature."""
        return float(np.sqrt(np.mean(self.dx_px**2 + self.dy_px**2)))


def fit_lens(
    start: Plate,
    stars_of_start: Stars,
    pairs: Pairs,
    measurements: Measurements,
    usable: Index,
    stars_round: StarsRound,
) -> LensFit | None:
    """Fit the lens of a frame whose middle is solved.

    Parameters
    ----------
    start : Plate
        Of the middle, in the pixels of the whole frame.
    pairs : Pairs
        Those that hold `start`: into `measurements` and `stars_of_start`.
    usable : ndarray of int
        Which measurements may be stars, brightest first.

    Returns
    -------
    LensFit or None
        None where the pairs hold no lens.
    """
    if len(pairs) < FEWEST_PAIRS:
        return None
    width, height = measurements.width_px, measurements.height_px
    lens = Lens(
        axis=start.center(),
        axis_x_px=(width - 1) / 2.0,
        axis_y_px=(height - 1) / 2.0,
        matrix=np.asarray(np.linalg.inv(start.matrix()) * ARCSEC_PER_RAD, dtype=np.float64),
        terms=np.zeros(MOST_TERMS),
        width_px=width,
        height_px=height,
    )
    held = _fitted(lens, lens, stars_of_start, pairs, measurements)
    if held is None:
        return None
    half_px = 0.5 * math.hypot(width, height)
    widest_deg = min(1.15 * math.degrees(half_px / math.sqrt(abs(np.linalg.det(held.lens.matrix)))), 110.0)
    count = int(np.clip(usable.size, FEWEST_STARS, MOST_STARS))
    stars = stars_round(held.lens.axis, widest_deg, count)
    chosen = np.sort(np.argsort(stars.mag, kind="stable")[: 2 * count])
    seen_away = _away(held.lens, stars_of_start, pairs.star)
    return _Growth(stars, chosen, measurements, usable, lens).grown(held, float(np.quantile(seen_away, 0.9)))


@dataclass(frozen=True, slots=True)
class _Held:
    """A fit: the lens, the covariance of its parameters, what is left over."""

    lens: Lens
    covariance: Array
    dx_px: Array
    dy_px: Array
    sigma_px: Array
    extra_px: float


class _Growth:
    """The stars and sources of one frame, and the way outward.

    Parameters
    ----------
    first : Lens
        What is expected of the lens: the axis in the middle, no terms.
    """

    def __init__(
        self, stars: Stars, chosen: Index, measurements: Measurements, usable: Index, first: Lens
    ) -> None:
        self._stars, self._chosen, self._m, self._first = stars, chosen, measurements, first
        self._usable = usable[: max(SOURCES_A_STAR * chosen.size, FEWEST_STARS)]
        self._tree = cKDTree(
            np.column_stack((measurements.x_px[self._usable], measurements.y_px[self._usable]))
        )

    def grown(self, held: _Held, reach_rad: float) -> LensFit | None:
        """Ring after ring; None where the middle isn't found again."""
        pairs, told = self._found(held, reach_rad)
        if len(pairs) < FEWEST_PAIRS:
            return None
        corner = held.lens.corner_rad()
        ended, last = False, reach_rad
        while not ended:
            again = _fitted(held.lens, self._first, self._stars, pairs, self._m)
            if again is None:
                return None
            held = again
            corner = min(held.lens.corner_rad(), math.pi / 1.6)
            ended = last >= corner
            reach = min(RING * last + 0.01, corner + 0.02)
            pairs, told = self._found(held, reach)
            ring = told.away_rad > last
            if not ended and ring.sum() >= RING_STARS and told.found[ring].mean() < RING_SHARE:
                # once more, nearer: what was predicted from too near may be found from there
                pairs, told = self._found(held, last + 0.3 * (reach - last))
                ring = told.away_rad > last
                if ring.sum() < RING_STARS or told.found[ring].mean() < RING_SHARE:
                    pairs, told = self._found(held, last)
                    ended = True
                else:
                    reach = last + 0.3 * (reach - last)
            if not ended:
                last = reach
        return self._finished(held, last)

    def _finished(self, held: _Held, reach_rad: float) -> LensFit | None:
        """The last fits: narrow tolerances, outliers left out."""
        for _ in range(2):
            pairs, told = self._found(held, reach_rad)
            again = _fitted(held.lens, self._first, self._stars, pairs, self._m)
            if again is None:
                return None
            held = again
        near = np.hypot(held.dx_px, held.dy_px) <= OUT_SIGMAS * held.sigma_px
        if near.sum() < FEWEST_PAIRS:
            return None
        pairs = pairs.those(near)
        again = _fitted(held.lens, self._first, self._stars, pairs, self._m)
        if again is None or not again.lens.rises_to(min(reach_rad, again.lens.corner_rad())):
            return None
        away = _away(again.lens, self._stars, pairs.star)
        inside = told.away_rad <= reach_rad
        middle = again.lens.place((again.lens.width_px - 1) / 2.0, (again.lens.height_px - 1) / 2.0)
        slopes = _slopes(again.lens, np.array([middle.ra_deg]), np.array([middle.dec_deg]))[:, :, 0]
        of_pairs = _slopes(again.lens, self._stars.ra_deg[pairs.star], self._stars.dec_deg[pairs.star])
        own = np.einsum("pcn,pq,qcn->n", of_pairs, again.covariance, of_pairs)
        # residuals larger than the errors say make the center as much less certain
        excess = max(1.0, float(np.mean((again.dx_px**2 + again.dy_px**2) / (2.0 * again.sigma_px**2))))
        return LensFit(
            lens=again.lens,
            pairs=pairs,
            stars=self._stars,
            dx_px=again.dx_px,
            dy_px=again.dy_px,
            sigma_px=again.sigma_px,
            extra_px=again.extra_px,
            reach_rad=float(away.max()),
            found_share=float(told.found[inside].mean()) if inside.any() else 0.0,
            corner_sigma_px=math.sqrt(excess) * _corner_sigma_px(again),
            left_out=int((~near).sum()),
            leverage=np.minimum(0.5 * own / again.sigma_px**2, 1.0),
            center_covariance_px2=excess * (slopes.T @ again.covariance @ slopes),
        )

    def _found(self, held: _Held, reach_rad: float) -> tuple[Pairs, _Told]:
        """Stars within the reach, and the sources that they are."""
        lens, stars = held.lens, self._stars
        away = _away(lens, stars, self._chosen)
        x, y = lens.pixels(stars.ra_deg[self._chosen], stars.dec_deg[self._chosen])
        inside = (away <= reach_rad) & (x > 0) & (x < lens.width_px - 1) & (y > 0) & (y < lens.height_px - 1)
        at = np.flatnonzero(inside)
        if at.size == 0:
            return Pairs(at, at), _Told(away[at], inside[at])
        star = self._chosen[at]
        slopes = _slopes(lens, stars.ra_deg[star], stars.dec_deg[star])
        sigma = np.sqrt(np.einsum("pcn,pq,qcn->n", slopes, held.covariance, slopes))
        spread = median(np.hypot(held.dx_px, held.dy_px))
        area = lens.width_px * lens.height_px * min(1.0, at.size / max(self._chosen.size, 1) + 0.01)
        spacing = math.sqrt(area / at.size)
        tolerance = np.clip(
            3.0 * spread + TOLERANCE_SIGMAS * sigma,
            LEAST_TOLERANCE_PX,
            max(MOST_TOLERANCE_SPACINGS * spacing, 2.0 * LEAST_TOLERANCE_PX),
        )
        distance, source = map(np.asarray, self._tree.query(np.column_stack((x[at], y[at]))))
        near = np.flatnonzero(distance <= tolerance)
        best = near[mutually_nearest(distance[near] ** 2, near, source[near])]
        found = np.zeros(at.size, dtype=bool)
        found[best] = True
        return Pairs(self._usable[source[best]], star[best]), _Told(away[at], found)


@dataclass(frozen=True, slots=True)
class _Told:
    """Of the predicted stars: how far from the axis, and whether found."""

    away_rad: Array
    found: NDArray[np.bool_]


def _away(lens: Lens, stars: Stars, star: Index) -> Array:
    """Angles from the axis, radians."""
    lon = np.radians(stars.ra_deg[star] - lens.axis.ra_deg)
    lat, lat0 = np.radians(stars.dec_deg[star]), math.radians(lens.axis.dec_deg)
    half = np.sin(0.5 * (lat - lat0)) ** 2 + np.cos(lat) * math.cos(lat0) * np.sin(0.5 * lon) ** 2
    return np.asarray(2.0 * np.arcsin(np.sqrt(np.minimum(half, 1.0))))


def _moved(lens: Lens, step: Array) -> Lens:
    """The lens with its parameters changed: axis (radians, east and north), matrix, axis' pixel, terms."""
    axis = displaced(lens.axis, step[0] * ARCSEC_PER_RAD, step[1] * ARCSEC_PER_RAD)
    # directions are counted from the north at the axis: else a move near a pole would turn the frame
    turn = math.radians(axis.ra_deg - lens.axis.ra_deg)
    turn = math.remainder(turn, math.tau) * math.sin(math.radians(0.5 * (axis.dec_deg + lens.axis.dec_deg)))
    s, c = math.sin(turn), math.cos(turn)
    matrix = (lens.matrix @ np.array([[c, s], [-s, c]])) + step[2:6].reshape(2, 2)
    return replace(
        lens,
        axis=axis,
        matrix=matrix,
        axis_x_px=lens.axis_x_px + float(step[6]),
        axis_y_px=lens.axis_y_px + float(step[7]),
        terms=lens.terms + step[_LINEAR:],
    )


def _sizes(lens: Lens) -> Array:
    """Steps of the parameters that move stars by some hundredths of a pixel."""
    focal = math.sqrt(abs(float(np.linalg.det(lens.matrix))))
    return np.concatenate(
        (np.full(2, 0.02 / focal), np.full(4, 0.05), np.full(2, 0.02), np.full(lens.terms.size, 1e-4))
    )


def _slopes(lens: Lens, ra_deg: Array, dec_deg: Array) -> Array:
    """Derivatives of pixels by parameters, shape (parameters, 2, n)."""
    sizes = _sizes(lens)
    rows = np.empty((sizes.size, 2, ra_deg.size))
    for number, size in enumerate(sizes):
        step = np.zeros(sizes.size)
        step[number] = size
        more, less = (_moved(lens, sign * step).pixels(ra_deg, dec_deg) for sign in (1.0, -1.0))
        rows[number] = (np.asarray(more) - np.asarray(less)) / (2.0 * size)
    return rows


def _fitted(lens: Lens, first: Lens, stars: Stars, pairs: Pairs, m: Measurements) -> _Held | None:
    """Least squares with long tails cut, from `lens` on; `first` is what is expected of axis and terms."""
    if len(pairs) < FEWEST_PAIRS:
        return None
    ra, dec = stars.ra_deg[pairs.star], stars.dec_deg[pairs.star]
    seen = np.stack((m.x_px[pairs.measurement], m.y_px[pairs.measurement]))
    focal = math.sqrt(abs(float(np.linalg.det(lens.matrix))))
    known = _known_px(stars, pairs, m, focal)
    prior = _prior(lens)
    extra = 1.0
    trust = np.ones(len(pairs))
    off = seen - np.asarray(lens.pixels(ra, dec))
    for _ in range(_STEPS):
        sigma2 = known**2 + extra**2
        weight = trust / sigma2
        slopes = _slopes(lens, ra, dec)
        normal = np.einsum("pcn,n,qcn->pq", slopes, weight, slopes) + np.diag(prior)
        gone = np.zeros(prior.size)
        gone[6:8] = lens.axis_x_px - first.axis_x_px, lens.axis_y_px - first.axis_y_px
        gone[_LINEAR:] = lens.terms - first.terms
        right = np.einsum("pcn,n,cn->p", slopes, weight, off) - prior * gone
        # unknowns of very different sizes: scaled, so that the inverse keeps its digits
        scale = 1.0 / np.sqrt(np.diag(normal))
        inverse = (
            scale[:, None]
            * np.linalg.pinv(normal * scale[:, None] * scale, rcond=1e-13, hermitian=True)
            * scale
        )
        step = inverse @ right
        lens = _moved(lens, step)
        off = seen - np.asarray(lens.pixels(ra, dec))
        if not np.isfinite(off).all():
            return None
        square = (off**2).sum(axis=0)
        # median of two coordinates' squares is 2 ln 2 sigma²
        whole = median(square) / (2.0 * math.log(2.0))
        now = math.sqrt(max(whole - median(known) ** 2, _FLOOR_PX**2))
        settled = (
            abs(now - extra) < 0.02 * extra and np.abs(np.einsum("pcn,p->cn", slopes, step)).max() < 0.005
        )
        extra = now
        trust = np.minimum(1.0, TAIL_Z2 * (known**2 + extra**2) / np.maximum(square, 1e-300))
        if settled:
            break
    sigma = np.sqrt(known**2 + extra**2)
    return _Held(lens, inverse, off[0], off[1], sigma, extra)


def _corner_sigma_px(held: _Held) -> float:
    """Error of the lens at the worst corner; infinite where no sky is."""
    lens = held.lens
    x, y = (side.ravel() for side in np.meshgrid([0.0, lens.width_px - 1.0], [0.0, lens.height_px - 1.0]))
    ra, dec = places_at_pixels(lens.zpn_cards(), x, y)
    if not np.isfinite(ra).all():
        return math.inf
    slopes = _slopes(lens, ra, dec)
    return float(np.sqrt(np.einsum("pcn,pq,qcn->n", slopes, held.covariance, slopes).max()))


def _known_px(stars: Stars, pairs: Pairs, m: Measurements, focal_px: float) -> Array:
    """Errors of centroid and catalog per coordinate."""
    centroid = np.sqrt(0.5 * (m.x_sigma_px[pairs.measurement] ** 2 + m.y_sigma_px[pairs.measurement] ** 2))
    catalog = stars.sigma_arcsec[pairs.star] / ARCSEC_PER_RAD * focal_px
    return np.hypot(
        np.where(np.isfinite(centroid), centroid, 0.3), np.where(np.isfinite(catalog), catalog, 0.0)
    )


def _prior(lens: Lens) -> Array:
    """Weights of what is expected."""
    prior = np.zeros(_LINEAR + lens.terms.size)
    prior[6:8] = 1.0 / (AXIS_SHARE * math.hypot(lens.width_px, lens.height_px)) ** 2
    prior[_LINEAR:] = 1.0 / np.array(TERM_SIGMA[: lens.terms.size]) ** 2
    return prior
