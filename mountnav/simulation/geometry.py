"""From axis angles to the direction the tube looks: the mount model as rotations, exact at the pole too.

Vectors have components (x: meridian on the equator, y: west, z: pole), so an hour angle h and a declination δ
are (cos δ cos h, cos δ sin h, sin δ). Each rotation below is the exact form of one row of the table in
[POINTING §5]; to first order it moves the direction by that row's (ξ, η).
"""

from __future__ import annotations

import math

from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.sphere import half_turn_deg
from mountnav.units import RAD_PER_ARCSEC

Vector = tuple[float, float, float]


def _turned(a: float, b: float, angle: float) -> tuple[float, float]:
    """Components (a, b) turned from a towards b by `angle` radians."""
    c, s = math.cos(angle), math.sin(angle)
    return a * c - b * s, a * s + b * c


def _angles_deg(v: Vector) -> tuple[float, float]:
    """Hour angle in (-180, 180] and declination of a unit vector, deg."""
    x, y, z = v
    return half_turn_deg(math.degrees(math.atan2(y, x))), math.degrees(math.atan2(z, math.hypot(x, y)))


def perfect_direction(ha_axis_deg: float, dec_axis_deg: float) -> tuple[float, float]:
    """Hour angle and declination that axes of perfect geometry point at; beyond the pole is folded back.

    Parameters
    ----------
    ha_axis_deg, dec_axis_deg : float
        Axis angles, deg; any turn.

    Returns
    -------
    ha_deg, dec_deg : float
        Hour angle in (-180, 180], declination in [-90, 90].
    """
    dec = half_turn_deg(dec_axis_deg)
    if abs(dec) > 90.0:
        return half_turn_deg(ha_axis_deg + 180.0), math.copysign(180.0, dec) - dec
    return half_turn_deg(ha_axis_deg), dec


def true_direction(
    ha_axis_deg: float, dec_axis_deg: float, errors: PointingErrors, latitude_deg: float
) -> tuple[float, float]:
    """Observed hour angle and declination of a mount with geometry errors.

    Parameters
    ----------
    ha_axis_deg, dec_axis_deg : float
        Where the axes really are, deg (backlash and periodic error already in).
    errors : PointingErrors
        Of which IH ID CH NP ME MA TF are used.
    latitude_deg : float
        Of the site.

    Returns
    -------
    ha_deg, dec_deg : float
        Hour angle in (-180, 180], declination in [-90, 90].
    """
    # CH: in the tube's own frame the optical axis leans towards the west: ξ = 1
    ch = errors.ch_arcsec * RAD_PER_ARCSEC
    x, y, z = math.cos(ch), math.sin(ch), 0.0
    # ID: declination axis: η = 1
    x, z = _turned(x, z, math.radians(dec_axis_deg) + errors.id_arcsec * RAD_PER_ARCSEC)
    # NP: the declination axis leans about the direction (equator, this hour angle): ξ = sin δ
    z, y = _turned(z, y, errors.np_arcsec * RAD_PER_ARCSEC)
    # IH: hour angle axis: ξ = cos δ
    x, y = _turned(x, y, math.radians(ha_axis_deg) + errors.ih_arcsec * RAD_PER_ARCSEC)
    # ME: about the east-west line: ξ = sin h sin δ, η = cos h
    x, z = _turned(x, z, errors.me_arcsec * RAD_PER_ARCSEC)
    # MA: about the line meridian-equator: ξ = -cos h sin δ, η = sin h
    y, z = _turned(y, z, errors.ma_arcsec * RAD_PER_ARCSEC)
    return _angles_deg(_drooped((x, y, z), errors.tf_arcsec * RAD_PER_ARCSEC, math.radians(latitude_deg)))


def _drooped(v: Vector, flexure: float, latitude: float) -> Vector:
    """Sink a direction away from the zenith by flexure times sin z (radians)."""
    zenith = (math.cos(latitude), 0.0, math.sin(latitude))
    cos_z = sum(a * b for a, b in zip(v, zenith, strict=True))
    away = [c * cos_z - s for c, s in zip(v, zenith, strict=True)]
    sin_z = math.sqrt(sum(a * a for a in away))
    if flexure == 0.0 or sin_z == 0.0:
        return v
    angle = flexure * sin_z
    c, s = math.cos(angle), math.sin(angle) / sin_z
    x, y, z = (c * a + s * b for a, b in zip(v, away, strict=True))
    return x, y, z
