"""Targets that move among the stars: where each stands at an instant, as a telescope at a site sees it."""

from __future__ import annotations

from mountnav.ephemeris.ephemeris import Ephemeris, SkyRates, StarLike, sky_rates

__all__ = ["Ephemeris", "SkyRates", "StarLike", "sky_rates"]
