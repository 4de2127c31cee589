"""Frames of wide or bent lenses: found by their middle, fitted outward to a lens, told as SIP or ZPN."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.star_counts import stars_round
from mountnav.catalog.stars import Catalog, Stars
from mountnav.frames import Hint
from mountnav.identification.lens_fit import MOST_STARS, LensFit, fit_lens
from mountnav.identification.middle import MIDDLE_SHARES, middle_of
from mountnav.identification.pairing import Pairs
from mountnav.identification.plate import Plate
from mountnav.identification.search import Reach, identify
from mountnav.identification.selection import star_like_beside
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.trail_check import StarsInCone, check_trails
from mountnav.identification.verification import Identified, spread_px
from mountnav.measuring.measurements import Measurements
from mountnav.sky.wcs import is_zpn, places_at_pixels
from mountnav.solution import ErrorBudget, IdentifiedPairs, Reason, Solution
from mountnav.units import ARCSEC_PER_RAD

__all__ = ["WideField", "lens_for_bent", "may_be_wide", "solution_of", "solve_middle"]

Array = NDArray[np.float64]

WIDE_DEG = 20.0
"""Where the scale is known, frames with a smaller diagonal are no wide fields. Doubled, fields of 40° that
are bent as well aren't found."""
FEWEST_SOURCES = 40
"""With fewer sources a frame whose scale isn't known isn't taken for a wide field: those show hundreds of
stars, and a hopeless frame costs no more time."""
FOUND_SHARE = 0.4
"""Of the stars that the lens puts in its reach at least so many must have been found. Chosen by hand: drawn
frames have 0.7 to 0.95."""
LEAST_SPREAD = 0.1
"""The pairs of a lens scatter at least so far in each direction, one sigma, in the frame's shorter side:
those of a whole middle of 0.4 do by themselves, those of a smaller one must have been found farther out. Of
stars in a narrow strip nothing follows for the rest of the frame. Halved, a strip a sixth of the side wide is
enough; doubled, frames that show sky about their middle alone are refused."""
BENT_SHARE = 0.01
"""A plate whose bending moves the corners by more than this share of their distance from the center may be a
lens that no cubic stands for."""
BENT_DEG = 24.0
"""So may that of any frame whose diagonal is this or more."""
BETTER = 0.85
"""A lens takes the place of a plate that leaves its pairs more of their distance than the lens does, by one
over this: plates that are as good stay."""
EDGE_SHARE, EDGE_SIGMA_PX = 0.9, 0.5
"""Stars that reach less far of the way to the corner, or a lens that is known worse there, don't vouch for
the whole frame: it is told."""
FEWEST_ABOUT_MIDDLE = 30
"""So many pairs about the middle begin a lens; chosen by hand."""
SAME_SOURCE_PX = 1.5
"""Two measurements of one source lie no farther apart."""
SHARE_OF_BUDGET = 0.3
"""Of a solve's budget, for searching the middle; chosen by hand."""
HELPED = (Reason.NO_MATCH, Reason.CHANCE, Reason.CLOUD_OR_DEFOCUS, Reason.CATALOG_TOO_SHALLOW)
"""Refusals after which the middle is searched: stars there are, and nothing that was tried fits them."""


@dataclass(frozen=True, slots=True)
class WideField:
    """A frame whose lens is known.

    Attributes
    ----------
    measurements : Measurements
        Those its pairs point into.
    blind : bool
        Found over the whole sky.
    """

    fit: LensFit
    measurements: Measurements
    false_probability: float
    blind: bool
    detail: str

    @property
    def notes(self) -> tuple[str, ...]:
        """What should be known of its WCS."""
        lens, found = self.fit.lens, []
        corner, reach = lens.corner_rad(), self.fit.reach_rad
        if reach < EDGE_SHARE * corner or self.fit.corner_sigma_px > EDGE_SIGMA_PX:
            found.append(
                f"stars were identified up to {math.degrees(reach):.1f}° from the optical axis, the corners "
                f"are {math.degrees(corner):.1f}° from it: positions out there are not proven"
            )
        if is_zpn(lens.cards()):
            found.append(
                "the lens is too wide or too bent for SIP polynomials: the WCS is a ZPN projection, and a "
                "plain TAN plate of the same frame holds about its center alone"
            )
        return tuple(found)


def may_be_wide(found: Identified, hint: Hint, measurements: Measurements) -> bool:
    """Whether a frame that was refused may be of a wide lens."""
    if found.reference is not None or found.reason not in HELPED or len(measurements) < FEWEST_SOURCES:
        return False
    highs = [one.scale_high_arcsec_px for one in (hint, *hint.alternatives)]
    known = [high for high in highs if high is not None]
    if len(known) < len(highs):
        return True
    diagonal_px = math.hypot(measurements.width_px, measurements.height_px)
    return diagonal_px * max(known) / 3600.0 >= WIDE_DEG


def solve_middle(
    measurements: Measurements,
    pixels: NDArray[np.generic] | None,
    catalog: Catalog,
    hint: Hint,
    reach: Reach,
    settings: IdentificationSettings,
    *,
    epoch_yr: float,
    budget_s: float,
    sky: Callable[[Stars | None], StarsInCone | None],
) -> WideField | None:
    """Find a frame by its middle, and fit its lens outward.

    Parameters
    ----------
    pixels : ndarray or None
        Of the whole frame, against which the middle is held; None where only a list is at hand.
    reach : Reach
        With the hypotheses that were tried for this frame before: the odds count them.
    budget_s : float
        Processor time of the whole solve.
    sky : callable
        Gives where more of the same stars are to be had.
    """
    tried = reach.tried
    for share in MIDDLE_SHARES:
        middle = middle_of(measurements, share)
        if middle is None:
            continue
        found = identify(
            middle.measurements,
            catalog,
            middle.hint(hint),
            epoch_yr=epoch_yr,
            settings=settings,
            budget_s=SHARE_OF_BUDGET * budget_s,
            reach=replace(reach, thorough=False, tried=tried),
        )
        tried = max(tried, found.tried)
        if found.reference is None:
            continue
        found, own = middle.native(found, measurements)
        if pixels is not None:
            top, right = middle.low_px + middle.height_px, middle.left_px + middle.width_px
            part = np.ascontiguousarray(pixels[middle.low_px : top, middle.left_px : right])
            light = check_trails(found, own, part, settings, sky=sky(found.stars))
            if not light.points or light.found.reference is None:
                return None  # trails, or two exposures: no lens mends that
            found = light.found
        reference, stars = found.reference, found.stars
        assert reference is not None
        assert stars is not None
        pairs = Pairs(middle.of_frame[reference.pairs.measurement], reference.pairs.star)
        fit = _lens(
            middle.in_frame(reference.plate), stars, pairs, measurements, reach.indexed or catalog, epoch_yr
        )
        if fit is None:
            continue
        detail = f"{len(fit.pairs)} pairs, found by the frame's middle, {found.tried} hypotheses"
        return WideField(fit, measurements, found.false_probability, found.blind, detail)
    return None


def bent(plate: Plate, width_px: int, height_px: int) -> bool:
    """Whether a solved frame may be of a lens that no cubic stands for."""
    diagonal_deg = math.hypot(width_px, height_px) * plate.scale_arcsec_px() / 3600.0
    if diagonal_deg >= BENT_DEG:
        return True
    if plate.degree < 3:
        return False
    x = plate.center_x_px + 0.5 * width_px * np.array([-1.0, 1.0, -1.0, 1.0])
    y = plate.center_y_px + 0.5 * height_px * np.array([-1.0, -1.0, 1.0, 1.0])
    whole = np.array(plate.tangential(x, y))
    linear = replace(plate, degree=1, xi=plate.xi[:3], eta=plate.eta[:3])
    off = np.hypot(*(whole - np.array(linear.tangential(x, y))))
    return bool(off.max() > BENT_SHARE * np.hypot(*whole).max())


def lens_for_bent(
    found: Identified,
    measured: Measurements,
    again: Callable[[], Measurements],
    catalog: Catalog,
    epoch_yr: float,
) -> WideField | None:
    """Fit a lens to a frame that is solved, where that holds more of it or holds it better than its plate.

    Parameters
    ----------
    found : Identified
        With a reference.
    measured : Measurements
        Those its pairs point into.
    again : callable
        Measures the frame in full: where the plate was wrong, nothing was measured.
    """
    reference, stars = found.reference, found.stars
    if reference is None or stars is None or not bent(reference.plate, measured.width_px, measured.height_px):
        return None
    whole = again()
    pairs = _about_middle(_in_other_list(reference.pairs, measured, whole), whole)
    fit = _lens(reference.plate, stars, pairs, whole, catalog, epoch_yr)
    if fit is None:
        return None
    if fit.rms_px >= BETTER * _off_px(reference.plate, fit, whole):
        return None
    detail = f"{len(fit.pairs)} pairs, {found.tried} hypotheses"
    return WideField(fit, whole, found.false_probability, found.blind, detail)


def _off_px(plate: Plate, fit: LensFit, measurements: Measurements) -> float:
    """What a plate leaves of the distances of a lens' pairs, root mean square."""
    source, star = fit.pairs.measurement, fit.pairs.star
    xi, eta = plate.tangential(measurements.x_px[source], measurements.y_px[source])
    star_xi, star_eta = plate.project(fit.stars.ra_deg[star], fit.stars.dec_deg[star])
    square = (xi - star_xi) ** 2 + (eta - star_eta) ** 2
    # on the plane a star near its end lies far out: measured there, as the plate itself does
    return float(np.sqrt(np.nanmean(square))) / plate.scale_arcsec_px()


def _about_middle(pairs: Pairs, m: Measurements) -> Pairs:
    """Pairs about the frame's middle, where any plate is nearly right; all of them where these are few."""
    off_x = m.x_px[pairs.measurement] - (m.width_px - 1) / 2.0
    off_y = m.y_px[pairs.measurement] - (m.height_px - 1) / 2.0
    near = np.hypot(off_x, off_y) <= 0.25 * math.hypot(m.width_px, m.height_px)
    return pairs.those(near) if near.sum() >= FEWEST_ABOUT_MIDDLE else pairs


def _in_other_list(pairs: Pairs, one: Measurements, other: Measurements) -> Pairs:
    """The same pairs, into another list of the frame's sources; those that it doesn't have are left out."""
    if one is other or len(other) == 0:
        return pairs
    places = np.column_stack((one.x_px[pairs.measurement], one.y_px[pairs.measurement]))
    tree = cKDTree(np.column_stack((other.x_px, other.y_px)))
    distance, index = map(np.asarray, tree.query(places))
    near = np.flatnonzero(distance <= SAME_SOURCE_PX)
    _, first = np.unique(index[near], return_index=True)
    near = near[first]
    return Pairs(index[near], pairs.star[near])


def _lens(
    plate: Plate, stars: Stars, pairs: Pairs, measurements: Measurements, catalog: Catalog, epoch_yr: float
) -> LensFit | None:
    fit = fit_lens(
        plate,
        stars,
        pairs,
        measurements,
        star_like_beside(measurements, pairs.measurement),
        lambda center, radius_deg, count: stars_round(catalog, center, radius_deg, count, epoch_yr=epoch_yr),
    )
    if (
        fit is None
        or fit.found_share < FOUND_SHARE
        or len(fit.pairs) < FOUND_SHARE * min(len(pairs), MOST_STARS)
        or spread_px(measurements, fit.pairs)
        < LEAST_SPREAD * min(measurements.width_px, measurements.height_px)
    ):
        return None
    return fit


def solution_of(wide: WideField, catalog_steps: tuple[str, ...]) -> Solution:
    """The solution that a lens gives."""
    fit, m = wide.fit, wide.measurements
    lens, pairs, stars = fit.lens, fit.pairs, fit.stars
    center_x, center_y = (lens.width_px - 1) / 2.0, (lens.height_px - 1) / 2.0
    matrix = lens.matrix_at(center_x, center_y)
    covariance = matrix @ fit.center_covariance_px2 @ matrix.T
    scale = math.sqrt(abs(float(np.linalg.det(matrix))))
    x, y = m.x_px[pairs.measurement], m.y_px[pairs.measurement]
    ra, dec = stars.ra_deg[pairs.star], stars.dec_deg[pairs.star]
    east, north = _apart_arcsec(*places_at_pixels(lens.zpn_cards(), x, y), ra, dec)
    centroid = np.sqrt(0.5 * (m.x_sigma_px[pairs.measurement] ** 2 + m.y_sigma_px[pairs.measurement] ** 2))
    identified = IdentifiedPairs(
        x_px=x,
        y_px=y,
        ra_deg=ra,
        dec_deg=dec,
        dx_arcsec=east,
        dy_arcsec=north,
        flux=m.flux[pairs.measurement],
        flux_sigma=m.flux_sigma[pairs.measurement],
        mag=stars.mag[pairs.star],
        centroid_sigma_arcsec=centroid * scale,
        catalog_sigma_arcsec=stars.sigma_arcsec[pairs.star],
        flags=m.flags[pairs.measurement],
        used=np.ones(len(pairs), dtype=bool),
        leverage=fit.leverage,
        color_mag=stars.color_mag[pairs.star],
        star_flags=stars.flags[pairs.star],
        band=stars.band,
        color_name=stars.color_name,
    )

    def rms(sigma: Array) -> float:
        known = sigma[np.isfinite(sigma)]
        return float(np.sqrt(np.mean(known**2))) if known.size else 0.0

    return Solution(
        center=lens.place(center_x, center_y),
        center_sigma_arcsec=float(np.sqrt(0.5 * np.trace(covariance))),
        scale_arcsec_px=scale,
        rotation_deg=float(np.degrees(np.arctan2(matrix[0, 1], matrix[1, 1])) % 360.0),
        parity=-1 if np.linalg.det(matrix) > 0 else 1,
        rms_arcsec=float(np.sqrt(np.mean(east**2 + north**2))),
        pairs=len(pairs),
        rejected=fit.left_out,
        false_probability=wide.false_probability,
        mode=f"{'blind' if wide.blind else 'full'}/lens",
        wcs=lens.cards(),
        center_covariance_arcsec2=covariance,
        identified=identified,
        catalog=stars.source,
        catalog_steps=catalog_steps,
        errors=ErrorBudget(
            rms(identified.centroid_sigma_arcsec), rms(identified.catalog_sigma_arcsec), fit.extra_px * scale
        ),
    )


def _apart_arcsec(seen_ra: Array, seen_dec: Array, ra: Array, dec: Array) -> tuple[Array, Array]:
    """From stars to where they are seen: east and north, each about its star."""
    lon = np.radians(seen_ra - ra)
    lat, lat0 = np.radians(seen_dec), np.radians(dec)
    east = np.cos(lat) * np.sin(lon)
    north = np.sin(lat - lat0) + 2.0 * np.cos(lat) * np.sin(lat0) * np.sin(0.5 * lon) ** 2
    return east * ARCSEC_PER_RAD, north * ARCSEC_PER_RAD
