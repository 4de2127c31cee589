"""Stars around a position at an epoch: the form in which every catalog answers; also within a polygon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.space_motion import unit_vectors
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]


class StarFlag(IntFlag):
    """What a catalog warns of; the bits of `Stars.flags`."""

    NO_PROPER_MOTION = 1
    """Stands where it was when it was observed."""
    DOUBTFUL = 2
    """The catalog itself doubts it: seen once, an artifact perhaps, a failed fit."""
    DOUBLE = 4
    """A double star or a blend: the place is a photocenter."""
    EXTENDED = 8
    """A galaxy or nebula rather than a star."""
    NO_MAGNITUDE = 16
    """`mag` is a stand-in (faint), no measurement."""
    OTHER_BAND = 32
    """`mag` is of another band than `Stars.band`, brought to it roughly: no use for photometry."""
    VARIABLE = 64
    """Known to vary."""
    STAND_IN = 128
    """`mag` is in the catalog's band, but of a coarser kind than its other magnitudes."""


@dataclass(frozen=True, slots=True)
class Stars:
    """Catalog stars, brightest first; each array has shape (n,).

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS, moved to `epoch_yr` by proper motion.
    sigma_arcsec
        One-sigma position error per coordinate at `epoch_yr`.
    mag
        Magnitude in `band`.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        Proper motion; NaN where the catalog has none.
    epoch_yr
        Julian year the positions hold for.
    band
        The photometric band of `mag`.
    source
        Which catalog.
    color_mag
        Color index `color_name`; NaN where unknown.
    flags
        Bits of `StarFlag`.
    color_name
        "B-V", "BP-RP"; empty if the catalog has no colors.
    steps
        How these stars came here, for provenance: what was asked, what failed, what was taken instead.
    """

    ra_deg: Array
    dec_deg: Array
    sigma_arcsec: Array
    mag: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    epoch_yr: float
    band: str
    source: str
    color_mag: Array = field(default_factory=lambda: np.zeros(0))
    flags: Flags = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    color_name: str = ""
    steps: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # a catalog without colors or flags needs not say so for each star
        if self.color_mag.size != self.ra_deg.size and self.color_mag.size == 0:
            object.__setattr__(self, "color_mag", np.full(self.ra_deg.size, np.nan))
        if self.flags.size != self.ra_deg.size and self.flags.size == 0:
            object.__setattr__(self, "flags", np.zeros(self.ra_deg.size, dtype=np.uint8))

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Stars:
        """Some of the stars.

        Parameters
        ----------
        chosen : ndarray of int or bool
            Which, in the order wanted.
        """
        return replace(
            self,
            ra_deg=self.ra_deg[chosen],
            dec_deg=self.dec_deg[chosen],
            sigma_arcsec=self.sigma_arcsec[chosen],
            mag=self.mag[chosen],
            pm_ra_cosdec_mas_yr=self.pm_ra_cosdec_mas_yr[chosen],
            pm_dec_mas_yr=self.pm_dec_mas_yr[chosen],
            color_mag=self.color_mag[chosen],
            flags=self.flags[chosen],
        )

    def __len__(self) -> int:
        return int(self.ra_deg.size)


class Catalog(Protocol):
    """What a catalog can do. The solver and the simulator know nothing else."""

    @property
    def name(self) -> str:
        """Name for provenance."""
        ...

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first."""
        ...


@runtime_checkable
class KnowsDepth(Protocol):
    """A catalog that can say how deep it is."""

    @property
    def faintest_mag(self) -> float:
        """Magnitude of the faintest stars that it can give; infinite if that isn't known."""
        ...


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
