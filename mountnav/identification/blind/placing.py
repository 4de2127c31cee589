"""Where a frame would lie if four of its measurements were four given stars: many quads at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.space_motion import places
from mountnav.identification.plate import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

ROUNDS = 2
"""The tangent point is the frame's center, which the fit itself finds: each round brings it nearer."""
FARTHEST = 2.0
"""The center is sought no farther from the quad than that, in radians on its tangent plane: 63°."""
LEAST_DEPTH = 0.05
"""Cosine of the angle from the tangent point beyond which nothing is seen: 87°."""


@dataclass(frozen=True, slots=True)
class Placed:
    """Similarities w = turn·z + shift (z conjugate where mirrored) of n frames; w = ξ + iη in arcsec.

    Attributes
    ----------
    axis : ndarray, shape (n, 3)
        Unit vector of the tangent point: the frame's center, nearly.
    ra_deg, dec_deg : ndarray, shape (n,)
        The same.
    turn, shift : ndarray of complex, shape (n,)
    mirrored : ndarray of bool, shape (n,)
    residual_px : ndarray, shape (n,)
        Root mean square distance of the four stars from their measurements.
    """

    axis: Array
    ra_deg: Array
    dec_deg: Array
    turn: Complex
    shift: Complex
    mirrored: NDArray[np.bool_]
    residual_px: Array

    def only(self, chosen: Index) -> Placed:
        """Some of them."""
        return Placed(
            self.axis[chosen],
            self.ra_deg[chosen],
            self.dec_deg[chosen],
            self.turn[chosen],
            self.shift[chosen],
            self.mirrored[chosen],
            self.residual_px[chosen],
        )

    def pixels(self, which: Index, vectors: Array) -> Complex:
        """Where stars fall in frames, x + iy; NaN behind the frame.

        Parameters
        ----------
        which : ndarray of int, shape (m,)
            The frame.
        vectors : ndarray, shape (m, 3)
            The star.
        """
        w = _tangential(vectors, self.axis[which], self.ra_deg[which], self.dec_deg[which])
        z = (w - self.shift[which]) / self.turn[which]
        out: Complex = np.where(self.mirrored[which], z.conj(), z)
        return out


def placed(z: Complex, vectors: Array, center: complex) -> Placed:
    """Fit similarities to four pairs each.

    Parameters
    ----------
    z : ndarray of complex, shape (n, 4)
        Measurements, x + iy in pixels.
    vectors : ndarray, shape (n, 4, 3)
        Their stars.
    center : complex
        The frame's center in pixels.

    Returns
    -------
    Placed
    """
    count = len(z)
    axis = vectors.sum(axis=1)
    axis /= np.sqrt((axis**2).sum(axis=1))[:, None]
    flat, again = vectors.reshape(-1, 3), np.repeat(np.arange(count), 4)
    ra_deg, dec_deg = places(axis.T)
    w = _tangential(flat, axis[again], ra_deg[again], dec_deg[again]).reshape(-1, 4)
    # the third corner lies to the other side of the first two, or it doesn't
    mirrored = _side(z) * _side(w) < 0.0
    seen = np.where(mirrored[:, None], z.conj(), z)
    middle = np.where(mirrored, np.conj(center), center)
    turn, shift = _similarity(seen, w)
    for _ in range(ROUNDS):
        to_center = (turn * middle + shift) / ARCSEC_PER_RAD
        # a wrong match may put the center anywhere
        to_center *= np.minimum(1.0, FARTHEST / np.maximum(np.abs(to_center), 1e-12))
        axis = _raised(to_center, axis, ra_deg, dec_deg)
        ra_deg, dec_deg = places(axis.T)
        w = _tangential(flat, axis[again], ra_deg[again], dec_deg[again]).reshape(-1, 4)
        turn, shift = _similarity(seen, w)
    off = w - turn[:, None] * seen - shift[:, None]
    residual = np.sqrt(np.mean(off.real**2 + off.imag**2, axis=1)) / np.abs(turn)
    return Placed(axis, ra_deg, dec_deg, turn, shift, mirrored, residual)


def _similarity(z: Complex, w: Complex) -> tuple[Complex, Complex]:
    """Least squares fit of w = turn·z + shift for each row."""
    z_mean, w_mean = z.mean(axis=1), w.mean(axis=1)
    dz, dw = z - z_mean[:, None], w - w_mean[:, None]
    turn: Complex = (dz.conj() * dw).sum(axis=1) / (dz.real**2 + dz.imag**2).sum(axis=1)
    return turn, w_mean - turn * z_mean


def _side(place: Complex) -> Array:
    side: Array = ((place[:, 1] - place[:, 0]).conj() * (place[:, 2] - place[:, 0])).imag
    return side


def _axes(ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """East and north at places."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    east = np.stack((-sin_ra, cos_ra, np.zeros_like(ra)), axis=1)
    return east, np.stack((-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec), axis=1)


def _tangential(vectors: Array, axis: Array, ra_deg: Array, dec_deg: Array) -> Complex:
    """ξ + iη in arcsec of stars about as many tangent points."""
    east, north = _axes(ra_deg, dec_deg)
    depth = np.einsum("nc,nc->n", vectors, axis)
    stretch = np.where(depth > LEAST_DEPTH, ARCSEC_PER_RAD / np.maximum(depth, LEAST_DEPTH), np.nan)
    xi = np.einsum("nc,nc->n", vectors, east)
    eta = np.einsum("nc,nc->n", vectors, north)
    w: Complex = xi * stretch + 1j * (eta * stretch)
    return w


def _raised(middle: Complex, axis: Array, ra_deg: Array, dec_deg: Array) -> Array:
    """Unit vectors of tangential coordinates, radians."""
    east, north = _axes(ra_deg, dec_deg)
    moved = axis + middle.real[:, None] * east + middle.imag[:, None] * north
    moved /= np.sqrt((moved**2).sum(axis=1))[:, None]
    return moved
