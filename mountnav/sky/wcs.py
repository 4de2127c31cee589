"""Positions at pixels through the FITS cards of a WCS, TAN or TAN-SIP. CRPIX counts from 1, pixels from 0."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse

Array = NDArray[np.float64]


def _number(cards: Mapping[str, object], name: str) -> float:
    value = cards.get(name)
    if not isinstance(value, int | float):
        raise BadRequest(f"the WCS has no card {name}", advice="give the cards of a solved frame")
    return float(value)


def sip_distorted(cards: Mapping[str, object], u: Array, v: Array) -> tuple[Array, Array]:
    """U + A(u, v) and v + B(u, v) of the SIP convention."""
    out = []
    for letter, base in (("A", u), ("B", v)):
        order = int(_number(cards, f"{letter}_ORDER")) if f"{letter}_ORDER" in cards else 0
        value = base.copy()
        # by rising degree, as `identification.plate.powers` has them
        for i, j in ((degree - j, j) for degree in range(max(order, 1) + 1) for j in range(degree + 1)):
            factor = cards.get(f"{letter}_{i}_{j}", 0.0)
            if isinstance(factor, int | float) and factor:
                value = value + float(factor) * u**i * v**j
        out.append(value)
    return out[0], out[1]


def places_at_pixels(cards: Mapping[str, object], x_px: Array, y_px: Array) -> tuple[Array, Array]:
    """Right ascension and declination (degrees, shape (n,)) at pixels (0-based) through TAN or TAN-SIP cards.

    Parameters
    ----------
    cards : mapping
        CRPIX (1-based), CRVAL, CD, and A_/B_ terms if any.
    x_px, y_px : ndarray, shape (n,)

    Raises
    ------
    BadRequest
        A card is missing, or the projection is none of TAN and TAN-SIP.
    """
    if str(cards.get("CTYPE1", "")) not in ("RA---TAN", "RA---TAN-SIP"):
        raise BadRequest(
            f"CTYPE1 is {cards.get('CTYPE1')!r}", advice="only RA---TAN and RA---TAN-SIP are understood"
        )
    u, v = sip_distorted(
        cards,
        np.asarray(x_px, dtype=float) + 1.0 - _number(cards, "CRPIX1"),
        np.asarray(y_px, dtype=float) + 1.0 - _number(cards, "CRPIX2"),
    )
    xi = np.radians(_number(cards, "CD1_1") * u + _number(cards, "CD1_2") * v)
    eta = np.radians(_number(cards, "CD2_1") * u + _number(cards, "CD2_2") * v)
    ra, dec = gnomonic_inverse(xi, eta, _number(cards, "CRVAL1"), _number(cards, "CRVAL2"))
    return np.asarray(ra) % 360.0, np.asarray(dec)


def icrs_at_pixel(cards: Mapping[str, object], x_px: float, y_px: float) -> Icrs:
    """Give the position at one pixel.

    Parameters
    ----------
    cards : mapping
        See `places_at_pixels`.
    x_px, y_px : float
        0-based; the center of the file's first pixel is (0, 0).

    Raises
    ------
    BadRequest
        As `places_at_pixels`.
    """
    ra, dec = places_at_pixels(cards, np.array([x_px]), np.array([y_px]))
    return Icrs(float(ra[0]), float(dec[0]))
