"""Candidates: which measurement may be which star under a plate, and what forbids some [S23 §3.1-3.2]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.neighborhood import Neighborhood
from mountnav.identification.pairing import (
    NO_PAIRS,
    Pairs,
    Predicted,
    nearest_pairs,
    predicted,
    spread_over_fragments,
)
from mountnav.identification.plate import Plate
from mountnav.identification.rejection import (
    BY_FLAG,
    DEVIATION,
    MEASUREMENT_GROUP,
    RULES,
    STAR_GROUP,
    in_groups,
)
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

UNKNOWN_CENTROID_PX = 0.5
UNKNOWN_CATALOG_ARCSEC = 1.0
SHARP_SHARE = 0.3
"""When more of the candidates than this have no peak, the stars are that sharp, and the flag says nothing."""
SATURATED_FWHM = 0.02
"""What the wings of a saturated star don't tell of its place, in widths, beyond the fit's own error."""
FEWEST_MEASUREMENTS = 60
SPARE_PX = 3.0
"""How much farther than the strobe neighbors are remembered: most plates of one growth differ by less."""
FEWEST_IN_GROUPS = 500


class Candidates:
    """The measurements and stars of one frame, with what is known of them whatever the plate.

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
        m = measurements
        self._settings, self._stars, self._measurements, self._usable = settings, stars, m, usable
        self._x_px, self._y_px = m.x_px[usable], m.y_px[usable]
        fwhm = m.fwhm_px[usable]
        fwhm = fwhm[np.isfinite(fwhm) & (fwhm > 0)]
        self._fwhm_px = float(np.clip(np.median(fwhm), 1.0, 15.0)) if fwhm.size else 3.0
        centroid = np.sqrt(0.5 * (m.x_sigma_px**2 + m.y_sigma_px**2))
        centroid = np.where(np.isfinite(centroid), centroid, UNKNOWN_CENTROID_PX)
        saturated = (m.flags & int(Flag.SATURATED)) != 0
        self._centroid_px = np.hypot(centroid, np.where(saturated, SATURATED_FWHM * self._fwhm_px, 0.0))
        catalog = stars.sigma_arcsec
        self._catalog_arcsec = np.where(np.isfinite(catalog), catalog, UNKNOWN_CATALOG_ARCSEC)
        self._projected: dict[Icrs, tuple[Array, Array]] = {}
        self._last: tuple[Plate, Predicted] | None = None
        self._neighborhood: Neighborhood | None = None
        self._close: Index | None = None
        self._grouped: tuple[int, Mask] | None = None

    @property
    def count(self) -> int:
        """How many measurements may take part."""
        return int(self._usable.size)

    def projected(self, plate: Plate) -> tuple[Array, Array]:
        """Tangential coordinates of all stars, arcsec: reckoned once for each tangent point."""
        if plate.tangent not in self._projected:
            self._projected[plate.tangent] = plate.project(self._stars.ra_deg, self._stars.dec_deg)
        return self._projected[plate.tangent]

    def in_frame(self, plate: Plate) -> Predicted:
        """Stars that the plate puts in the frame."""
        if self._last is None or self._last[0] is not plate:
            self._last = plate, self._predicted(plate, 0.0)
        return self._last[1]

    def seen(self, pairs: Pairs) -> tuple[Array, Array]:
        """Pixels of the pairs' measurements, shape (n,) each."""
        return self._measurements.x_px[pairs.measurement], self._measurements.y_px[pairs.measurement]

    def known_arcsec(self, pairs: Pairs, scale_arcsec_px: float) -> Array:
        """Error per coordinate as far as it is known: centroid, and catalog at the epoch; shape (n,)."""
        centroid = self._centroid_px[pairs.measurement] * scale_arcsec_px
        return np.asarray(np.hypot(centroid, self._catalog_arcsec[pairs.star]))

    def residuals(self, plate: Plate, pairs: Pairs) -> tuple[Array, Array]:
        """Measured minus catalog (ξ, η, arcsec), shape (n,) each."""
        xi, eta = plate.tangential(*self.seen(pairs))
        star_xi, star_eta = self.projected(plate)
        return xi - star_xi[pairs.star], eta - star_eta[pairs.star]

    def pairs(self, plate: Plate, strobe_px: float) -> Pairs:
        """Pairs that no rule forbids, spread over the fragments."""
        places = self.in_frame(plate)
        near, place = self._near(plate, places, strobe_px)
        if len(near) == 0:
            return NO_PAIRS
        bad = np.logical_or.reduce(list(self._ruled_out(places, near, place).values()))
        return self._spread(near.those(~bad))

    def rejected_by(self, plate: Plate, strobe_px: float, outliers: int) -> dict[str, int]:
        """Count for each rule the candidates at the final plate and strobe that it is the first to forbid."""
        m = self._measurements
        counts = dict.fromkeys(RULES, 0)
        places = self.in_frame(plate)
        near, place = self._near(plate, places, strobe_px)
        # sources that are no stars never were candidates of the fit: ask them about the stars left over
        never = np.isfinite(m.x_px) & np.isfinite(m.y_px)
        never[self._usable] = False
        free = np.ones(len(places), dtype=bool)
        free[place] = False
        left = Predicted(places.star[free], places.x_px[free], places.y_px[free])
        for measurement in nearest_pairs(left, np.flatnonzero(never), m.x_px, m.y_px, strobe_px)[
            0
        ].measurement:
            rule = next((name for name, flag in BY_FLAG.items() if m.flags[measurement] & int(flag)), None)
            if rule is not None:
                counts[rule] += 1
        if len(near):
            blamed = np.zeros(len(near), dtype=bool)
            for rule, bad in self._ruled_out(places, near, place).items():
                counts[rule] += int((bad & ~blamed).sum())
                blamed |= bad
        counts[DEVIATION] = outliers
        return counts

    def _predicted(self, plate: Plate, margin_px: float) -> Predicted:
        m = self._measurements
        return predicted(
            plate,
            self._stars,
            width_px=m.width_px,
            height_px=m.height_px,
            margin_px=margin_px,
            projected=self.projected(plate),
        )

    def _close_by(self, plate: Plate, places: Predicted, strobe_px: float) -> Neighborhood:
        held = self._neighborhood
        if held is None or not held.holds(places, strobe_px):
            reach_px = 2.0 * strobe_px + SPARE_PX
            held = self._neighborhood = Neighborhood(
                self._predicted(plate, reach_px),
                len(self._stars),
                self._x_px,
                self._y_px,
                reach_px=reach_px,
                group_px=self._group_px() + SPARE_PX,
            )
        return held

    def _group_px(self) -> float:
        return self._settings.star_group_fwhm * self._fwhm_px

    def _near(self, plate: Plate, places: Predicted, strobe_px: float) -> tuple[Pairs, Index]:
        """Mutually nearest star and measurement within the strobe; and which place each star has."""
        if len(places) == 0 or self._usable.size == 0:
            return NO_PAIRS, NO_PAIRS.star
        # no more of the brightest measurements than could belong to the catalog's stars
        most = max(FEWEST_MEASUREMENTS, 2 * len(places))
        near, place = self._close_by(plate, places, strobe_px).pairs(places, most, strobe_px)
        return Pairs(self._usable[near.measurement], near.star), place

    def _ruled_out(self, places: Predicted, near: Pairs, place: Index) -> dict[str, Mask]:
        """Candidates that a rule other than K_rej forbids; a candidate may fall under several."""
        flags = self._measurements.flags[near.measurement]
        out = {name: (flags & int(flag)) != 0 for name, flag in BY_FLAG.items()}
        if np.mean(out["no peak"]) > SHARP_SHARE:
            out["no peak"] = np.zeros(len(near), dtype=bool)
        assert self._neighborhood is not None
        out[STAR_GROUP] = self._neighborhood.grouped_stars(
            places, self._stars.mag[places.star], self._group_px(), self._settings.group_magnitudes
        )[place]
        out[MEASUREMENT_GROUP] = self._in_measurement_group(near.measurement)
        return out

    def _in_measurement_group(self, measurement: Index) -> Mask:
        m = self._measurements
        x, y = self._x_px, self._y_px
        radius = self._settings.measurement_group_fwhm * self._fwhm_px
        if self._close is None:
            tree = cKDTree(np.column_stack((x, y)))
            self._close = tree.query_pairs(radius, output_type="ndarray")
            self._magnitude = -2.5 * np.log10(np.maximum(m.flux[self._usable], 1e-9))
        most = min(max(FEWEST_IN_GROUPS, 4 * measurement.size), self.count)
        if self._grouped is None or self._grouped[0] != most:
            close = self._close[(self._close < most).all(axis=1)]
            bad = np.zeros(len(m), dtype=bool)
            depth = self._settings.group_magnitudes
            bad[self._usable] = in_groups(close, x, y, self._magnitude, radius, depth)
            self._grouped = most, bad
        return np.asarray(self._grouped[1][measurement])

    def _spread(self, pairs: Pairs) -> Pairs:
        x, y = self.seen(pairs)
        taken = spread_over_fragments(
            x,
            y,
            self._stars.mag[pairs.star],
            width_px=self._measurements.width_px,
            height_px=self._measurements.height_px,
            fragments=self._settings.fragments,
            cap=self._settings.fragment_cap,
        )
        return pairs.those(taken)
