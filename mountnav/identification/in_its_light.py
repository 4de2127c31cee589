"""A solution held against the light of its own stars: moved to the middle of their trails, or refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Stars
from mountnav.identification.identified import Identified
from mountnav.identification.pairing import predicted
from mountnav.identification.plate import Plate
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.selection import star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.verification import KEPT_SHARE, reach_of, sound
from mountnav.measuring.light_path import (
    FEW_STARS,
    REACH_PX,
    LightPath,
    brighter_image,
    light_path,
    tamed,
)
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Reason

__all__ = ["MOVED", "InItsLight", "Sky", "in_its_light", "stands"]

Array = NDArray[np.float64]
Sky = Callable[[Icrs, float, float | None], Stars | None]
"""From a center, a radius in degrees and a magnitude to stars, brightest first; None if they can't be had."""

_SPOILT = int(Flag.SATURATED | Flag.BLEED)
SURE_PX = 0.75
"""A center of light whose error is greater isn't given: three sigma of it must stay within the 3 px that
a place may be off."""
MOVED_PX = 0.75
"""A center of light nearer to the plate's places than this is that of an uneven star image, not of a
path: the plate stays with the peaks, as catalogs do, and the difference goes into its error."""
MOVED_SHARE_FWHM, MOVED_MOST_PX = 0.1, 1.5
"""The same for wide images: this share of their width, up to half of the 3 px that a place may be off."""
MOVED_SIGMAS = 4.0
"""And farther off by fewer of its sigmas than this it can't be told from there: the frame is refused."""
MOVED_SHARE = 0.02
"""Error of a move, besides that of its center of light: the share of light that is too faint to be seen."""
GHOST_RATIO = 0.7
"""A mirrored set of the same stars that is brighter than this share of the identified ones may be the
stars themselves:
reflections keep a few percent, seldom half."""
MOVED = "moved_px"
"""Among a verdict's numbers: how far the plate was moved; absent where it stayed."""
TOLD_PX, TOLD_SIGMAS = 0.03, 3.0
"""Differences below this, or so many of their sigmas, are those of pixels and noise: undisturbed frames
show 0.00 to 0.02 px."""


@dataclass(frozen=True, slots=True)
class InItsLight:
    """What the light of its stars makes of a solution.

    Attributes
    ----------
    found : Identified
        The same, or with a plate moved to the middle of the light, or refused.
    measurements : Measurements
        Those its pairs point into: moved alike.
    path : LightPath or None
    points : bool
        The plate stayed where it was: it is the stars' own.
    """

    found: Identified
    measurements: Measurements
    path: LightPath | None
    points: bool


def in_its_light(
    found: Identified,
    measurements: Measurements,
    pixels: NDArray[np.generic],
    settings: IdentificationSettings,
    *,
    sky: Sky | None = None,
) -> InItsLight:
    """Look where the light of the identified stars fell, and put the plate where its middle is.

    Pieces of trails, or one of two exposures, hold a plate as well as stars do: the odds that so many stars
    are found by chance are as small. Only the light that is left over tells.

    Parameters
    ----------
    found : Identified
        With a reference.
    measurements : Measurements
    pixels : ndarray, shape (height, width)
        Those that were measured.
    settings : IdentificationSettings
    sky : callable, optional
        Gives the stars of a cone to a magnitude, at the frame's epoch, of the catalog that the frame was
        identified with: where few were identified, those beyond the frame's edges are asked as well.

    Returns
    -------
    InItsLight
    """
    reference, stars = found.reference, found.stars
    assert reference is not None
    assert stars is not None
    x, y = _places(reference, stars)
    of_pairs = reference.pairs.measurement
    clear = (measurements.flags[of_pairs] & _SPOILT) == 0
    fwhm_px = _fwhm_px(measurements, of_pairs)
    others = _expected(reference, stars, measurements)
    plane = tamed(pixels)
    ratio, how = brighter_image(pixels, *others, plane)
    if ratio > GHOST_RATIO:
        refused = _as_ghosts(found, ratio, how)
        return InItsLight(refused, measurements, None, points=False)
    flux = measurements.flux[of_pairs]
    if x.size < FEW_STARS and sky is not None:
        others = _round_about(reference, stars, measurements, sky)
    path = light_path(pixels, x, y, flux, clear, fwhm_px, others=others, plane=plane)
    if path is None:
        return InItsLight(found, measurements, None, points=True)
    if not _sure(path) or _moved_px(fwhm_px) < path.off_px <= MOVED_SIGMAS * path.sigma_px:
        return InItsLight(_refused(found, path), measurements, path, points=False)
    if not stands(path, fwhm_px):
        moved = _moved(reference, stars, measurements, path, settings)
        if moved is None:
            return InItsLight(_refused(found, path), measurements, path, points=False)
        numbers = found.numbers | {
            MOVED: path.off_px,
            "path_extent_px": path.extent_px,
            "path_sigma_px": path.sigma_px,
        }
        detail = f"{found.detail}, moved by {path.off_px:.1f} px to the middle of the stars' light"
        found = replace(found, reference=moved[0], detail=detail, numbers=numbers)
        return InItsLight(found, moved[1], path, points=False)
    variance_px2 = _unfollowed_px2(path)
    if variance_px2 > 0.0:
        scale = reference.plate.scale_arcsec_px()
        reference = _with_error(reference, variance_px2 * scale**2)
    return InItsLight(replace(found, reference=reference), measurements, path, points=True)


def _unfollowed_px2(path: LightPath) -> float:
    """Error (squared, per coordinate) of a plate that stays while the center of light lies beside it.

    All sources of a frame are drawn out alike, so this error is common to them: it doesn't show in the
    plate's residuals, and no number of pairs makes it less.
    """
    off2 = 0.5 * path.off_px**2
    if path.drawn_out:
        return off2 + path.sigma_px**2
    # round images are those of points: what differs by no more than noise does is none
    return off2 if path.off_px > max(TOLD_PX, TOLD_SIGMAS * path.sigma_px) else 0.0


def _sure(path: LightPath) -> bool:
    """Whether the center of light is known well enough to be a place."""
    return not path.cut and path.sigma_px <= SURE_PX


def stands(path: LightPath, fwhm_px: float = 0.0) -> bool:
    """Whether the light lies where the plate has the stars, or evenly about them as spikes and halos do."""
    return _sure(path) and path.off_px <= _moved_px(fwhm_px)


def _moved_px(fwhm_px: float) -> float:
    """From where on a center of light is another place: wide images are uneven by a tenth of their width."""
    return float(np.clip(MOVED_SHARE_FWHM * fwhm_px, MOVED_PX, MOVED_MOST_PX))


def _places(reference: Reference, stars: Stars) -> tuple[Array, Array]:
    """Where the plate has the stars of its pairs, pixels."""
    plate, chosen = reference.plate, reference.pairs.star
    return plate.pixels(*plate.project(stars.ra_deg[chosen], stars.dec_deg[chosen]))


def _round_about(
    reference: Reference, stars: Stars, measurements: Measurements, sky: Sky
) -> tuple[Array, Array]:
    """The same with those beyond the frame's edges, whose light elsewhere may fall within."""
    plate = reference.plate
    diagonal_px = math.hypot(measurements.width_px, measurements.height_px)
    radius_deg = (0.5 * diagonal_px + REACH_PX) * plate.scale_arcsec_px() / 3600.0
    faintest = float(np.nanmax(stars.mag[reference.pairs.star], initial=-np.inf))
    around = sky(plate.center(), radius_deg, faintest if np.isfinite(faintest) else None)
    return _expected(reference, stars, measurements, around, REACH_PX)


def _expected(
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    around: Stars | None = None,
    margin_px: float = 0.0,
) -> tuple[Array, Array]:
    """Where the plate has all stars as bright as the identified ones, brightest first."""
    there = predicted(
        reference.plate,
        stars if around is None else around,
        width_px=measurements.width_px,
        height_px=measurements.height_px,
        margin_px=margin_px,
    )
    if around is not None:
        return there.x_px, there.y_px
    faintest = float(np.nanmax(stars.mag[reference.pairs.star], initial=-np.inf))
    some = ~(stars.mag[there.star] > faintest) if np.isfinite(faintest) else np.ones(len(there), dtype=bool)
    return there.x_px[some], there.y_px[some]


def _as_ghosts(found: Identified, ratio: float, how: str) -> Identified:
    detail = (
        f"a second image of the same stars, {how}, is {ratio:.1f} times as bright as what was identified: "
        f"that may be a reflection in the optics"
    )
    numbers = found.numbers | {"second_image_ratio": ratio}
    return replace(found, reference=None, reason=Reason.TRAILED, detail=detail, numbers=numbers)


def _fwhm_px(measurements: Measurements, chosen: NDArray[np.int64]) -> float:
    fwhm = measurements.fwhm_px[chosen]
    fwhm = fwhm[np.isfinite(fwhm)]
    return float(np.median(fwhm)) if fwhm.size else 3.0


def _with_error(reference: Reference, variance_arcsec2: float) -> Reference:
    covariance = reference.center_covariance_arcsec2 + variance_arcsec2 * np.eye(2)
    return replace(reference, center_covariance_arcsec2=covariance)


def _moved(
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    path: LightPath,
    settings: IdentificationSettings,
) -> tuple[Reference, Measurements] | None:
    """The plate anew, each source moved to where its star's light has its middle."""
    there = replace(measurements, x_px=measurements.x_px + path.dx_px, y_px=measurements.y_px + path.dy_px)
    plate = _shifted(reference.plate, path.dx_px, path.dy_px)
    selection = Selection(there, star_like(there), stars, settings)
    reach_px = reach_of(reference)
    again = selection.refine(plate, reach_px)
    if again is None or len(again.pairs) < KEPT_SHARE * len(reference.pairs):
        selection = Selection(there, np.unique(reference.pairs.measurement), stars, settings)
        again = selection.refine(plate, reach_px)
    if again is None or not sound(again, selection, there, plate, settings, reach_px):
        return None
    scale = again.plate.scale_arcsec_px()
    sigma_px = math.hypot(path.sigma_px, MOVED_SHARE * path.off_px)
    return _with_error(again, (sigma_px * scale) ** 2), there


def _shifted(plate: Plate, dx_px: float, dy_px: float) -> Plate:
    """The plate that has every star so much farther along, to first order about the center."""
    dxi, deta = plate.matrix() @ np.array([dx_px, dy_px])
    xi, eta = plate.xi.copy(), plate.eta.copy()
    xi[0] -= dxi
    eta[0] -= deta
    return replace(plate, xi=xi, eta=eta)


def _refused(found: Identified, path: LightPath) -> Identified:
    how_far = "more than can be seen" if path.cut else f"{path.extent_px:.0f} px from where they were found"
    detail = (
        f"the light of {path.stars} identified stars reaches {how_far} (a trail, a shaken tube, two "
        f"exposures in one), and its middle is only known to {path.sigma_px:.1f} px"
    )
    numbers = found.numbers | {
        "path_extent_px": path.extent_px,
        "path_sigma_px": float(min(path.sigma_px, 1e6)),
    }
    return replace(found, reference=None, reason=Reason.TRAILED, detail=detail, numbers=numbers)
