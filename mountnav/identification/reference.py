"""Reference stars: which pairs deserve to hold the plate, and how far its degree may rise [S23 §3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.plate import SIMILARITY, Plate, fit_plate
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.solution import IdentifiedPairs

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PAIRS_FOR_DEGREE = {SIMILARITY: 2, 1: 7, 2: 18, 3: 30}
"""Fewest pairs for each degree: about three per free parameter and coordinate."""
FOLDS = 5


@dataclass(frozen=True, slots=True)
class Pairs:
    """Identified pairs.

    Attributes
    ----------
    measurement, star : ndarray of int, shape (n,)
        Indices in the measurements and in the stars.
    """

    measurement: Index
    star: Index

    def __len__(self) -> int:
        return int(self.star.size)


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
        Residuals (measured minus catalog) and expected errors of the pairs.
    rejected : int
        Pairs thrown out by K_rej.
    outliers : Pairs
        Which these are.
    rejected_by : dict
        How many candidates each rule threw out.
    """

    plate: Plate
    pairs: Pairs
    dxi_arcsec: Array
    deta_arcsec: Array
    sigma_arcsec: Array
    rejected: int
    outliers: Pairs
    rejected_by: dict[str, int]


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

    def _in_frame(self, plate: Plate) -> tuple[Index, Array, Array]:
        """Stars predicted in the frame: indices and pixels, brightest first."""
        xi, eta = plate.project(self._stars.ra_deg, self._stars.dec_deg)
        reach = 2.0 * plate.unit_px * plate.scale_arcsec_px()
        seen = np.flatnonzero(np.isfinite(xi) & (np.hypot(xi - plate.xi[0], eta - plate.eta[0]) < reach))
        x, y = plate.pixels(xi[seen], eta[seen])
        inside = (x > -0.5) & (x < self._width - 0.5) & (y > -0.5) & (y < self._height - 0.5)
        return seen[inside], x[inside], y[inside]

    def _bright(self, stars_in_frame: int) -> Index:
        """As many of the brightest measurements as could belong to the catalog's stars."""
        return self._usable[: max(60, 2 * stars_in_frame)]

    def _pairs(self, plate: Plate, strobe_px: float, *, clean: bool) -> Pairs:
        """Mutually nearest star and measurement within the strobe; one pair each."""
        star, x, y = self._in_frame(plate)
        chosen = self._bright(star.size)
        if star.size == 0 or chosen.size == 0:
            return Pairs(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
        mx, my = self._measurements.x_px[chosen], self._measurements.y_px[chosen]
        places, sources = np.column_stack((x, y)), np.column_stack((mx, my))
        distance, nearest = (
            np.asarray(one) for one in cKDTree(sources).query(places, distance_upper_bound=strobe_px)
        )
        found = np.flatnonzero(np.isfinite(distance))
        back = np.asarray(cKDTree(places).query(sources[nearest[found]])[1])
        found = found[back == found]
        measurement, kept = chosen[nearest[found]], star[found]
        if clean:
            good = ~self._star_group(plate, star, x, y)[found] & ~self._unfit(measurement)
            measurement, kept = measurement[good], kept[good]
        return Pairs(measurement, kept)

    def _star_group(self, plate: Plate, star: Index, x: Array, y: Array) -> NDArray[np.bool_]:
        """Stars closer than r_star_group to a neighbor of comparable brightness [S23 §3.2]."""
        radius = self._settings.star_group_fwhm * self._fwhm_px
        return _grouped(x, y, self._stars.mag[star], radius, self._settings.group_magnitudes)

    def _unfit(self, measurement: Index) -> NDArray[np.bool_]:
        """Measurements on the frame's edge, or in a tight group (r_mea_group)."""
        m = self._measurements
        bright = self._usable[: max(500, 4 * measurement.size)]
        magnitude = -2.5 * np.log10(np.maximum(m.flux[bright], 1e-9))
        radius = self._settings.measurement_group_fwhm * self._fwhm_px
        grouped = _grouped(m.x_px[bright], m.y_px[bright], magnitude, radius, self._settings.group_magnitudes)
        bad = np.zeros(len(m), dtype=bool)
        bad[bright[grouped]] = True
        bad |= (m.flags & int(Flag.EDGE)) != 0
        return np.asarray(bad[measurement])

    def _sigma(self, pairs: Pairs, scale: float) -> Array:
        """Expected error of a pair per coordinate, arcsec: centroid, catalog at the epoch, and a floor."""
        m = self._measurements
        centroid = np.sqrt(
            0.5 * (m.x_sigma_px[pairs.measurement] ** 2 + m.y_sigma_px[pairs.measurement] ** 2)
        )
        centroid = np.where(np.isfinite(centroid), centroid, 0.5)
        catalog = self._stars.sigma_arcsec[pairs.star]
        catalog = np.where(np.isfinite(catalog), catalog, 1.0)
        floor = self._settings.floor_px * scale
        sigma: Array = np.sqrt((centroid * scale) ** 2 + catalog**2 + floor**2)
        # no star, however well measured, holds a plate alone
        return np.maximum(sigma, 0.3 * float(np.median(sigma))) if sigma.size else sigma

    def _fit(self, plate: Plate, pairs: Pairs, degree: int) -> Plate:
        m = self._measurements
        xi, eta = plate.project(self._stars.ra_deg[pairs.star], self._stars.dec_deg[pairs.star])
        x, y = m.x_px[pairs.measurement], m.y_px[pairs.measurement]
        return fit_plate(plate, x, y, xi, eta, self._sigma(pairs, plate.scale_arcsec_px()), degree)

    def residuals(self, plate: Plate, pairs: Pairs) -> tuple[Array, Array]:
        """Measured minus catalog (ξ, η, arcsec), shape (n,) each."""
        m = self._measurements
        xi, eta = plate.tangential(m.x_px[pairs.measurement], m.y_px[pairs.measurement])
        star_xi, star_eta = plate.project(self._stars.ra_deg[pairs.star], self._stars.dec_deg[pairs.star])
        return xi - star_xi, eta - star_eta

    def _rejecting(self, plate: Plate, pairs: Pairs, degree: int) -> tuple[Plate, Pairs]:
        """Fit, reject by K_rej times the mean deviation modulus, until none goes [S23 eq. 21-23]."""
        keep = pairs
        for _ in range(20):
            plate = self._fit(plate, keep, degree)
            deviation = np.hypot(*self.residuals(plate, keep))
            good = deviation <= self._settings.k_rej * float(deviation.mean())
            if good.all() or int(good.sum()) < max(self._settings.min_pairs, PAIRS_FOR_DEGREE[degree]):
                break
            keep = Pairs(keep.measurement[good], keep.star[good])
        return plate, keep

    def _identify(
        self, plate: Plate, strobe_px: float, degree: int
    ) -> tuple[Plate, Pairs, int, float] | None:
        """Pairs and fit in turns at one degree, the strobe narrowing to what the residuals need."""
        pairs = self._pairs(plate, strobe_px, clean=True)
        rejected = 0
        for _ in range(6):
            if len(pairs) < max(self._settings.min_pairs, PAIRS_FOR_DEGREE[degree]):
                return None
            plate, kept = self._rejecting(plate, pairs, degree)
            plate = self._centered(plate, kept)
            rejected = len(pairs) - len(kept)
            scale = plate.scale_arcsec_px()
            deviation = np.hypot(*self.residuals(plate, kept)) / scale
            narrower = float(np.clip(5.0 * np.median(deviation), 1.0, strobe_px))
            again = self._pairs(plate, narrower, clean=True)
            same = len(again) == len(pairs) and bool(np.array_equal(again.star, pairs.star))
            strobe_px = narrower
            if same:
                return plate, kept, rejected, strobe_px
            pairs = again
        if len(pairs) < max(self._settings.min_pairs, PAIRS_FOR_DEGREE[degree]):
            return None
        plate, kept = self._rejecting(plate, pairs, degree)
        return self._centered(plate, kept), kept, len(pairs) - len(kept), strobe_px

    def _centered(self, plate: Plate, pairs: Pairs) -> Plate:
        """Put the tangent point on the frame's center, so that the constant terms vanish."""
        for _ in range(4):
            plate = self._fit(plate.moved_to(plate.center()), pairs, plate.degree)
            if max(abs(float(plate.xi[0])), abs(float(plate.eta[0]))) < 1e-7:
                break
        return plate

    def _cross_validated(self, plate: Plate, pairs: Pairs, degree: int) -> float:
        """RMS deviation (arcsec, outliers capped) of pairs from a plate that was fit without them."""
        fold = np.arange(len(pairs)) % FOLDS
        deviation = np.empty(len(pairs))
        for number in range(FOLDS):
            out = fold == number
            fit = self._fit(plate, Pairs(pairs.measurement[~out], pairs.star[~out]), degree)
            deviation[out] = np.hypot(*self.residuals(fit, Pairs(pairs.measurement[out], pairs.star[out])))
        return float(np.sqrt(np.mean(np.minimum(deviation, 5 * np.median(deviation)) ** 2)))

    def _spread(self, pairs: Pairs) -> float:
        """Share of the frame's 3 × 3 parts that hold a pair."""
        m = self._measurements
        column = np.clip((m.x_px[pairs.measurement] / self._width * 3).astype(int), 0, 2)
        row = np.clip((m.y_px[pairs.measurement] / self._height * 3).astype(int), 0, 2)
        return float(np.unique(3 * row + column).size / 9)

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
        got = self._identify(plate, strobe_px, SIMILARITY)
        if got is None:
            return None
        for degree in range(1, self._settings.degree_max + 1):
            start, pairs, _, strobe = got
            wide = self._pairs(start, max(2.0 * strobe, 2.0), clean=True)
            pool = wide if len(wide) > len(pairs) else pairs
            if len(pool) < PAIRS_FOR_DEGREE[degree] or self._spread(pool) < (0.6 if degree > 1 else 0.3):
                break
            higher = self._identify(start, max(2.0 * strobe, 2.0), degree)
            if higher is None:
                continue
            # judged on the same pairs, those of the higher degree; a degree that gains nothing is passed
            # over and the next one tried: radial distortion is cubic, and invisible to the quadratic step
            before = self._cross_validated(higher[0], higher[1], start.degree)
            after = self._cross_validated(higher[0], higher[1], degree)
            if after <= self._settings.cross_validation_gain * before:
                got = higher
        final, kept, rejected, _ = got
        dxi, deta = self.residuals(final, kept)
        return Reference(
            plate=final,
            pairs=kept,
            dxi_arcsec=dxi,
            deta_arcsec=deta,
            sigma_arcsec=self._sigma(kept, final.scale_arcsec_px()),
            rejected=rejected,
            outliers=Pairs(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)),
            rejected_by={},
        )

    def allowed(self, plate: Plate) -> int:
        """How many pairs there could be at most: stars in the frame, or measurements."""
        star, _, _ = self._in_frame(plate)
        return int(min(star.size, self._usable.size))


def _grouped(x: Array, y: Array, magnitude: Array, radius: float, depth: float) -> NDArray[np.bool_]:
    """Points with a neighbor within the radius that is not fainter by `depth` magnitudes."""
    grouped = np.zeros(x.size, dtype=bool)
    if x.size < 2:
        return grouped
    close = cKDTree(np.column_stack((x, y))).query_pairs(radius, output_type="ndarray")
    if close.size:
        a, b = close[:, 0], close[:, 1]
        grouped[a[magnitude[b] < magnitude[a] + depth]] = True
        grouped[b[magnitude[a] < magnitude[b] + depth]] = True
    return grouped
