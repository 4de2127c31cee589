"""Many directions at once, as unit vectors north, east, up: where axes point, how high, how far apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.pointing.limits.postures import Mounting
from mountnav.sky.coordinates import GeometricHourAngle, HourAngle

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Directions:
    """Unit vectors; arrays of one shape."""

    north: Floats
    east: Floats
    up: Floats

    @property
    def altitude_deg(self) -> Floats:
        """Altitudes."""
        return np.degrees(np.arcsin(np.clip(self.up, -1.0, 1.0)))

    @property
    def azimuth_deg(self) -> Floats:
        """Azimuths, north through east, in (-180, 180]."""
        return np.degrees(np.arctan2(self.east, self.north))

    def declination_deg(self, latitude_deg: float) -> Floats:
        """Declinations."""
        lat = math.radians(latitude_deg)
        sine = math.sin(lat) * self.up + math.cos(lat) * self.north
        return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))

    def separation_deg(self, body: Directions) -> Floats:
        """Distances from one direction (of shape () or one that fits)."""
        cosine = self.north * body.north + self.east * body.east + self.up * body.up
        return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def chosen(self, mask: NDArray[np.bool_]) -> Directions:
        """Those of a mask."""
        return Directions(self.north[mask], self.east[mask], self.up[mask])


def of_axes(first_deg: Floats, second_deg: Floats, mounting: Mounting, latitude_deg: float) -> Directions:
    """Where axes of perfect geometry point; the declination axis may be past the pole. Shapes broadcast."""
    first, second = np.radians(first_deg), np.radians(second_deg)
    sin1, cos1, sin2, cos2 = np.sin(first), np.cos(first), np.sin(second), np.cos(second)
    if mounting == "altaz":
        up = np.broadcast_to(sin2, np.broadcast_shapes(np.shape(first), np.shape(second)))
        return Directions(cos2 * cos1, cos2 * sin1, up)
    lat = math.radians(latitude_deg)
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    meridian = cos2 * cos1
    return Directions(cos_lat * sin2 - sin_lat * meridian, -cos2 * sin1, sin_lat * sin2 + cos_lat * meridian)


def of_body(
    body: GeometricHourAngle | HourAngle, latitude_deg: float, ha_later_deg: Floats | float = 0.0
) -> Directions:
    """Where a body stands, its hour angle grown by some degrees."""
    first = np.asarray(body.ha_deg + ha_later_deg, dtype=np.float64)
    return of_axes(first, np.asarray(body.dec_deg), "fork", latitude_deg)
