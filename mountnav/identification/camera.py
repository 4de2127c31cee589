"""A plate fit that knows what cameras do: distortions are small, smooth and mostly radial.

A free polynomial through few stars, or through stars in one corner, is wild elsewhere. Here each distortion
term has an expected size, found by evidence. Where pairs are many and everywhere this is the plain
least-squares polynomial; where they say nothing a term stays near zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.distortion import BASES, WIDTHS
from mountnav.identification.evidence import Belief, NormalEquations
from mountnav.identification.plate import Plate

Array = NDArray[np.float64]

TAIL_Z2 = 8.0
"""Pairs with a squared deviation (both coordinates, in sigma²) beyond this lose weight: 2 % of the honest."""
ROUNDS = 4


@dataclass(frozen=True, slots=True)
class CameraFit:
    """A plate fitted to pairs.

    Attributes
    ----------
    plate : Plate
    belief : Belief
    sigma_arcsec : ndarray, shape (n,)
        Error per coordinate with which each pair went in: known, extra, and more for pairs in the tails.
    apart_arcsec : ndarray, shape (n,)
        Distance of each pair from a plate that was fit without it (leave-one-out); exact for one strength of
        distortion, to a few percent for the average over several.
    leverage : ndarray, shape (n,)
        How much each pair holds the plate at its own place, mean of both coordinates.
    center_covariance_arcsec2 : ndarray, shape (2, 2)
        East and north, scaled up by the residuals.
    """

    plate: Plate
    belief: Belief
    sigma_arcsec: Array
    apart_arcsec: Array
    leverage: Array
    center_covariance_arcsec2: Array


def similarity_part(plate: Plate) -> Array:
    """The plate's matrix without its shear, arcsec per half frame; shape (2, 2)."""
    matrix = plate.matrix() * plate.unit_px
    s = float(-plate.parity)
    p, q = 0.5 * (matrix[0, 0] + s * matrix[1, 1]), 0.5 * (matrix[1, 0] - s * matrix[0, 1])
    return np.array([[p, -s * q], [q, s * p]])


def fit_camera(
    like: Plate,
    x_px: Array,
    y_px: Array,
    xi: Array,
    eta: Array,
    known_arcsec: Array,
    degree: int,
    *,
    floor_px: float,
    belief: Belief | None = None,
) -> CameraFit:
    """Fit a plate of a degree.

    Parameters
    ----------
    like : Plate
        Gives tangent point, center, parity, and where to start.
    x_px, y_px : ndarray, shape (n,)
        Measured pixels.
    xi, eta : ndarray, shape (n,)
        Tangential coordinates of the stars about `like.tangent`, arcsec.
    known_arcsec : ndarray, shape (n,)
        Error per coordinate of each pair, as far as centroid and catalog tell.
    degree : int
        0 (similarity) to 3.
    floor_px : float
        What the error beyond the known is expected to be.
    belief : Belief, optional
        Of an earlier fit, to be kept.

    Returns
    -------
    CameraFit
    """
    basis, unit = BASES[degree], like.unit_px
    u, v = (x_px - like.center_x_px) / unit, (y_px - like.center_y_px) / unit
    frame = similarity_part(like)
    scale = float(np.sqrt(abs(np.linalg.det(frame))))
    back = np.linalg.inv(frame)
    target = back @ np.vstack((xi - like.xi[0], eta - like.eta[0]))
    off = target - np.vstack((u, v))
    known2 = (known_arcsec / scale) ** 2
    design = basis.design(u, v, degree)
    start = np.vstack(like.tangential(x_px, y_px)) - np.vstack((xi, eta))
    distance2 = (start**2).sum(axis=0) / scale**2
    spread2 = 0.5 * float(np.median(distance2)) / np.log(2.0)
    trust = _trust(distance2, known2 + spread2)
    held = belief
    equations = NormalEquations(design, off, known2, unit)
    for _ in range(ROUNDS):
        if belief is None or held is None:
            held = equations.most_probable(trust, WIDTHS[degree], floor_px, held)
        answer = equations.answer(trust, held)
        residual = off - design @ answer.parameters
        sigma2 = known2 + (held.extra_px / unit) ** 2
        before, trust = trust, _trust((residual**2).sum(axis=0), sigma2)
        if np.abs(trust - before).max() < 1e-3:
            break
    assert held is not None
    answer = equations.answer(trust, held)
    residual = off - design @ answer.parameters
    sigma2 = (known2 + (held.extra_px / unit) ** 2) / trust
    x, y = basis.x @ answer.parameters, basis.y @ answer.parameters
    x[1] += 1.0
    y[2] += 1.0
    plate = replace(
        like,
        degree=degree,
        xi=frame[0, 0] * x + frame[0, 1] * y,
        eta=frame[1, 0] * x + frame[1, 1] * y,
    )
    plate.xi[0] += like.xi[0]
    plate.eta[0] += like.eta[0]
    matrix = plate.matrix()
    plate = replace(plate, parity=-1 if np.linalg.det(matrix) > 0 else 1)
    used = float((design * (design @ answer.smoother)).sum(axis=2).sum(axis=0) @ (1.0 / sigma2))
    at_center = answer.covariance[:2, :2] * _excess((residual**2).sum(axis=0) / sigma2, used)
    hat = _hat(design, answer.smoother, sigma2)
    return CameraFit(
        plate=plate,
        belief=held,
        sigma_arcsec=np.sqrt(sigma2) * scale,
        apart_arcsec=_apart(hat, residual) * scale,
        leverage=0.5 * np.einsum("nii->n", hat),
        center_covariance_arcsec2=frame @ at_center @ frame.T,
    )


def _trust(distance2: Array, sigma2: Array) -> Array:
    """Weights against long tails (blends, neighbors), shape (n,): 1 in the bell, beyond it as z⁻²."""
    return np.asarray(np.minimum(1.0, TAIL_Z2 * sigma2 / np.maximum(distance2, 1e-300)))


def _excess(z2: Array, used: float) -> float:
    """How much larger the residuals are than the errors say; never below 1, and more careful with few pairs.

    With f degrees of freedom left the true variance is uncertain by a factor; its mean is f/(f − 2).
    """
    free = max(2.0 * z2.size - used, 1.0)
    return max(1.0, float(z2.sum()) / free) * (free + 2.0) / free


def _hat(design: Array, smoother: Array, sigma2: Array) -> Array:
    """The 2 × 2 blocks on the hat matrix' diagonal, shape (n, 2, 2)."""
    rows = design.transpose(1, 0, 2)
    return np.asarray(rows @ smoother @ rows.transpose(0, 2, 1) / sigma2[:, None, None])


def _apart(hat: Array, residual: Array) -> Array:
    """Leave-one-out distances: (1 − H)⁻¹ residual; shape (n,)."""
    rest = np.eye(2) * (1.0 + 1e-9) - hat
    return np.asarray(np.linalg.norm(np.linalg.solve(rest, residual.T[:, :, None])[:, :, 0], axis=1))
