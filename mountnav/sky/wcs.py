"""Positions at pixels and back through the FITS cards of a WCS: TAN, TAN-SIP or ZPN.

CRPIX counts from 1, pixels from 0. ZPN is the projection of a wide lens [Calabretta and Greisen 2002,
§5.1.7]: the distance from its axis is a polynomial of the angle.
"""

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


def is_zpn(cards: Mapping[str, object]) -> bool:
    """Whether these are the cards of a lens too wide for SIP."""
    return str(cards.get("CTYPE1", "")) == "RA---ZPN"


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
    """Right ascension and declination (degrees, shape (n,)) at pixels (0-based).

    Parameters
    ----------
    cards : mapping
        CRPIX (1-based), CRVAL, CD, and A_/B_ or PV2_ terms if any.
    x_px, y_px : ndarray, shape (n,)
        Pixels, 0-based: the middle of the first pixel is (0, 0).

    Returns
    -------
    ra_deg, dec_deg : ndarray, shape (n,)
        NaN where a ZPN lens shows no sky.

    Raises
    ------
    BadRequest
        A card is missing, or the projection is none of TAN, TAN-SIP and ZPN.
    """
    if is_zpn(cards):
        return _zpn_places(cards, x_px, y_px)
    if str(cards.get("CTYPE1", "")) not in ("RA---TAN", "RA---TAN-SIP"):
        raise BadRequest(
            f"CTYPE1 is {cards.get('CTYPE1')!r}", advice="only TAN, TAN-SIP and ZPN are understood"
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
    if not np.isfinite(ra[0]):
        raise BadRequest(f"the lens shows no sky at pixel ({x_px:g}, {y_px:g})", advice="ask nearer its axis")
    return Icrs(float(ra[0]), float(dec[0]))


# -- ZPN --------------------------------------------------------------------------------------------------

_STEPS = 40
"""Halvings of the angle's bracket: 180° / 2⁴⁰ are far below a double's rounding of pixels."""
_SAMPLES = 721
"""Angles at which the polynomial is looked at for where it turns back: each quarter of a degree."""


def _zpn_polynomial(cards: Mapping[str, object]) -> Array:
    """Coefficients, the constant first."""
    numbers = [int(name[4:]) for name in cards if name.startswith("PV2_") and name[4:].isdecimal()]
    if not numbers:
        raise BadRequest("the WCS has no card PV2_1", advice="give the cards of a solved frame")
    found = np.zeros(max(numbers) + 1)
    for number in numbers:
        found[number] = _number(cards, f"PV2_{number}")
    return found


def _cd(cards: Mapping[str, object]) -> Array:
    return np.array([[_number(cards, f"CD{i}_{j}") for j in (1, 2)] for i in (1, 2)])


def _rising(coefficients: Array) -> float:
    """Up to which angle, radians, the polynomial rises."""
    away = np.linspace(0.0, np.pi, _SAMPLES)
    falls = np.flatnonzero(np.diff(np.polynomial.polynomial.polyval(away, coefficients)) <= 0.0)
    return float(away[falls[0]]) if falls.size else float(np.pi)


def rising_to_deg(cards: Mapping[str, object]) -> float:
    """Up to which angle from its axis a lens (ZPN) shows the sky. Raises `BadRequest`."""
    return float(np.degrees(_rising(_zpn_polynomial(cards))))


def _zpn_places(cards: Mapping[str, object], x_px: Array, y_px: Array) -> tuple[Array, Array]:
    offset = np.stack(
        (
            np.asarray(x_px, dtype=float) + 1.0 - _number(cards, "CRPIX1"),
            np.asarray(y_px, dtype=float) + 1.0 - _number(cards, "CRPIX2"),
        )
    )
    east, north = np.radians(_cd(cards) @ offset)
    r = np.hypot(east, north)
    coefficients = _zpn_polynomial(cards)
    most = _rising(coefficients)
    low, high = np.zeros_like(r), np.full_like(r, most)
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        below = np.polynomial.polynomial.polyval(middle, coefficients) < r
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    away = 0.5 * (low + high)
    away[r > np.polynomial.polynomial.polyval(most, coefficients)] = np.nan
    turn = np.arctan2(east, north)
    dec0 = np.radians(_number(cards, "CRVAL2"))
    sin_dec = np.sin(dec0) * np.cos(away) + np.cos(dec0) * np.sin(away) * np.cos(turn)
    along = np.cos(dec0) * np.cos(away) - np.sin(dec0) * np.sin(away) * np.cos(turn)
    across = np.sin(away) * np.sin(turn)
    ra = _number(cards, "CRVAL1") + np.degrees(np.arctan2(across, along))
    # from the parts, not by arcsin, which is blunt at the poles
    dec = np.degrees(np.arctan2(sin_dec, np.hypot(along, across)))
    return np.asarray(ra % 360.0), np.asarray(dec)


def zpn_pixels(cards: Mapping[str, object], ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """Pixels (0-based, shape (n,)) of positions through ZPN cards; NaN for what the lens doesn't show."""
    lon = np.radians(np.asarray(ra_deg, dtype=float) - _number(cards, "CRVAL1"))
    lat, dec0 = np.radians(np.asarray(dec_deg, dtype=float)), np.radians(_number(cards, "CRVAL2"))
    east = np.cos(lat) * np.sin(lon)
    north = np.cos(dec0) * np.sin(lat) - np.sin(dec0) * np.cos(lat) * np.cos(lon)
    depth = np.sin(dec0) * np.sin(lat) + np.cos(dec0) * np.cos(lat) * np.cos(lon)
    across = np.hypot(east, north)
    away = np.arctan2(across, depth)
    coefficients = _zpn_polynomial(cards)
    r = np.degrees(np.polynomial.polynomial.polyval(away, coefficients))
    r = np.where(away <= _rising(coefficients), r, np.nan) / np.maximum(across, 1e-300)
    u, v = np.linalg.solve(_cd(cards), np.stack((r * east, r * north)))
    return u + _number(cards, "CRPIX1") - 1.0, v + _number(cards, "CRPIX2") - 1.0
