"""The search area: sky tiles the size of a frame round the assumed place, nearest first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import ARCSEC_PER_RAD
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse

Array = NDArray[np.float64]

WIDEST_DEG = 60.0
"""No frame diagonal beyond this is tried: the tangent plane ends."""


def tiles(center: Icrs, radius_deg: float, step_deg: float) -> list[Icrs]:
    """Cover a circle on the sky with a hexagonal grid of places, nearest first.

    Parameters
    ----------
    center : Icrs
    radius_deg : float
        Radius of the circle, at most 60.
    step_deg : float
        Distance of neighbors.

    Returns
    -------
    list of Icrs
        The center first; every point of the circle is within step/√3 of one of them.
    """
    radius = min(radius_deg, WIDEST_DEG)
    if radius < 0.5 * step_deg:
        return [center]
    reach = int(np.ceil(radius / step_deg)) + 1
    row, column = np.mgrid[-2 * reach : 2 * reach + 1, -2 * reach : 2 * reach + 1]
    x = (column + 0.5 * row) * step_deg
    y = row * (np.sqrt(3.0) / 2) * step_deg
    distance = np.hypot(x, y).ravel()
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= radius + step_deg / np.sqrt(3.0) - 1e-9]
    # the grid is laid out in the plane, and wrapped on the sphere along great circles from the center
    stretch = np.tan(np.radians(distance[order])) / np.radians(np.maximum(distance[order], 1e-12))
    ra, dec = gnomonic_inverse(
        np.radians(x.ravel()[order]) * stretch,
        np.radians(y.ravel()[order]) * stretch,
        center.ra_deg,
        center.dec_deg,
    )
    places = [
        Icrs(float(a) % 360.0, float(d)) for a, d in zip(np.atleast_1d(ra), np.atleast_1d(dec), strict=True)
    ]
    places[0] = center
    return places


def arcsec(value_rad: Array) -> Array:
    """Radians to arcseconds."""
    return np.asarray(value_rad, dtype=float) * ARCSEC_PER_RAD
