"""How fast the sky turns: one value for everything that follows it, fakes it or judges by it."""

from __future__ import annotations

SIDEREAL_DEG_S = 360.98564736629 / 86400.0
"""Of the mean sidereal time, degrees per second of UT1 [IAU 1982]. Doubled, nothing would be followed."""
SIDEREAL_ARCSEC_S = 3600.0 * SIDEREAL_DEG_S
"""The same in arcseconds: 15.041."""
SOLAR_TO_SIDEREAL = 24.0 * SIDEREAL_DEG_S * 3600.0 / 360.0
"""Sidereal hours in an hour of UT1: 1.0027379."""

__all__ = ["SIDEREAL_ARCSEC_S", "SIDEREAL_DEG_S", "SOLAR_TO_SIDEREAL"]
