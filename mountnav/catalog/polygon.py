"""Stars in a convex polygon on the sphere, such as a frame's corners make: a cone, then half-spaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import Catalog, Stars
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

WIDEST_RAD = np.radians(89.0)
"""From the middle to a corner; from 90° on, "inside" has no meaning."""
_ROUNDING = 1e-12
"""Two micro-arcseconds: a star on an edge is inside."""


def stars_in_polygon(
    catalog: Catalog, corners: Sequence[Icrs], *, epoch_yr: float, mag_limit: float | None = None
) -> Stars:
    """Stars within a polygon whose edges are great circles, brightest first.

    Parameters
    ----------
    catalog : Catalog
    corners : sequence of Icrs
        At least three, in either winding. The polygon must be convex, as a frame's is, and fit into a cone of
        89° round the middle of its corners; poles and RA 0 are nothing special.
    epoch_yr : float
        Julian year of the positions.
    mag_limit : float, optional
        Faintest magnitude that is wanted, inclusive.

    Returns
    -------
    Stars
        Those on an edge included.

    Raises
    ------
    BadRequest
        The corners make no convex polygon.
    """
    axis, radius_rad, inward = _half_spaces(corners)
    center = Icrs(
        float(np.degrees(np.arctan2(axis[1], axis[0])) % 360.0),
        float(np.degrees(np.arctan2(axis[2], np.hypot(axis[0], axis[1])))),
    )
    # 1 mas more than the corners: a corner is inside, whatever rounding makes of the center
    radius_deg = float(np.degrees(radius_rad)) + 1.0 / 3.6e6
    stars = catalog.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
    vectors = unit_vectors(stars.ra_deg, stars.dec_deg)
    return stars.only(np.all(inward @ vectors >= -_ROUNDING, axis=0))


def _half_spaces(corners: Sequence[Icrs]) -> tuple[Array, float, Array]:
    """Middle of the corners, distance of the farthest [rad], and the normals of the edges, shape (n, 3)."""
    places = np.array([(corner.ra_deg, corner.dec_deg) for corner in corners], dtype=np.float64)
    if len(corners) < 3 or not np.all(np.isfinite(places)) or bool(np.any(np.abs(places[:, 1]) > 90.0)):
        raise _refused("needs at least three corners, finite, with declinations within -90..90")
    points = unit_vectors(places[:, 0], places[:, 1]).T
    middle = points.sum(axis=0)
    length = float(np.linalg.norm(middle))
    if length < 1e-6:
        raise _refused("is larger than a hemisphere")
    axis = middle / length
    chords = np.linalg.norm(points - axis, axis=1)
    radius_rad = float(2.0 * np.arcsin(np.clip(chords.max() / 2.0, 0.0, 1.0)))
    if radius_rad > WIDEST_RAD:
        raise _refused("is larger than a hemisphere")
    following = np.roll(points, -1, axis=0)
    normals = np.cross(points, following)
    lengths = np.linalg.norm(normals, axis=1)
    if bool(np.any(lengths < 1e-9)):
        raise _refused("has two corners at one place")
    normals /= lengths[:, np.newaxis]
    normals *= np.sign(normals[0] @ axis) or 1.0
    # convex: no corner beyond an edge, and the edges go round the middle once, not twice as in a star
    turns = np.arctan2(
        np.cross(points, following) @ axis,
        (points * following).sum(axis=1) - (points @ axis) * (following @ axis),
    )
    once = abs(abs(float(turns.sum())) - 2.0 * np.pi) < 1e-6
    if bool(np.any(normals @ points.T < -1e-9)) or bool(np.any(normals @ axis <= 0.0)) or not once:
        raise _refused("isn't convex: the corners must be in order, and none of them be pushed in")
    return axis, radius_rad, normals


def _refused(why: str) -> BadRequest:
    return BadRequest(f"the polygon {why}", advice="give a frame's corners one after the other")
