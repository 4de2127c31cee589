"""What a WCS is in the numbers of other programs: orientation, parity, field, CDELT and CROTA."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mountnav.sky.wcs import places_at_pixels

Value = str | int | float

_LINEAR = (
    "WCSAXES", "CUNIT1", "CUNIT2", "RADESYS", "CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2",
    "CD1_1", "CD1_2", "CD2_1", "CD2_2", "IMAGEW", "IMAGEH",
)  # fmt: skip


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
    """The cards of a solution without its SIP terms: TAN, with the same place and matrix at the center."""
    kept = {name: cards[name] for name in _LINEAR if name in cards}
    return {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", **kept}


def wcs_numbers(cards: Mapping[str, Value]) -> WcsNumbers:
    """Give the numbers of a WCS.

    Parameters
    ----------
    cards : mapping
        TAN or TAN-SIP with CRPIX at the frame's center, IMAGEW and IMAGEH, as a `Solution` has them.
    """
    cd11, cd12, cd21, cd22 = (float(cards[name]) for name in ("CD1_1", "CD1_2", "CD2_1", "CD2_2"))
    width, height = int(cards["IMAGEW"]), int(cards["IMAGEH"])
    determinant = cd11 * cd22 - cd12 * cd21
    sign = 1 if determinant >= 0 else -1
    scale_deg = math.sqrt(abs(determinant))
    # [astrometry.net, util/sip.c]: the angle of the matrix made into a rotation by its parity
    up, across = sign * cd11 + cd22, sign * cd21 - cd12
    center = places_at_pixels(cards, np.array([(width - 1) / 2.0]), np.array([(height - 1) / 2.0]))
    right, top = width - 0.5, height - 0.5
    corners = places_at_pixels(cards, np.array([-0.5, right, -0.5, right]), np.array([-0.5, -0.5, top, top]))
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
        radius_deg=max(
            _separation_deg(ra, dec, float(one), float(other)) for one, other in zip(*corners, strict=True)
        ),
    )


def _separation_deg(ra1_deg: float, dec1_deg: float, ra2_deg: float, dec2_deg: float) -> float:
    from mountnav.sky.coordinates import Icrs
    from mountnav.sky.sphere import separation_arcsec

    return separation_arcsec(Icrs(ra1_deg, dec1_deg), Icrs(ra2_deg, dec2_deg)) / 3600.0
