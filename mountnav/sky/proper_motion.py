"""A star's position at another time: proper motion and parallax, rigorously [ERFA pmsafe]."""

from __future__ import annotations

import math
from datetime import datetime

import erfa

from mountnav.sky.coordinates import Icrs
from mountnav.sky.iers import utc_mjd
from mountnav.sky.sphere import turn_deg
from mountnav.units import J2000_JD, JULIAN_YEAR_DAYS, MAS_PER_RAD, MJD_ZERO_JD

_NEAREST_POLE_DEG = 90.0 - 1e-7
"""Declinations are kept so far from the poles, 0.4 mas: a proper motion in right ascension has no meaning at
the pole itself."""
_MAS_PER_ARCSEC = 1000.0
"""Milliarcseconds in an arcsecond."""
_ARCSEC_PER_RADYR = 326.0
"""Parallax of a star that moves by a radian a year at half the speed of light, as `pmsafe` has it."""


def moved_to(
    place: Icrs,
    utc: datetime,
    *,
    epoch_yr: float,
    pm_ra_cosdec_masyr: float = 0.0,
    pm_dec_masyr: float = 0.0,
    parallax_mas: float = 0.0,
) -> Icrs:
    """A position of a catalog's epoch as it is at `utc`: barycentric, ICRS.

    The parallax counts only in the perspective acceleration: the yearly ellipse, at most 0.77″, is left out,
    as mounts and solutions of frames leave it out.

    Parameters
    ----------
    epoch_yr : float
        Julian year of `place`.
    pm_ra_cosdec_masyr, pm_dec_masyr : float
        On the sphere, mas a year.

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    """
    day, fraction = utc_mjd(utc)
    # at the pole itself an angle of right ascension moves nothing
    dec_deg = min(max(place.dec_deg, -_NEAREST_POLE_DEG), _NEAREST_POLE_DEG)
    cos_dec = math.cos(math.radians(dec_deg))
    begin_jd = J2000_JD + (epoch_yr - 2000.0) * JULIAN_YEAR_DAYS
    # pmsafe puts stars that would be too far away to move so fast that near by itself, and warns of it
    motion_radyr = math.hypot(pm_ra_cosdec_masyr, pm_dec_masyr) / MAS_PER_RAD
    if motion_radyr == 0.0:
        return place
    parallax_arcsec = max(parallax_mas / _MAS_PER_ARCSEC, 1.001 * _ARCSEC_PER_RADYR * motion_radyr, 1e-6)
    ra, dec, *_ = erfa.pmsafe(
        math.radians(place.ra_deg),
        math.radians(dec_deg),
        pm_ra_cosdec_masyr / MAS_PER_RAD / cos_dec,
        pm_dec_masyr / MAS_PER_RAD,
        parallax_arcsec,
        0.0,
        begin_jd,
        0.0,
        MJD_ZERO_JD + day,
        fraction,
    )
    return Icrs(turn_deg(math.degrees(float(ra))), math.degrees(float(dec)))


__all__ = ["moved_to"]
