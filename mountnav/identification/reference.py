"""Reference stars: from a triangle's plate to the final plate and its pairs, step by step [S23 §3].

The first plate comes from pairs of which many may be wrong: the similarity that the better half agrees on
best, by least trimmed squares [Rousseeuw 1984] with concentration steps [Rousseeuw & van Driessen 1999]. Then
the degree rises as long as pairs that had no part in the fit come out better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Stars
from mountnav.identification.camera_fit import CameraFit, fit_camera
from mountnav.identification.distortion import Belief
from mountnav.identification.fifth_order import fifth_order
from mountnav.identification.pairing import Candidates, Pairs, within_k_rej
from mountnav.identification.plate import SIMILARITY, Plate
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Measurements
from mountnav.measuring.medians import median
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import IdentifiedPairs

__all__ = ["Pairs", "Reference", "Selection", "identified_pairs"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

FEWEST_PAIRS = {SIMILARITY: 2, 1: 5, 2: 7, 3: 7}
"""Fewest pairs for each degree. Low, because terms that the pairs don't support stay near zero anyway."""
QUADRATIC = 2
"""Degree of the quadratic plate."""
OUTLYING = 5.0
"""Cross-validated distances count for no more than so many times their median: a pair that is wrong decides
no degree. Chosen by hand. Doubled or halved, the tests of search, refusal and plate pass all the same."""


def cross_validated(fit: CameraFit, sigma_arcsec: Array) -> float:
    """RMS of the pairs' distances from plates fit without them, in units of their errors, outliers capped.

    Parameters
    ----------
    sigma_arcsec : ndarray, shape (n,)
        The same for all fits that are to be compared.
    """
    apart = fit.influence.apart_arcsec / sigma_arcsec
    return float(np.sqrt(np.mean(np.minimum(apart, OUTLYING * median(apart)) ** 2)))


def gains(lower: CameraFit, higher: CameraFit, share: float) -> bool:
    """Whether the higher degree's cross-validated residual is below a share of the lower one's.

    Parameters
    ----------
    lower, higher : CameraFit
        Of the same pairs.
    """
    sigma = higher.sigma_arcsec
    return cross_validated(higher, sigma) <= share * cross_validated(lower, sigma)


def required_share(lower: CameraFit, gain: float) -> float:
    """How far the cross-validated residual must fall for a degree to rise.

    Parameters
    ----------
    gain : float
        The share that is required in general.

    Returns
    -------
    float
        `gain`; 1.02 for the step from quadratic to cubic. In a corner of the frame a radial distortion looks
        quadratic, and a quadratic is wild elsewhere: the cubic, which knows of radial distortions, need not
        be better there, only no worse.
    """
    return 1.02 if lower.plate.degree == QUADRATIC else gain


START_DRAWS = 150
"""Pairs of pairs, drawn at random, each of which gives a similarity; where there are fewer, all are tried.
With 45 % wrong pairs 30 % of the draws hold none, so that none of 150 does once in 10^23."""
START_MOST_PAIRS = 300
"""More pairs than this are thinned at random: they make the start no better, and cost time."""
START_ROUGH_PAIRS = 100
"""Draws are tried first with so many of the pairs, evenly spread: most are far off, and a few pairs show
which."""
START_LIKELY = 40
"""So many draws that do best with `START_ROUGH_PAIRS` of the pairs are tried with all. It saves time."""
START_STEPS = 8
"""Concentration steps (refits to the better half) at most; it ends earlier where a step gains less than
`START_GAIN`. Chosen by hand."""
START_GAIN = 1e-3
"""A step that gains less ends the refitting: it is a start, and a fit follows."""
START_TURN_MOST = 0.1
"""A draw that changes scale or rotation by more than this share is a slip: the triangle's plate is better."""
START_SEED = 20230511
"""Seed of the draws: the same pairs always give the same plate. Any number does."""


def trimmed_similarity(z: Complex, w: Complex) -> tuple[complex, complex]:
    """Fit w = turn·z + shift to the better half of points.

    Parameters
    ----------
    z, w : ndarray of complex, shape (n,)
        Places that the two should map on each other: nearly the same, but for the wrong pairs.

    Returns
    -------
    turn, shift : complex
        Independent of the order of the points; 1 and 0 when there are fewer than three.
    """
    count = z.size
    if count < 3:
        return 1.0 + 0.0j, 0.0j
    # by distance from the middle: the same draws however the points are listed, turned or mirrored
    order = np.argsort(np.abs(z - z.mean()), kind="stable")
    z, w = z[order], w[order]
    rng = np.random.default_rng(START_SEED)
    if count > START_MOST_PAIRS:
        some = np.sort(rng.choice(count, START_MOST_PAIRS, replace=False))
        z, w = z[some], w[some]
        count = START_MOST_PAIRS
    half = count // 2 + 1
    if count * (count - 1) // 2 <= START_DRAWS:
        first, second = np.array(list(combinations(range(count), 2))).T
    else:
        first = rng.integers(0, count, START_DRAWS)
        second = (first + rng.integers(1, count, START_DRAWS)) % count
    base = z[second] - z[first]
    good = np.abs(base) > 0
    first, second, base = first[good], second[good], base[good]
    turn = (w[second] - w[first]) / base
    shift = w[first] - turn * z[first]
    near = np.abs(turn - 1.0) <= START_TURN_MOST
    # the start itself, and each pair's mere shift, are candidates too
    turn = np.concatenate((turn[near], np.ones(count + 1, dtype=complex)))
    shift = np.concatenate((shift[near], w - z, [0.0j]))
    if count > START_ROUGH_PAIRS:
        # most draws are far off: a few evenly spread pairs show which aren't
        some = np.linspace(0, count - 1, START_ROUGH_PAIRS).astype(np.int64)
        likely = np.argsort(_cost(z[some], w[some], turn, shift, START_ROUGH_PAIRS // 2 + 1), kind="stable")[
            :START_LIKELY
        ]
        turn, shift = turn[likely], shift[likely]
    cost = _cost(z, w, turn, shift, half)
    best: tuple[float, complex, complex] | None = None
    for start in np.argsort(cost, kind="stable")[:5]:
        cost_now, turn_now, shift_now = _concentrated(z, w, complex(turn[start]), complex(shift[start]), half)
        if best is None or cost_now < best[0]:
            best = (cost_now, turn_now, shift_now)
    assert best is not None
    return best[1], best[2]


def _squares(z: Complex, w: Complex, turn: Complex | complex, shift: Complex | complex) -> Array:
    off = turn * z + (shift - w)
    return np.asarray(off.real**2 + off.imag**2)


def _cost(z: Complex, w: Complex, turn: Complex, shift: Complex, half: int) -> Array:
    """Sum of the least `half` squares under each draw, shape (len(turn),)."""
    squares = _squares(z, w, turn[:, None], shift[:, None])
    squares.partition(half - 1, axis=1)
    return np.asarray(squares[:, :half].sum(axis=1))


def _concentrated(
    z: Complex, w: Complex, turn: complex, shift: complex, half: int
) -> tuple[float, complex, complex]:
    """Refit to the best half until it stays the same."""
    cost = np.inf
    for _ in range(START_STEPS):
        squares = _squares(z, w, turn, shift)
        chosen = np.argpartition(squares, half - 1)[:half]
        now = float(squares[chosen].sum())
        if now >= cost * (1 - START_GAIN):
            break
        cost = now
        middle_z, middle_w = z[chosen].mean(), w[chosen].mean()
        dz, dw = z[chosen] - middle_z, w[chosen] - middle_w
        power = float(np.vdot(dz, dz).real)
        if power == 0.0:
            break
        turn = complex(np.vdot(dz, dw) / power)
        shift = complex(middle_w - turn * middle_z)
    return cost, turn, shift


ROUNDS = 6
"""Fits at one degree at most, each with the pairs that the last plate finds in a narrower strobe; it ends
earlier, when the pairs stay the same. Chosen by hand."""
REJECTIONS = 20
"""Rejections by K_rej within one fit at most. It ends earlier, when no pair goes; this bounds the work."""
CLEARLY = 0.8
"""A cross-validated residual below this share of the next lower degree's needs no further comparison. It
saves three fits where a distortion is plain."""
CENTERINGS = 5
"""Fits at most until the tangent point is the frame's center; it ends earlier, within `CENTERED_ARCSEC`."""
CENTERED_ARCSEC = 0.05
"""A tangent point so near to the center is moved there without a new fit: nothing changes by a hundredth."""

ROUGH_CUBIC_PAIRS = 40
"""So many pairs hold a cubic well enough to find stars by; with fewer a similarity is safer at the edges."""


@dataclass(frozen=True, slots=True)
class Reference:
    """A plate and the pairs that hold it.

    Attributes
    ----------
    plate : Plate
        Its tangent point is the frame's center.
    pairs : Pairs
        Those in the fit.
    dxi_arcsec, deta_arcsec, sigma_arcsec : ndarray, shape (n,)
        Residuals (measured minus catalog) and expected errors per coordinate of the pairs: centroid, catalog,
        and what neither knows of.
    rejected : int
        Pairs thrown out by K_rej.
    outliers : Pairs
        Which these are.
    rejected_by : dict
        How many candidates each rule threw out, by the names in `pairing.RULES`.
    leverage : ndarray, shape (n,)
        How much each pair holds the plate at its own position.
    center_covariance_arcsec2 : ndarray, shape (2, 2)
        Of the center's position: east, north.
    extra_px : float
        Error per coordinate beyond those of centroid and catalog, as the pairs show it.
    """

    plate: Plate
    pairs: Pairs
    dxi_arcsec: Array
    deta_arcsec: Array
    sigma_arcsec: Array
    rejected: int
    outliers: Pairs
    rejected_by: dict[str, int]
    leverage: Array
    center_covariance_arcsec2: Array
    extra_px: float


@dataclass(frozen=True, slots=True)
class _Held:
    """A fit, the pairs in it, all pairs it chose from, and the strobe they came from."""

    fit: CameraFit
    kept: Pairs
    pairs: Pairs
    strobe_px: float


def identified_pairs(reference: Reference, stars: Stars, measurements: Measurements) -> IdentifiedPairs:
    """Pairs in the fit and those that K_rej threw out, with all that is known of them.

    Parameters
    ----------
    stars : Stars
        The list that the pairs point into.
    """
    plate = reference.plate
    measurement = np.concatenate((reference.pairs.measurement, reference.outliers.measurement))
    star = np.concatenate((reference.pairs.star, reference.outliers.star))
    m = measurements
    x, y = m.x_px[measurement], m.y_px[measurement]
    xi, eta = plate.tangential(x, y)
    star_xi, star_eta = plate.project(stars.ra_deg[star], stars.dec_deg[star])
    centroid = np.sqrt(0.5 * (m.x_sigma_px[measurement] ** 2 + m.y_sigma_px[measurement] ** 2))
    return IdentifiedPairs(
        x_px=x,
        y_px=y,
        ra_deg=stars.ra_deg[star],
        dec_deg=stars.dec_deg[star],
        dx_arcsec=xi - star_xi,
        dy_arcsec=eta - star_eta,
        flux=m.flux[measurement],
        flux_sigma=m.flux_sigma[measurement],
        mag=stars.mag[star],
        centroid_sigma_arcsec=centroid * plate.scale_arcsec_px(),
        catalog_sigma_arcsec=stars.sigma_arcsec[star],
        flags=m.flags[measurement],
        used=np.arange(measurement.size) < len(reference.pairs),
        leverage=np.concatenate((reference.leverage, np.zeros(len(reference.outliers)))),
        color_mag=stars.color_mag[star],
        star_flags=stars.flags[star],
        band=stars.band,
        color_name=stars.color_name,
    )


class Selection:
    """Automatic selection of reference stars for one frame and one list of stars.

    Parameters
    ----------
    usable : ndarray of int
        Indices of star-like measurements, brightest first.
    stars : Stars
        Of the whole frame and a margin, brightest first.
    """

    def __init__(
        self, measurements: Measurements, usable: Index, stars: Stars, settings: IdentificationSettings
    ) -> None:
        self._settings = settings
        self._candidates = Candidates(measurements, usable, stars, settings)

    def _fit(
        self,
        like: Plate,
        pairs: Pairs,
        degree: int,
        *,
        near: Belief | None = None,
    ) -> CameraFit:
        xi, eta = self._candidates.projected(like)
        return fit_camera(
            like,
            *self._candidates.seen(pairs),
            xi[pairs.star],
            eta[pairs.star],
            self._candidates.known_arcsec(pairs, like.scale_arcsec_px()),
            degree,
            floor_px=self._settings.floor_px,
            near=near,
        )

    def _fewest(self, degree: int) -> int:
        return max(self._settings.min_pairs, FEWEST_PAIRS[degree])

    def _deviation_px(self, plate: Plate, pairs: Pairs) -> Array:
        return np.asarray(np.hypot(*self._candidates.residuals(plate, pairs)) / plate.scale_arcsec_px())

    def _rejecting(
        self, plate: Plate, pairs: Pairs, degree: int, near: Belief | None
    ) -> tuple[CameraFit, Pairs]:
        """Fit, reject by K_rej times the mean deviation modulus, until none goes [S23 eq. 21-23]."""
        fit, keep = self._fit(plate, pairs, degree, near=near), pairs
        for _ in range(REJECTIONS):
            good = within_k_rej(fit.off_arcsec, self._settings.k_rej)
            if good.all() or int(good.sum()) < self._fewest(degree):
                break
            fit, keep = fit.of(good), keep.those(good)
        return fit, keep

    def _robust_start(self, plate: Plate, pairs: Pairs) -> Plate:
        """The plate, moved and turned to where the better half of the pairs wants it."""
        xi, eta = self._candidates.projected(plate)
        seen_xi, seen_eta = plate.tangential(*self._candidates.seen(pairs))
        turn, shift = trimmed_similarity(seen_xi + 1j * seen_eta, xi[pairs.star] + 1j * eta[pairs.star])
        return plate.turned(turn, shift)

    def _narrower(self, plate: Plate, pairs: Pairs, strobe_px: float) -> float:
        """The strobe that the pairs' deviations need; never wider than before."""
        return float(np.clip(5.0 * median(self._deviation_px(plate, pairs)), 1.0, strobe_px))

    def _judged(self, plate: Plate, strobe_px: float) -> _Held | None:
        """The highest degree; or a lower one, if by the pairs of the highest it is as good."""
        for top in range(self._settings.degree_max, SIMILARITY, -1):
            held = self._identified(plate, self._candidates.pairs(plate, strobe_px), strobe_px, top)
            if held is None:
                continue
            best = self._best(held)
            if best is held.fit:
                return held
            plate = best.plate
            wide_px = self._wider(self._narrower(plate, held.kept, strobe_px))
            return self._identified(plate, self._candidates.pairs(plate, wide_px), wide_px, plate.degree)
        return self._identified(plate, self._candidates.pairs(plate, strobe_px), strobe_px, SIMILARITY)

    def _best(self, held: _Held) -> CameraFit:
        """The degree that the pairs of the highest one support: that fit itself, or one of a lower degree."""
        top, plate, kept = held.fit.plate.degree, held.fit.plate, held.kept
        below = self._fit(plate, kept, top - 1)
        # what is so much better than the next lower degree is better than those that this one contains
        if gains(below, held.fit, CLEARLY):
            return held.fit
        fits = [*(self._fit(plate, kept, degree) for degree in range(top - 1)), below, held.fit]
        best = fits[0]
        for fit in fits[1:]:
            # a degree that gains nothing is passed over and the next one tried: radial distortion is cubic,
            # and invisible to the quadratic step
            if gains(best, fit, required_share(best, self._settings.cross_validation_gain)):
                best = fit
        return best

    @staticmethod
    def _wider(strobe_px: float) -> float:
        """The strobe of a degree that follows: twice as wide, since the plate changes."""
        return max(2.0 * strobe_px, 2.0)

    def _identified(
        self,
        plate: Plate,
        pairs: Pairs,
        strobe_px: float,
        degree: int,
    ) -> _Held | None:
        """Fit and pairs in turns at one degree, the strobe narrowing to what the residuals need."""
        held = None
        for turn in range(ROUNDS):
            if len(pairs) < self._fewest(degree):
                return None
            near = None if held is None else held.fit.belief
            fit, kept = self._rejecting(plate, pairs, degree, near)
            held = _Held(fit, kept, pairs, strobe_px)
            if turn == ROUNDS - 1:
                break
            plate = fit.plate
            strobe_px = self._narrower(plate, kept, strobe_px)
            again = self._candidates.pairs(plate, strobe_px)
            if len(again) == len(pairs) and bool(np.array_equal(again.star, pairs.star)):
                break
            pairs = again
        return held

    def _centered(self, held: _Held) -> CameraFit:
        """Put the tangent point on the frame's center: the constant terms vanish. Fit once more."""
        fit = held.fit
        for _ in range(CENTERINGS):
            before = fit.plate.center()
            plate = fit.plate.moved_to(before)
            fit = self._fit(plate, held.kept, plate.degree, near=fit.belief)
            if separation_arcsec(fit.plate.center(), before) < CENTERED_ARCSEC:
                break
        return replace(fit, plate=fit.plate.moved_to(fit.plate.center()))

    def grow(self, plate: Plate, strobe_px: float, *, rough: bool = False) -> Reference | None:
        """From a triangle's plate to the final one [S23 §3].

        Parameters
        ----------
        plate : Plate
            A hypothesis.
        strobe_px : float
            How far off it may be.
        rough : bool
            The plate only serves to measure at the stars' positions: the number of pairs decides the degree,
            not what the pairs gain by it, and rejections aren't counted by rule.

        Returns
        -------
        Reference or None
            None when the pairs don't hold a plate.
        """
        plate = plate.moved_to(plate.center())
        pairs = self._candidates.pairs(plate, strobe_px)
        if len(pairs) < self._fewest(SIMILARITY):
            return None
        plate = self._robust_start(plate, pairs)
        strobe_px = self._narrower(plate, pairs, strobe_px)
        if len(self._candidates.pairs(plate, strobe_px)) < self._fewest(SIMILARITY):
            return None
        wide_px = self._wider(strobe_px)
        if not rough:
            return self._grown(plate, wide_px)
        again = self._candidates.pairs(plate, wide_px)
        degree = self._settings.degree_max if len(again) >= ROUGH_CUBIC_PAIRS else SIMILARITY
        held = self._identified(plate, again, wide_px, degree)
        return None if held is None else self._reference(held, held.fit, rough=True)

    def refine(self, plate: Plate, strobe_px: float) -> Reference | None:
        """From a plate that is good already, of whatever degree, to the final one.

        What `grow` gives, without its robust start: for a second list of measurements, more precise than the
        one that the plate was grown from.

        Parameters
        ----------
        strobe_px : float
            How far off it may be, anywhere in the frame.

        Returns
        -------
        Reference or None
            None when the pairs don't hold a plate.
        """
        return self._grown(plate.moved_to(plate.center()), strobe_px)

    def _grown(self, plate: Plate, strobe_px: float) -> Reference | None:
        held = self._judged(plate, strobe_px)
        return None if held is None else self._reference(held, self._centered(held))

    def _reference(self, held: _Held, fit: CameraFit, *, rough: bool = False) -> Reference:
        plate, influence = fit.plate, fit.influence
        leverage, covariance = influence.leverage, influence.center_covariance_arcsec2
        dxi, deta = self._candidates.residuals(plate, held.kept)
        more = None
        if not rough:
            x_px, y_px = self._candidates.seen(held.kept)
            more = fifth_order(plate, x_px, y_px, dxi, deta, fit.sigma_arcsec)
        if more is not None:
            plate = more.plate
            leverage, covariance = leverage + more.leverage, covariance + more.center_covariance_arcsec2
            dxi, deta = self._candidates.residuals(plate, held.kept)
        outliers = held.pairs.those(~np.isin(held.pairs.star, held.kept.star))
        return Reference(
            plate=plate,
            pairs=held.kept,
            dxi_arcsec=dxi,
            deta_arcsec=deta,
            sigma_arcsec=fit.sigma_arcsec,
            rejected=len(outliers),
            outliers=outliers,
            rejected_by={} if rough else self._candidates.rejected_by(plate, held.strobe_px, len(outliers)),
            leverage=leverage,
            center_covariance_arcsec2=covariance,
            extra_px=fit.belief.extra_px,
        )

    def allowed(self, plate: Plate) -> int:
        """How many pairs there could be at most: stars in the frame, or measurements."""
        return int(min(len(self._candidates.in_frame(plate)), self._candidates.count))
