"""Where the doctor looks: evenly over the sky that a telescope reaches, and near galactic pole and plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.star_counts import galactic

Array = NDArray[np.float64]

PLACES = 3000
"""Of the reachable sky: a share of 1 % is then known to 0.2 %."""
FIRST = 300
"""So many of them are looked at in full first, spread over all of it; often they are enough."""
OF_A_REGION = 60
POLE_DEG = 75.0
"""Galactic latitudes beyond this count as the pole."""
PLANE_DEG = 5.0
"""Galactic latitudes within this count as the plane."""
_GOLDEN_DEG = 180.0 * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, slots=True)
class Places:
    """Frame centers and how the frames are turned; each array has shape (n,).

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS.
    rotation_deg
        Position angle of the frame's +y axis.
    """

    ra_deg: Array
    dec_deg: Array
    rotation_deg: Array

    def __len__(self) -> int:
        return int(self.ra_deg.size)

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_] | slice) -> Places:
        """Some of the places."""
        return Places(self.ra_deg[chosen], self.dec_deg[chosen], self.rotation_deg[chosen])


@dataclass(frozen=True, slots=True)
class Reach:
    """The band of declinations that a telescope reaches; the sky beyond never rises high enough.

    Attributes
    ----------
    low_dec_deg, high_dec_deg : float
    """

    low_dec_deg: float = -90.0
    high_dec_deg: float = 90.0

    @property
    def sky_share(self) -> float:
        """Share of the whole sky."""
        return 0.5 * (math.sin(math.radians(self.high_dec_deg)) - math.sin(math.radians(self.low_dec_deg)))


def reach_of(latitude_deg: float, min_altitude_deg: float) -> Reach:
    """What a telescope reaches: declinations whose highest altitude is above the limit.

    Parameters
    ----------
    latitude_deg : float
        Of the site, north positive.
    min_altitude_deg : float
        Nothing is pointed at below this.

    Returns
    -------
    Reach
        Without refraction, which matters by half a degree at the horizon.
    """
    # a limit at the zenith still leaves a sliver, so that there is something to count
    span_deg = max(90.0 - min_altitude_deg, 0.1)
    return Reach(max(latitude_deg - span_deg, -90.0), min(latitude_deg + span_deg, 90.0))


def spread_places(reach: Reach, count: int = PLACES, first: int = FIRST) -> Places:
    """Spread places evenly over a band of the sky, in a golden spiral.

    Parameters
    ----------
    reach : Reach
    count : int
    first : int
        So many of them, spread over all of the band again, come first.

    Returns
    -------
    Places
        The same ones every time.
    """
    low, high = (math.sin(math.radians(one)) for one in (reach.low_dec_deg, reach.high_dec_deg))
    steps: Array = np.arange(count, dtype=np.float64)
    dec_deg = np.degrees(np.arcsin(low + (high - low) * (steps + 0.5) / count))
    order = np.random.default_rng(0).permutation(count)
    # every tenth of the spiral is itself nearly a spiral; the rest in any order
    early = np.linspace(0, count - 1, min(first, count)).astype(np.int64)
    late = order[~np.isin(order, early)]
    places = Places((steps * _GOLDEN_DEG) % 360.0, dec_deg, (steps * 77.7) % 360.0)
    return places.only(np.concatenate((early, late)))


def pole_places(reach: Reach) -> Places:
    """Places near the galactic poles that are reached; none where the telescope sees neither."""
    return _of_region(reach, lambda b_deg: np.abs(b_deg) >= POLE_DEG)


def plane_places(reach: Reach) -> Places:
    """Places near the galactic plane that are reached."""
    return _of_region(reach, lambda b_deg: np.abs(b_deg) <= PLANE_DEG)


def _of_region(reach: Reach, wanted: Callable[[Array], NDArray[np.bool_]]) -> Places:
    many = spread_places(Reach(), 6000, 0)
    _, b_deg = galactic(many.ra_deg, many.dec_deg)
    inside = wanted(b_deg) & (many.dec_deg >= reach.low_dec_deg) & (many.dec_deg <= reach.high_dec_deg)
    found = np.flatnonzero(inside)
    return many.only(found[:OF_A_REGION])
