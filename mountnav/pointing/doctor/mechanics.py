"""Where a mount with geometry errors looks, for many observations at once: rotations, exact at any size.

The tests hold it against `mountnav.simulation.geometry`. What `mountnav.pointing.model.rigorous` lacks, and
the doctor lives on: many sets of terms at once (derivatives of a fit in one call), and the image's direction
carried along - the solved rotation tells of the polar axis what the place alone does not.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mountnav.pointing.doctor.facts import Array, wrapped

GLOBAL = ("CH", "NP", "ME", "MA", "TF", "TX")


def _turned(a: Array, b: Array, angle: Array) -> tuple[Array, Array]:
    c, s = np.cos(angle), np.sin(angle)
    return a * c - b * s, a * s + b * c


def looks_at(lon: Array, lat: Array, terms: Array, axis_latitude: float) -> tuple[Array, Array]:
    """Direction of the tube and of its "up" for axis angles.

    Parameters
    ----------
    lon, lat : ndarray, shape (..., n)
        Axis angles, zero points included; beyond the pole past 90°.
    terms : ndarray, shape (..., 6)
        CH NP ME MA TF TX, rad [POINTING §5].
    axis_latitude : float

    Returns
    -------
    tube, up : ndarray, shape (..., n, 3)
    """
    ch, np_, me, ma, tf, tx = (terms[..., number, None] for number in range(6))
    zero = np.zeros(np.broadcast_shapes(lon.shape, ch.shape))
    tube = _through(np.cos(ch) + zero, np.sin(ch) + zero, zero, lon, lat, np_, me, ma)
    up = _through(zero, zero, zero + 1.0, lon, lat, np_, me, ma)
    zenith = np.array([math.cos(axis_latitude), 0.0, math.sin(axis_latitude)])
    cos_z = tube @ zenith
    away = tube * cos_z[..., None] - zenith
    # sunk by TF sin z and TX tan z
    sunk = tube + (tf + tx / np.maximum(cos_z, 0.05))[..., None] * away
    return sunk / np.linalg.norm(sunk, axis=-1, keepdims=True), up


def _through(x: Any, y: Any, z: Any, lon: Any, lat: Any, np_: Any, me: Any, ma: Any) -> Array:
    x, z = _turned(x, z, lat)
    z, y = _turned(z, y, np_)
    x, y = _turned(x, y, lon)
    x, z = _turned(x, z, me)
    y, z = _turned(y, z, ma)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


class Sky:
    """The tangent planes of the places seen, in which misses are counted."""

    def __init__(self, lon: Array, lat: Array, turned: Array) -> None:
        sin_lon, cos_lon, sin_lat, cos_lat = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
        self.seen = np.column_stack((cos_lat * cos_lon, cos_lat * sin_lon, sin_lat))
        self.west = np.column_stack((-sin_lon, cos_lon, np.zeros_like(lon)))
        self.north = np.column_stack((-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat))
        self.turned = turned

    def misses(self, tube: Array, up: Array) -> tuple[Array, Array, Array]:
        """Predicted minus seen: west, north, and image angle (camera's own angle still in it), rad."""
        west = np.einsum("...ni,ni->...n", tube, self.west)
        north = np.einsum("...ni,ni->...n", tube, self.north)
        along = np.einsum("...ni,ni->...n", tube, self.seen)
        sine = np.hypot(west, north)
        stretch = np.where(sine > 1e-9, np.arctan2(sine, along) / np.maximum(sine, 1e-12), 1.0)
        angle = np.arctan2(
            -np.einsum("...ni,ni->...n", up, self.west), np.einsum("...ni,ni->...n", up, self.north)
        )
        return west * stretch, north * stretch, wrapped(angle - self.turned)
