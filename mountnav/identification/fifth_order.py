"""The fifth order of a lens' radial distortion, beside a cubic plate.

A lens that puts a star at r (1 + k r²) is a cubic from the sky to the pixels. From the pixels to the sky, as
a plate goes, it has a term -k r³ and one of 3 k² r⁵: 0.13 px in the corners of a frame of 12° whose lens
bends by 0.4 %. A cubic takes most of that up, and leaves some thousandths of a pixel: as much as the photons
of a thousand stars do. Real lenses have a fifth order of their own besides. So it is one number more,
expected where lenses have it, and measured as far as the pairs tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import CUBIC, Plate, products

Array = NDArray[np.float64]

LEAST_PAIRS = 100
"""With fewer pairs a cubic's own terms are known worse than what a fifth order adds. Halved, fields with few
stars come out neither better nor worse."""
EXPECTED, EXPECTED_SIGMA = 1.5, 2.0
"""The term in units of k², and how far off that may be. It is 3.0 for a lens of the third order alone, 1.2
for equidistant ones, 1.3 for equisolid, 1.0 for stereographic ones. Doubled, noise comes in where pairs are
few; halved, some lenses would be held to what they aren't."""
LEAST_CORNER_PX = 0.001
"""A term that moves no corner by more stays out: no measurement tells it, and the polynomial is shorter."""
FIFTH = 5
"""Degree of the polynomials that hold the term, r⁴ times the place: nothing to be chosen."""


@dataclass(frozen=True, slots=True)
class FifthOrder:
    """A plate with the term.

    Attributes
    ----------
    plate : Plate
        Of degree 5.
    leverage : ndarray, shape (n,)
        How much each pair holds the term, to be added to that of the cubic.
    center_covariance_arcsec2 : ndarray, shape (2, 2)
        What its error adds to that of the center.
    """

    plate: Plate
    leverage: Array
    center_covariance_arcsec2: Array


def fifth_order(
    plate: Plate,
    x_px: Array,
    y_px: Array,
    dxi_arcsec: Array,
    deta_arcsec: Array,
    sigma_arcsec: Array,
) -> FifthOrder | None:
    """Add the term to a cubic plate.

    The term is fit beside all terms of a cubic, so that what a cubic can say stays with the plate.

    Parameters
    ----------
    plate : Plate
        As fit to the pairs.
    x_px, y_px : ndarray, shape (n,)
        Measured pixels of the pairs.
    dxi_arcsec, deta_arcsec : ndarray, shape (n,)
        Their residuals, measured minus catalog.
    sigma_arcsec : ndarray, shape (n,)
        Their errors per coordinate.

    Returns
    -------
    FifthOrder or None
        None where the plate is no cubic, has few pairs, or the term is next to nothing.
    """
    if plate.degree != CUBIC or x_px.size < LEAST_PAIRS:
        return None
    unit = plate.unit_px
    matrix = plate.matrix() * unit
    u, v = (x_px - plate.center_x_px) / unit, (y_px - plate.center_y_px) / unit
    weight = abs(float(np.linalg.det(matrix))) / sigma_arcsec**2
    cubic = products(u, v, CUBIC)
    quartic = (u**2 + v**2) ** 2
    # residuals and term, each without what a cubic can say: columns are x, y of both
    off = np.linalg.solve(matrix, np.stack((dxi_arcsec, deta_arcsec)))
    sides = np.column_stack((*off, u * quartic, v * quartic))
    weighted = cubic * weight
    coefficients = np.linalg.solve(weighted @ cubic.T, weighted @ sides)
    left = sides - cubic.T @ coefficients
    residual, term = left[:, :2], left[:, 2:]
    held = (weight[:, None] * term**2).sum(axis=1)
    whole = float(held.sum())
    if not whole > 0.0:
        return None
    seen = float((weight[:, None] * term * residual).sum()) / whole
    free = 2 * x_px.size - coefficients.size // 2 - 1
    excess = max(1.0, float((weight[:, None] * (residual - seen * term) ** 2).sum()) / free)
    # the radial part of the plate's third order, in the mean over the ways to tell it
    x, y = np.linalg.solve(matrix, np.stack((plate.xi, plate.eta)))[:, 6:10]
    k2 = float(0.25 * (x[0] + x[2] + y[1] + y[3])) ** 2
    # residuals are measured minus catalog: what the plate lacks, with the other sign
    told, expected = whole / excess, 1.0 / max(EXPECTED_SIGMA * k2, 1e-12) ** 2
    size = (told * seen - expected * EXPECTED * k2) / (told + expected)
    error = (told + expected) ** -0.5
    corner = _corner(coefficients[:, 2:], (plate.center_x_px + 0.5) / unit, (plate.center_y_px + 0.5) / unit)
    if abs(size) * corner * unit < LEAST_CORNER_PX:
        return None
    # the measured side is too large by the term
    bent = np.zeros((2, products(np.zeros(1), np.zeros(1), FIFTH).shape[0]))
    bent[:, : cubic.shape[0]] = -coefficients[:, 2:].T
    # r⁴ u = u⁵ + 2 u³ v² + u v⁴, and so in v: the last six of the monomials are u⁵, u⁴ v, ... v⁵
    bent[0, -6:] += (1.0, 0.0, 2.0, 0.0, 1.0, 0.0)
    bent[1, -6:] += (0.0, 1.0, 0.0, 2.0, 0.0, 1.0)
    change = matrix @ (size * bent)
    lengthened = np.zeros_like(change)
    lengthened[:, : cubic.shape[0]] = plate.xi, plate.eta
    xi, eta = lengthened - change
    middle = matrix @ bent[:, 0] * error
    leverage = 0.5 * held / whole * told / (told + expected)
    return FifthOrder(replace(plate, degree=FIFTH, xi=xi, eta=eta), leverage, np.outer(middle, middle))


def _corner(cubic_part: Array, u: float, v: float) -> float:
    """The largest length of the term, without its cubic part, in the corners."""
    across, up = np.array([u, u, -u, -u]), np.array([v, -v, v, -v])
    quartic = (across**2 + up**2) ** 2
    term = np.stack((across * quartic, up * quartic)) - cubic_part.T @ products(across, up, CUBIC)
    return float(np.hypot(*term).max())
