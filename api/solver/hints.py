"""What a caller believes about a frame, made into a hint; half a belief is refused."""

from __future__ import annotations

import math
from dataclasses import replace

from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs

SCALE_TOLERANCE = 0.05
"""How well a scale given as one number is believed."""


def make_hint(
    ra_deg: float | None,
    dec_deg: float | None,
    radius_deg: float | None,
    scale_low_arcsec_px: float | None,
    scale_high_arcsec_px: float | None,
) -> Hint | None:
    """Make the hint that a caller gave; None when he gave none.

    Raises
    ------
    BadRequest
        Half a place, or bounds the wrong way round.
    """
    if (ra_deg is None) != (dec_deg is None):
        raise BadRequest("a place needs both right ascension and declination", advice="give both, or neither")
    if radius_deg is not None and ra_deg is None:
        raise BadRequest("a radius without a place", advice="give right ascension and declination too")
    if (
        scale_low_arcsec_px is not None
        and scale_high_arcsec_px is not None
        and scale_low_arcsec_px > scale_high_arcsec_px
    ):
        raise BadRequest("the lower bound of the scale is above the upper one", advice="swap them")
    center = None if ra_deg is None or dec_deg is None else Icrs(ra_deg, dec_deg)
    hint = Hint(
        center=center, scale_low_arcsec_px=scale_low_arcsec_px, scale_high_arcsec_px=scale_high_arcsec_px
    )
    if radius_deg is not None:
        hint = replace(hint, radius_deg=radius_deg)
    return None if hint == Hint() else hint


def asked_hint(
    ra: float | None,
    dec: float | None,
    radius: float | None,
    scale: float | None,
    low: float | None = None,
    high: float | None = None,
) -> Hint | None:
    """Make the hint of a command's options; None when there are none.

    Parameters
    ----------
    ra, dec, radius : float or None
        `--ra`, `--dec` and `--radius`, degrees.
    scale : float or None
        `--scale`, arcsec per pixel, good to 5 %.
    low, high : float or None
        `--scale-low` and `--scale-high`, arcsec per pixel.

    Raises
    ------
    BadRequest
        Options out of range, or that make no sense together.
    """
    _require("--ra", ra, 0.0, 360.0)
    _require("--dec", dec, -90.0, 90.0)
    for name, value, greatest in (
        ("--radius", radius, 180.0),
        ("--scale", scale, 3600.0),
        ("--scale-low", low, 3600.0),
        ("--scale-high", high, 3600.0),
    ):
        _require(name, value, 1e-6, greatest)
    if scale is not None:
        if low is not None or high is not None:
            raise BadRequest("--scale and --scale-low/--scale-high together", advice="give one or the other")
        low, high = scale * (1 - SCALE_TOLERANCE), scale * (1 + SCALE_TOLERANCE)
    return make_hint(ra, dec, radius, low, high)


def _require(name: str, value: float | None, least: float, greatest: float) -> None:
    if value is not None and not (math.isfinite(value) and least <= value <= greatest):
        raise BadRequest(f"{name} {value} is out of range", advice=f"{least:g} to {greatest:g}")
