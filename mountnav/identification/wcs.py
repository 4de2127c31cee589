"""FITS cards of a plate, TAN or TAN-SIP; CRPIX counts from 1. `mountnav.sky.wcs` reads them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import Plate, powers
from mountnav.sky.wcs import distorted

Array = NDArray[np.float64]
Cards = dict[str, str | int | float]

GRID = 21
"""The inverse polynomials are fit on so many points per side."""


def wcs_cards(plate: Plate, *, width_px: int, height_px: int) -> Cards:
    """Write a plate as FITS WCS cards.

    CRPIX is the frame's center and CRVAL its place, so that the polynomials translate term by term:
    (ξ, η) = CD · (u + A(u, v), v + B(u, v)). The inverse AP, BP is a least-squares fit, good to a small
    part of a pixel.

    Parameters
    ----------
    plate : Plate
        With its tangent point at the frame's center.
    width_px, height_px : int

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
    order = plate.degree + 1
    unit = plate.unit_px
    u, v = (
        side.ravel()
        for side in np.meshgrid(
            np.linspace(-0.5, 0.5, GRID) * width_px, np.linspace(-0.5, 0.5, GRID) * height_px
        )
    )
    to_u, to_v = distorted(cards, u, v)
    rows = np.column_stack([(to_u / unit) ** i * (to_v / unit) ** j for i, j in powers(order)])
    got = np.linalg.lstsq(rows, np.column_stack((u - to_u, v - to_v)), rcond=None)[0]
    cards["AP_ORDER"] = cards["BP_ORDER"] = order
    for (i, j), (a, b) in zip(powers(order), got, strict=True):
        cards[f"AP_{i}_{j}"], cards[f"BP_{i}_{j}"] = float(a) / unit ** (i + j), float(b) / unit ** (i + j)
