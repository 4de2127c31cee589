"""The plate: polynomials from pixels to tangential coordinates, fit and inverse [S23 eq. 5-8, 19]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic, gnomonic_inverse
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SIMILARITY = 0
"""Degree that stands for a similarity: four parameters, for frames with a handful of stars."""
CUBIC = 3
"""The highest degree that is fit whole; of the fifth a plate may have the radial term besides."""
INVERSE_PX = 1e-7
"""Newton's steps of the inverse end when one is smaller than this, pixels: far below any centroid's error,
far above double precision."""
INVERSE_STEPS = 30
"""Steps of the inverse at most. Lenses bent by a tenth need some 15, others 3."""
NAMES = ("similarity", "linear", "quadratic", "cubic")


def powers(degree: int) -> list[tuple[int, int]]:
    """Exponents (i, j) of x and y, by rising degree: (0,0), (1,0), (0,1), (2,0), ..."""
    top = max(degree, 1)
    return [(total - j, j) for total in range(top + 1) for j in range(total + 1)]


def products(u: Array, v: Array, degree: int) -> Array:
    """Monomials u^i v^j in the order of `powers`, each from a lower one; shape (len(powers(degree)), n)."""
    top = max(degree, 1)
    rows = np.empty(((top + 1) * (top + 2) // 2, u.size))
    rows[0] = 1.0
    lower = 0
    for total in range(1, top + 1):
        start = lower + total
        np.multiply(rows[lower:start], u, out=rows[start : start + total])
        np.multiply(rows[start - 1], v, out=rows[start + total])
        lower = start
    return rows


@dataclass(frozen=True, slots=True)
class Plate:
    """A plate model about a frame's center.

    Attributes
    ----------
    tangent : Icrs
        Tangent point.
    center_x_px, center_y_px : float
        The frame's geometric center, 0-based.
    unit_px : float
        Pixels are divided by this, so that powers stay tame.
    degree : int
        0 similarity, 1 linear, 2 quadratic, 3 cubic, 5 for a cubic with a lens' fifth order; more for a lens
        that is written as a polynomial.
    parity : int
        +1 sky as seen, -1 mirrored.
    xi, eta : ndarray, shape (len(powers(degree)),)
        Coefficients, arcsec.
    """

    tangent: Icrs
    center_x_px: float
    center_y_px: float
    unit_px: float
    degree: int
    parity: int
    xi: Array
    eta: Array

    def tangential(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """Tangential coordinates ξ, η (arcsec, shape (n,)) of pixels (0-based)."""
        u, v = (x_px - self.center_x_px) / self.unit_px, (y_px - self.center_y_px) / self.unit_px
        rows = products(u, v, self.degree)
        return self.xi @ rows, self.eta @ rows

    def matrix(self) -> Array:
        """Derivatives at the center, arcsec per pixel: [[dξ/dx, dξ/dy], [dη/dx, dη/dy]]."""
        return np.array([self.xi[1:3], self.eta[1:3]]) / self.unit_px

    def pixels(self, xi: Array, eta: Array) -> tuple[Array, Array]:
        """Invert `tangential` by Newton steps; shape (n,) each, NaN stays NaN."""
        inverse = np.linalg.inv(self.matrix())
        x = self.center_x_px + inverse[0, 0] * (xi - self.xi[0]) + inverse[0, 1] * (eta - self.eta[0])
        y = self.center_y_px + inverse[1, 0] * (xi - self.xi[0]) + inverse[1, 1] * (eta - self.eta[0])
        if self.degree <= 1:
            return x, y
        # far outside the frame a polynomial means nothing: leave the linear guess there
        reach = 1.5 * self.unit_px
        near = np.flatnonzero((np.abs(x - self.center_x_px) < reach) & (np.abs(y - self.center_y_px) < reach))
        if near.size == 0:
            return x, y
        near_x, near_y, near_xi, near_eta = x[near], y[near], xi[near], eta[near]
        for _ in range(INVERSE_STEPS):
            got_xi, got_eta = self.tangential(near_x, near_y)
            dxi, deta = near_xi - got_xi, near_eta - got_eta
            dx = inverse[0, 0] * dxi + inverse[0, 1] * deta
            dy = inverse[1, 0] * dxi + inverse[1, 1] * deta
            near_x += dx
            near_y += dy
            # each step shrinks by the distortion's share: what is left to go is less than the last step
            if max(np.abs(dx).max(), np.abs(dy).max()) < INVERSE_PX:
                break
        x[near], y[near] = near_x, near_y
        return x, y

    def project(self, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
        """Tangential coordinates ξ, η (arcsec) of positions on the sky; NaN behind."""
        xi, eta = gnomonic(ra_deg, dec_deg, self.tangent.ra_deg, self.tangent.dec_deg)
        return np.asarray(xi) * ARCSEC_PER_RAD, np.asarray(eta) * ARCSEC_PER_RAD

    def center(self) -> Icrs:
        """The place of the frame's geometric center."""
        ra, dec = gnomonic_inverse(
            float(self.xi[0]) / ARCSEC_PER_RAD,
            float(self.eta[0]) / ARCSEC_PER_RAD,
            self.tangent.ra_deg,
            self.tangent.dec_deg,
        )
        return Icrs(float(ra) % 360.0, float(dec))

    def scale_arcsec_px(self) -> float:
        """sqrt(|det|) of the matrix at the center."""
        return float(np.sqrt(abs(self.xi[1] * self.eta[2] - self.xi[2] * self.eta[1]))) / self.unit_px

    def rotation_deg(self) -> float:
        """Position angle of the +y axis, east of north, in [0, 360)."""
        matrix = self.matrix()
        return float(np.degrees(np.arctan2(matrix[0, 1], matrix[1, 1])) % 360.0)

    def turned(self, turn: complex, shift: complex) -> Plate:
        """The plate after w → turn·w + shift of its tangential coordinates w = ξ + iη (arcsec)."""
        w = turn * (self.xi + 1j * self.eta)
        w[0] += shift
        return replace(self, xi=np.array(w.real), eta=np.array(w.imag))

    def moved_to(self, tangent: Icrs) -> Plate:
        """The same plate with another tangent point: right at the center to first order; to be fit again."""
        here = replace(self, tangent=tangent)
        step = np.array([0.0, 1.0, 1.0]) / self.unit_px
        xi, eta = self.xi[0] + step * self.xi[:3], self.eta[0] + step * self.eta[:3]
        ra, dec = gnomonic_inverse(
            xi / ARCSEC_PER_RAD, eta / ARCSEC_PER_RAD, self.tangent.ra_deg, self.tangent.dec_deg
        )
        new_xi, new_eta = here.project(np.asarray(ra), np.asarray(dec))
        out_xi, out_eta = self.xi.copy(), self.eta.copy()
        for out, new in ((out_xi, new_xi), (out_eta, new_eta)):
            out[0] = new[0]
            out[1:3] = (new[1:3] - new[0]) * self.unit_px
        return replace(here, xi=out_xi, eta=out_eta)


def similarity_plate(
    tangent: Icrs, turn: complex, shift: complex, *, mirrored: bool, width_px: int, height_px: int
) -> Plate:
    """Make a plate of w = turn·z + shift, with z = x + iy (or x − iy if mirrored), w = ξ + iη in arcsec."""
    cx, cy, unit = (width_px - 1) / 2, (height_px - 1) / 2, 0.5 * max(width_px, height_px)
    sign = -1.0 if mirrored else 1.0
    middle = turn * complex(cx, sign * cy) + shift
    along_x, along_y = turn * unit, turn * complex(0, sign) * unit
    return Plate(
        tangent=tangent,
        center_x_px=cx,
        center_y_px=cy,
        unit_px=unit,
        degree=SIMILARITY,
        parity=-1 if along_x.real * along_y.imag - along_y.real * along_x.imag > 0 else 1,
        xi=np.array([middle.real, along_x.real, along_y.real]),
        eta=np.array([middle.imag, along_x.imag, along_y.imag]),
    )


def constants(
    z: NDArray[np.complex128], w: NDArray[np.complex128], scales: tuple[float, float], skew_max: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.bool_], Index]:
    """Six plate constants of each triangle pair, kept where they are all but a similarity.

    With z = x + iy and w = ξ + iη the six constants of [S23 eq. 5-8] are w = p·z + q·conj(z) + c. A camera
    has |q| ≪ |p| (sky mirrored: the other way round); a chance pair of triangles seldom does.

    Parameters
    ----------
    z, w : ndarray of complex, shape (n, 3)
        Corners in pixels and in arcsec.
    scales : (float, float)
        Bounds of the scale.
    skew_max : float
        Largest |q|/|p|.

    Returns
    -------
    turn, shift : ndarray of complex, shape (k,)
        w = turn·z + shift, or turn·conj(z) + shift where `mirrored`.
    mirrored : ndarray of bool, shape (k,)
        True: the plate mirrors.
    kept : ndarray of int, shape (k,)
        Which of the n pairs these are.
    """
    e1, e2, f1, f2 = z[:, 1] - z[:, 0], z[:, 2] - z[:, 0], w[:, 1] - w[:, 0], w[:, 2] - w[:, 0]
    determinant = e1 * e2.conj() - e1.conj() * e2
    p = (f1 * e2.conj() - f2 * e1.conj()) / determinant
    q = (e1 * f2 - e2 * f1) / determinant
    mirrored = np.abs(q) > np.abs(p)
    turn = np.where(mirrored, q, p)
    skew = np.abs(np.where(mirrored, p, q)) / np.abs(turn)
    scale = np.abs(turn)
    good = (skew <= skew_max) & (scale >= scales[0]) & (scale <= scales[1])
    turn, mirrored, z, w = turn[good], mirrored[good], z[good], w[good]
    seen = np.where(mirrored[:, None], z.conj(), z)
    return turn, w.mean(axis=1) - turn * seen.mean(axis=1), mirrored, np.flatnonzero(good)


def fit_plate(
    like: Plate, x_px: Array, y_px: Array, xi: Array, eta: Array, sigma: Array, degree: int
) -> Plate:
    """Fit a plate by weighted least squares.

    Parameters
    ----------
    like : Plate
        Gives tangent point, center, unit and parity.
    x_px, y_px : ndarray, shape (n,)
        Measured pixels.
    xi, eta : ndarray, shape (n,)
        Tangential coordinates of the stars about `like.tangent`, arcsec.
    sigma : ndarray, shape (n,)
        One-sigma error of a pair, arcsec.
    degree : int
        0 (similarity) to 3.
    """
    u, v = (x_px - like.center_x_px) / like.unit_px, (y_px - like.center_y_px) / like.unit_px
    weight = 1.0 / sigma
    if degree == SIMILARITY:
        # ξ = a + p·u − s·q·v, η = b + q·u + s·p·v; s = −1 for the sky as seen (east left, north up)
        s = float(-like.parity)
        zero, one = np.zeros_like(u), np.ones_like(u)
        rows = np.vstack((np.column_stack((one, zero, u, -s * v)), np.column_stack((zero, one, s * v, u))))
        both = np.concatenate((weight, weight))
        answer = np.linalg.lstsq(rows * both[:, None], np.concatenate((xi, eta)) * both, rcond=None)[0]
        a, b, p, q = (float(value) for value in answer)
        return replace(like, degree=degree, xi=np.array([a, p, -s * q]), eta=np.array([b, q, s * p]))
    rows = products(u, v, degree).T * weight[:, None]
    got: Array = np.asarray(
        np.linalg.lstsq(rows, np.column_stack((xi, eta)) * weight[:, None], rcond=None)[0], dtype=np.float64
    )
    matrix = got[1:3].T
    return replace(
        like,
        degree=degree,
        parity=-1 if np.linalg.det(matrix) > 0 else 1,
        xi=np.array(got[:, 0]),
        eta=np.array(got[:, 1]),
    )
