"""Reference stars: from a triangle's plate to the pairs that hold the final one, step by step [S23 §3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Stars
from mountnav.identification.camera import CameraFit, fit_camera
from mountnav.identification.degree import FEWEST_PAIRS, gains, required_share
from mountnav.identification.evidence import Belief
from mountnav.identification.pairing import (
    NO_PAIRS,
    Pairs,
    Predicted,
    nearest_pairs,
    predicted,
    spread_over_fragments,
)
from mountnav.identification.plate import SIMILARITY, Plate
from mountnav.identification.rejection import (
    BY_FLAG,
    DEVIATION,
    MEASUREMENT_GROUP,
    RULES,
    STAR_GROUP,
    grouped,
    within_k_rej,
)
from mountnav.identification.robust_start import trimmed_similarity
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.solution import IdentifiedPairs

__all__ = ["Pairs", "Reference", "Selection", "identified_pairs"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDS = 6
UNKNOWN_CENTROID_PX = 0.5
UNKNOWN_CATALOG_ARCSEC = 1.0
SHARP_SHARE = 0.3
"""When more of the candidates than this have no peak, the stars are that sharp, and the flag says nothing."""
SATURATED_FWHM = 0.02
"""What the wings of a saturated star don't tell of its place, in widths, beyond the fit's own error."""


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
        How many candidates each rule threw out, by the names in `rejection.RULES`.
    leverage : ndarray, shape (n,)
        How much each pair holds the plate at its own place.
    center_covariance_arcsec2 : ndarray, shape (2, 2)
        Of the center's place: east, north.
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
    reference : Reference
    stars : Stars
        The list that the pairs point into.
    measurements : Measurements

    Returns
    -------
    IdentifiedPairs
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
    )


class Selection:
    """Automatic selection of reference stars for one frame and one list of stars.

    Parameters
    ----------
    measurements : Measurements
    usable : ndarray of int
        Indices of star-like measurements, brightest first.
    stars : Stars
        Of the whole frame and a margin, brightest first.
    settings : IdentificationSettings
    """

    def __init__(
        self, measurements: Measurements, usable: Index, stars: Stars, settings: IdentificationSettings
    ) -> None:
        self._settings = settings
        self._stars = stars
        self._measurements = measurements
        self._width, self._height = measurements.width_px, measurements.height_px
        self._usable = usable
        fwhm = measurements.fwhm_px[usable]
        fwhm = fwhm[np.isfinite(fwhm) & (fwhm > 0)]
        self._fwhm_px = float(np.clip(np.median(fwhm), 1.0, 15.0)) if fwhm.size else 3.0

    def _in_frame(self, plate: Plate) -> Predicted:
        return predicted(plate, self._stars, width_px=self._width, height_px=self._height)

    def _candidates(self, places: Predicted, strobe_px: float) -> tuple[Pairs, Index]:
        """Mutually nearest star and measurement within the strobe; and which place each star has."""
        m = self._measurements
        # no more of the brightest measurements than could belong to the catalog's stars
        chosen = self._usable[: max(60, 2 * len(places))]
        return nearest_pairs(places, chosen, m.x_px, m.y_px, strobe_px)

    def _ruled_out(self, places: Predicted, candidates: Pairs, place: Index) -> dict[str, NDArray[np.bool_]]:
        """Candidates that a rule other than K_rej forbids; a candidate may fall under several."""
        flags = self._measurements.flags[candidates.measurement]
        out = {name: (flags & int(flag)) != 0 for name, flag in BY_FLAG.items()}
        if np.mean(out["no peak"]) > SHARP_SHARE:
            out["no peak"] = np.zeros(len(candidates), dtype=bool)
        magnitude = self._stars.mag[places.star]
        radius = self._settings.star_group_fwhm * self._fwhm_px
        depth = self._settings.group_magnitudes
        out[STAR_GROUP] = grouped(places.x_px, places.y_px, magnitude, radius, depth)[place]
        out[MEASUREMENT_GROUP] = self._in_measurement_group(candidates.measurement)
        return out

    def _in_measurement_group(self, measurement: Index) -> NDArray[np.bool_]:
        m = self._measurements
        bright = self._usable[: max(500, 4 * measurement.size)]
        magnitude = -2.5 * np.log10(np.maximum(m.flux[bright], 1e-9))
        radius = self._settings.measurement_group_fwhm * self._fwhm_px
        bad = np.zeros(len(m), dtype=bool)
        bad[
            bright[
                grouped(m.x_px[bright], m.y_px[bright], magnitude, radius, self._settings.group_magnitudes)
            ]
        ] = True
        return np.asarray(bad[measurement])

    def _pairs(self, plate: Plate, strobe_px: float) -> Pairs:
        """Pairs that no rule forbids, spread over the fragments."""
        places = self._in_frame(plate)
        candidates, place = self._candidates(places, strobe_px)
        if len(candidates) == 0:
            return NO_PAIRS
        bad = np.logical_or.reduce(list(self._ruled_out(places, candidates, place).values()))
        return self._spread(candidates.those(~bad))

    def _spread(self, pairs: Pairs) -> Pairs:
        m = self._measurements
        taken = spread_over_fragments(
            m.x_px[pairs.measurement],
            m.y_px[pairs.measurement],
            self._stars.mag[pairs.star],
            width_px=self._width,
            height_px=self._height,
            fragments=self._settings.fragments,
            cap=self._settings.fragment_cap,
        )
        return pairs.those(taken)

    def _known_sigma(self, pairs: Pairs, scale_arcsec_px: float) -> Array:
        """Error per coordinate as far as it is known, arcsec: centroid, and catalog at the epoch."""
        m = self._measurements
        centroid = np.sqrt(
            0.5 * (m.x_sigma_px[pairs.measurement] ** 2 + m.y_sigma_px[pairs.measurement] ** 2)
        )
        centroid = np.where(np.isfinite(centroid), centroid, UNKNOWN_CENTROID_PX)
        saturated = (m.flags[pairs.measurement] & int(Flag.SATURATED)) != 0
        centroid = np.hypot(centroid, np.where(saturated, SATURATED_FWHM * self._fwhm_px, 0.0))
        catalog = self._stars.sigma_arcsec[pairs.star]
        catalog = np.where(np.isfinite(catalog), catalog, UNKNOWN_CATALOG_ARCSEC)
        sigma: Array = np.hypot(centroid * scale_arcsec_px, catalog)
        return sigma

    def _fit(self, like: Plate, pairs: Pairs, degree: int, belief: Belief | None = None) -> CameraFit:
        m = self._measurements
        xi, eta = like.project(self._stars.ra_deg[pairs.star], self._stars.dec_deg[pairs.star])
        x, y = m.x_px[pairs.measurement], m.y_px[pairs.measurement]
        known = self._known_sigma(pairs, like.scale_arcsec_px())
        floor_px = self._settings.floor_px
        return fit_camera(like, x, y, xi, eta, known, degree, floor_px=floor_px, belief=belief)

    def residuals(self, plate: Plate, pairs: Pairs) -> tuple[Array, Array]:
        """Measured minus catalog (ξ, η, arcsec), shape (n,) each."""
        m = self._measurements
        xi, eta = plate.tangential(m.x_px[pairs.measurement], m.y_px[pairs.measurement])
        star_xi, star_eta = plate.project(self._stars.ra_deg[pairs.star], self._stars.dec_deg[pairs.star])
        return xi - star_xi, eta - star_eta

    def _fewest(self, degree: int) -> int:
        return max(self._settings.min_pairs, FEWEST_PAIRS[degree])

    def _rejecting(self, plate: Plate, pairs: Pairs, degree: int) -> tuple[CameraFit, Pairs]:
        """Fit, reject by K_rej times the mean deviation modulus, until none goes [S23 eq. 21-23]."""
        fit, keep = self._fit(plate, pairs, degree), pairs
        for _ in range(20):
            deviation = np.hypot(*self.residuals(fit.plate, keep))
            good = within_k_rej(deviation, self._settings.k_rej)
            if good.all() or int(good.sum()) < self._fewest(degree):
                break
            keep = keep.those(good)
            fit = self._fit(fit.plate, keep, degree, fit.belief)
        return fit, keep

    def _robust_start(self, plate: Plate, pairs: Pairs) -> Plate:
        """The plate, moved and turned to where the better half of the pairs wants it."""
        m = self._measurements
        xi, eta = plate.project(self._stars.ra_deg[pairs.star], self._stars.dec_deg[pairs.star])
        seen_xi, seen_eta = plate.tangential(m.x_px[pairs.measurement], m.y_px[pairs.measurement])
        turn, shift = trimmed_similarity(seen_xi + 1j * seen_eta, xi + 1j * eta)
        return plate.turned(turn, shift)

    def _identify(self, plate: Plate, strobe_px: float, degree: int) -> _Held | None:
        """Pairs and fit in turns at one degree, the strobe narrowing to what the residuals need."""
        pairs = self._pairs(plate, strobe_px)
        if degree == SIMILARITY and len(pairs) >= self._fewest(degree):
            plate = self._robust_start(plate, pairs)
            deviation = np.hypot(*self.residuals(plate, pairs)) / plate.scale_arcsec_px()
            strobe_px = float(np.clip(5.0 * np.median(deviation), 1.0, strobe_px))
            pairs = self._pairs(plate, strobe_px)
        held = None
        for _ in range(ROUNDS):
            if len(pairs) < self._fewest(degree):
                return None
            fit, kept = self._rejecting(plate, pairs, degree)
            held = _Held(fit, kept, pairs, strobe_px)
            plate = fit.plate
            deviation = np.hypot(*self.residuals(plate, kept)) / plate.scale_arcsec_px()
            strobe_px = float(np.clip(5.0 * np.median(deviation), 1.0, strobe_px))
            again = self._pairs(plate, strobe_px)
            if len(again) == len(pairs) and bool(np.array_equal(again.star, pairs.star)):
                break
            pairs = again
        return held

    def _centered(self, held: _Held) -> CameraFit:
        """Put the tangent point on the frame's center: the constant terms vanish. Fit once more."""
        fit, degree = held.fit, held.fit.plate.degree
        for turn in range(5):
            plate = fit.plate
            if turn and max(abs(float(plate.xi[0])), abs(float(plate.eta[0]))) < 1e-7:
                break
            fit = self._fit(
                plate.moved_to(plate.center()), held.kept, degree, None if turn == 0 else fit.belief
            )
        return fit

    def grow(self, plate: Plate, strobe_px: float) -> Reference | None:
        """From a triangle's plate to the final one [S23 §3].

        Parameters
        ----------
        plate : Plate
            A hypothesis.
        strobe_px : float
            How far off it may be.

        Returns
        -------
        Reference or None
            None when the pairs don't hold a plate.
        """
        held = self._identify(plate.moved_to(plate.center()), strobe_px, SIMILARITY)
        if held is None:
            return None
        for degree in range(1, self._settings.degree_max + 1):
            if len(held.pairs) < self._fewest(degree):
                break
            wide_px = max(2.0 * held.strobe_px, 2.0)
            higher = self._identify(held.fit.plate, wide_px, degree)
            if higher is None:
                continue
            # judged on the same pairs, those of the higher degree; a degree that gains nothing is passed
            # over and the next one tried: radial distortion is cubic, and invisible to the quadratic step
            lower = self._fit(higher.fit.plate, higher.kept, held.fit.plate.degree)
            if gains(lower, higher.fit, required_share(lower, self._settings.cross_validation_gain)):
                held = higher
        return self._reference(held, self._centered(held))

    def _reference(self, held: _Held, fit: CameraFit) -> Reference:
        dxi, deta = self.residuals(fit.plate, held.kept)
        outliers = held.pairs.those(~np.isin(held.pairs.star, held.kept.star))
        return Reference(
            plate=fit.plate,
            pairs=held.kept,
            dxi_arcsec=dxi,
            deta_arcsec=deta,
            sigma_arcsec=fit.sigma_arcsec,
            rejected=len(outliers),
            outliers=outliers,
            rejected_by=self._rejected_by(fit.plate, held.strobe_px, len(outliers)),
            leverage=fit.leverage,
            center_covariance_arcsec2=fit.center_covariance_arcsec2,
            extra_px=fit.belief.extra_px,
        )

    def _rejected_by(self, plate: Plate, strobe_px: float, outliers: int) -> dict[str, int]:
        """Count for each rule the candidates at the final plate and strobe that it is the first to forbid."""
        m = self._measurements
        counts = dict.fromkeys(RULES, 0)
        places = self._in_frame(plate)
        candidates, place = self._candidates(places, strobe_px)
        # sources that are no stars never were candidates of the fit: ask them about the stars left over
        finite = np.flatnonzero(np.isfinite(m.x_px) & np.isfinite(m.y_px))
        never = finite[~np.isin(finite, self._usable)]
        free = np.ones(len(places), dtype=bool)
        free[place] = False
        left = Predicted(places.star[free], places.x_px[free], places.y_px[free])
        for measurement in nearest_pairs(left, never, m.x_px, m.y_px, strobe_px)[0].measurement:
            rule = next((name for name, flag in BY_FLAG.items() if m.flags[measurement] & int(flag)), None)
            if rule is not None:
                counts[rule] += 1
        if len(candidates):
            blamed = np.zeros(len(candidates), dtype=bool)
            for rule, bad in self._ruled_out(places, candidates, place).items():
                counts[rule] += int((bad & ~blamed).sum())
                blamed |= bad
        counts[DEVIATION] = outliers
        return counts

    def allowed(self, plate: Plate) -> int:
        """How many pairs there could be at most: stars in the frame, or measurements."""
        return int(min(len(self._in_frame(plate)), self._usable.size))
