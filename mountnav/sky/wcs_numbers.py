"""What a WCS is in the numbers of other programs: orientation, parity, field, CDELT and CROTA."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mountnav.sky.sphere import gnomonic
from mountnav.sky.wcs import is_zpn, places_at_pixels

Value = str | int | float

_LINEAR = (
    "WCSAXES", "CUNIT1", "CUNIT2", "RADESYS", "CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2",
    "CD1_1", "CD1_2", "CD2_1", "CD2_2", "IMAGEW", "IMAGEH",
)  # fmt: skip


TOUCHES_ALONE = (
    "the lens is too wide for TAN and SIP: this plate holds about the center of the frame alone, "
    "`mountnav solve --wcs` writes all of it as ZPN"
)
"""Said beside a plate that stands for a ZPN lens."""


@dataclass(frozen=True, slots=True)
class WcsNumbers:
    """The numbers that plate solvers state of a field, each by its own definition.

    Attributes
    ----------
    ra_deg, dec_deg : float
        ICRS place of the frame's geometric center.
    pixscale_arcsec : float
        sqrt(|det CD|).
    determinant_sign : int
        Of the CD matrix: -1 for the sky as seen (east to the left of north), +1 mirrored. astrometry.net's
        `parity`.
    orientation_deg : float
        Position angle of up, east of north, (-180, 180], as astrometry.net's `wcsinfo` and web API have it.
    cdelt1_deg, cdelt2_deg, crota1_deg, crota2_deg : float
        The older convention that ASTAP writes besides the CD matrix [Calabretta and Greisen 2002 §6.1].
    width_deg, height_deg : float
        Sides of the field along its middle, pixel scale times pixels.
    radius_deg : float
        From the center to the farthest corner.
    """

    ra_deg: float
    dec_deg: float
    pixscale_arcsec: float
    determinant_sign: int
    orientation_deg: float
    cdelt1_deg: float
    cdelt2_deg: float
    crota1_deg: float
    crota2_deg: float
    width_px: int
    height_px: int
    width_deg: float
    height_deg: float
    radius_deg: float


def linear_cards(cards: Mapping[str, Value]) -> dict[str, Value]:
    """The cards of a solution without its SIP terms: TAN, with the same place and matrix at the center.

    Of a ZPN lens likewise: its scale and direction at the frame's center.
    """
    if is_zpn(cards):
        return _tan_at_center(cards)
    kept = {name: cards[name] for name in _LINEAR if name in cards}
    return {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", **kept}


def touching_cards(cards: Mapping[str, Value]) -> dict[str, Value]:
    """The cards as they are; of a ZPN lens, which callers that want a plate don't know, a TAN plate."""
    return _tan_at_center(cards) if is_zpn(cards) else dict(cards)


def _tan_at_center(cards: Mapping[str, Value]) -> dict[str, Value]:
    """A plain plate that touches a lens' sky at the frame's center."""
    x, y = (int(cards["IMAGEW"]) - 1) / 2.0, (int(cards["IMAGEH"]) - 1) / 2.0
    across, up = np.array([0.0, -0.5, 0.5, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, -0.5, 0.5])
    ra, dec = places_at_pixels(cards, x + across, y + up)
    xi, eta = (np.degrees(side) for side in gnomonic(ra, dec, float(ra[0]), float(dec[0])))
    kept = {name: cards[name] for name in ("WCSAXES", "CUNIT1", "CUNIT2", "RADESYS", "IMAGEW", "IMAGEH")}
    return {
        "CTYPE1": "RA---TAN",
        "CTYPE2": "DEC--TAN",
        **kept,
        "CRPIX1": x + 1.0,
        "CRPIX2": y + 1.0,
        "CRVAL1": float(ra[0]),
        "CRVAL2": float(dec[0]),
        "CD1_1": float(xi[2] - xi[1]),
        "CD1_2": float(xi[4] - xi[3]),
        "CD2_1": float(eta[2] - eta[1]),
        "CD2_2": float(eta[4] - eta[3]),
    }


def wcs_numbers(cards: Mapping[str, Value]) -> WcsNumbers:
    """Give the numbers of a WCS.

    Parameters
    ----------
    cards : mapping
        TAN or TAN-SIP with CRPIX at the frame's center, or ZPN; IMAGEW and IMAGEH, as a `Solution` has them.
    """
    if is_zpn(cards):
        # orientation and scale are those of the center; the corners are as far as the lens shows them
        return replace(wcs_numbers(linear_cards(cards)), radius_deg=_radius_deg(cards))
    cd11, cd12, cd21, cd22 = (float(cards[name]) for name in ("CD1_1", "CD1_2", "CD2_1", "CD2_2"))
    width, height = int(cards["IMAGEW"]), int(cards["IMAGEH"])
    determinant = cd11 * cd22 - cd12 * cd21
    sign = 1 if determinant >= 0 else -1
    scale_deg = math.sqrt(abs(determinant))
    # [astrometry.net, util/sip.c]: the angle of the matrix made into a rotation by its parity
    up, across = sign * cd11 + cd22, sign * cd21 - cd12
    center = places_at_pixels(cards, np.array([(width - 1) / 2.0]), np.array([(height - 1) / 2.0]))
    ra, dec = float(center[0][0]), float(center[1][0])
    return WcsNumbers(
        ra_deg=ra,
        dec_deg=dec,
        pixscale_arcsec=3600.0 * scale_deg,
        determinant_sign=sign,
        orientation_deg=-math.degrees(math.atan2(across, up)),
        cdelt1_deg=sign * math.hypot(cd11, cd21),
        cdelt2_deg=math.hypot(cd12, cd22),
        crota1_deg=math.degrees(math.atan2(sign * cd21, sign * cd11)),
        crota2_deg=math.degrees(math.atan2(-cd12, cd22)),
        width_px=width,
        height_px=height,
        width_deg=width * scale_deg,
        height_deg=height * scale_deg,
        radius_deg=_radius_deg(cards),
    )


def _radius_deg(cards: Mapping[str, Value]) -> float:
    """From the center to the farthest corner; 180 where a corner shows no sky."""
    width, height = int(cards["IMAGEW"]), int(cards["IMAGEH"])
    right, top, middle_x, middle_y = width - 0.5, height - 0.5, (width - 1) / 2.0, (height - 1) / 2.0
    ra, dec = places_at_pixels(
        cards,
        np.array([middle_x, -0.5, right, -0.5, right]),
        np.array([middle_y, -0.5, -0.5, top, top]),
    )
    if not np.isfinite(ra).all():
        return 180.0
    here = float(ra[0]), float(dec[0])
    return max(
        _separation_deg(*here, float(one), float(other)) for one, other in zip(ra[1:], dec[1:], strict=True)
    )


def _separation_deg(ra1_deg: float, dec1_deg: float, ra2_deg: float, dec2_deg: float) -> float:
    from mountnav.sky.coordinates import Icrs
    from mountnav.sky.sphere import separation_arcsec

    return separation_arcsec(Icrs(ra1_deg, dec1_deg), Icrs(ra2_deg, dec2_deg)) / 3600.0
