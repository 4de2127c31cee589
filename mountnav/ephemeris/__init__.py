"""Targets that move among the stars: where each stands at an instant, as a telescope at a site sees them."""

from __future__ import annotations

from mountnav.ephemeris.bodies import SolarSystemBody
from mountnav.ephemeris.ephemeris import Ephemeris, SkyRates, StarLike, sky_rates
from mountnav.ephemeris.path import Path, Waypoint
from mountnav.ephemeris.rates import HorizonRatesTarget, SkyRatesTarget
from mountnav.ephemeris.satellite import EarthSatellite, SatelliteElements
from mountnav.ephemeris.tle import read_tle

__all__ = [
    "EarthSatellite",
    "Ephemeris",
    "HorizonRatesTarget",
    "Path",
    "SatelliteElements",
    "SkyRates",
    "SkyRatesTarget",
    "SolarSystemBody",
    "StarLike",
    "Waypoint",
    "read_tle",
    "sky_rates",
]
