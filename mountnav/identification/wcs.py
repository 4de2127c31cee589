"""FITS cards of a plate, TAN or TAN-SIP, and the plate of such cards; `mountnav.sky.wcs` reads positions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.identification.plate import Plate, powers
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs import sip_distorted

Array = NDArray[np.float64]

Cards = dict[str, str | int | float]

GRID = 21
"""Points per side on which the inverse polynomials are fitted: many more than the ten coefficients of a
cubic, or the 55 of the highest degree."""
MOST_ORDER = 9
"""SIP knows no higher one [SIP convention, Shupe et al. 2005]."""


def wcs_cards(plate: Plate, *, width_px: int, height_px: int) -> Cards:
    """Write a plate as FITS WCS cards.

    CRPIX is the frame's center and CRVAL its position, so that the polynomials translate term by term:
    (ξ, η) = CD · (u + A(u, v), v + B(u, v)). The inverse AP, BP is a least-squares fit, good to a small
    part of a pixel.

    Parameters
    ----------
    plate : Plate
        With its tangent point at the frame's center.

    Returns
    -------
    dict
        TAN, or TAN-SIP for degrees above 1.
    """
    center = plate.center()
    matrix = plate.matrix() / 3600.0
    sip = plate.degree > 1
    suffix = "-SIP" if sip else ""
    cards: Cards = {
        "WCSAXES": 2,
        "CTYPE1": "RA---TAN" + suffix,
        "CTYPE2": "DEC--TAN" + suffix,
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "RADESYS": "ICRS",
        "CRPIX1": plate.center_x_px + 1.0,
        "CRPIX2": plate.center_y_px + 1.0,
        "CRVAL1": center.ra_deg,
        "CRVAL2": center.dec_deg,
        "CD1_1": float(matrix[0, 0]),
        "CD1_2": float(matrix[0, 1]),
        "CD2_1": float(matrix[1, 0]),
        "CD2_2": float(matrix[1, 1]),
        "IMAGEW": width_px,
        "IMAGEH": height_px,
    }
    if sip:
        _add_sip(cards, plate, matrix, width_px, height_px)
    return cards


def _add_sip(cards: Cards, plate: Plate, matrix: Array, width_px: int, height_px: int) -> None:
    inverse = np.linalg.inv(matrix)
    cards["A_ORDER"] = cards["B_ORDER"] = plate.degree
    for (i, j), xi, eta in zip(powers(plate.degree), plate.xi, plate.eta, strict=True):
        if i + j < 2:
            continue
        a, b = inverse @ (np.array([xi, eta]) / 3600.0 / plate.unit_px ** (i + j))
        cards[f"A_{i}_{j}"], cards[f"B_{i}_{j}"] = float(a), float(b)
    order = min(plate.degree + 1, MOST_ORDER)
    unit = plate.unit_px
    u, v = (
        side.ravel()
        for side in np.meshgrid(
            np.linspace(-0.5, 0.5, GRID) * width_px, np.linspace(-0.5, 0.5, GRID) * height_px
        )
    )
    to_u, to_v = sip_distorted(cards, u, v)
    rows = np.column_stack([(to_u / unit) ** i * (to_v / unit) ** j for i, j in powers(order)])
    got = np.linalg.lstsq(rows, np.column_stack((u - to_u, v - to_v)), rcond=None)[0]
    cards["AP_ORDER"] = cards["BP_ORDER"] = order
    for (i, j), (a, b) in zip(powers(order), got, strict=True):
        cards[f"AP_{i}_{j}"], cards[f"BP_{i}_{j}"] = float(a) / unit ** (i + j), float(b) / unit ** (i + j)


def plate_from_cards(cards: Mapping[str, str | int | float], *, width_px: int, height_px: int) -> Plate:
    """Read the plate back from a solution's WCS cards; inverse of `wcs_cards`.

    Parameters
    ----------
    cards : mapping
        TAN or TAN-SIP with CRPIX at the frame's center, as a `Solution` has them.

    Raises
    ------
    BadRequest
        CRPIX isn't the center of such a frame, or a card is missing.
    """
    if not str(cards.get("CTYPE1", "")).startswith("RA---TAN"):
        raise BadRequest(f"{cards.get('CTYPE1')} is no polynomial plate", advice="use `mountnav.sky.wcs`")
    middle = ((width_px - 1) / 2.0, (height_px - 1) / 2.0)
    try:
        crpix = (float(cards["CRPIX1"]) - 1.0, float(cards["CRPIX2"]) - 1.0)
        tangent = Icrs(float(cards["CRVAL1"]), float(cards["CRVAL2"]))
        cd = np.array([[float(cards[f"CD{i}_{j}"]) for j in (1, 2)] for i in (1, 2)])
    except KeyError as missing:
        raise BadRequest(f"the WCS has no card {missing}", advice="give the cards of a solution") from None
    if max(abs(crpix[0] - middle[0]), abs(crpix[1] - middle[1])) > 1e-6:
        raise BadRequest("CRPIX is not the frame's center", advice="give the cards of a solution")
    degree = int(cards.get("A_ORDER", 1))
    unit = 0.5 * max(width_px, height_px)
    xi, eta = [], []
    for i, j in powers(degree):
        along = float(cards.get(f"A_{i}_{j}", 0.0)) + (1.0 if (i, j) == (1, 0) else 0.0)
        across = float(cards.get(f"B_{i}_{j}", 0.0)) + (1.0 if (i, j) == (0, 1) else 0.0)
        value = cd @ (along, across) * 3600.0 * unit ** (i + j) if i + j else np.zeros(2)
        xi.append(float(value[0]))
        eta.append(float(value[1]))
    return Plate(
        tangent=tangent,
        center_x_px=middle[0],
        center_y_px=middle[1],
        unit_px=unit,
        degree=degree,
        parity=-1 if np.linalg.det(cd) > 0 else 1,
        xi=np.array(xi),
        eta=np.array(eta),
    )
