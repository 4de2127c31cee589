"""Which rates a mount keeps, as looks show it: by where they lie, and by how far stars are drawn out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import OffsetRates, PierSide
from mountnav.measuring.measurements import SkyQuality
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import half_turn_deg

Matrix = NDArray[np.float64]
TIME_SIGMA_S = 0.05
"""What the instant of a mid-exposure is uncertain by, from frame to frame, s: shutters and clocks that are
kept by NTP. Chosen by hand; doubled, fast targets take longer to be judged."""


@dataclass(frozen=True, slots=True)
class OrderedRates:
    """Rates that the mount was sent, and from when on."""

    since_utc: datetime
    rates: OffsetRates


@dataclass(frozen=True, slots=True)
class TrailSeen:
    """How far the stars of one frame are drawn out, on the sky. Which way along it the tube went is not told.

    Attributes
    ----------
    position_angle_deg : float
        In [0, 180).
    """

    length_arcsec: float
    sigma_arcsec: float
    position_angle_deg: float
    exposure_s: float


@dataclass(frozen=True, slots=True)
class RateLook:
    """A solved center while the mount tracked.

    Attributes
    ----------
    utc : datetime
        Of mid-exposure.
    place : Apparent or Icrs
        Where the tube looked, in the mount's kind of coordinates.
    sigma_arcsec : float
        Per coordinate on the sky.
    trail : TrailSeen or None
        Of its frame.
    """

    utc: datetime
    place: Apparent | Icrs
    sigma_arcsec: float
    side: PierSide = PierSide.UNKNOWN
    trail: TrailSeen | None = None


@dataclass(frozen=True, slots=True)
class SeenRates:
    """Rates as looks show them, in the mount's coordinates, not times cos δ.

    Attributes
    ----------
    ra_sigma_arcsec_s, dec_sigma_arcsec_s : float
        Of the centers' own errors, and of the instants.
    dec_deg : float
        At the middle of the looks.
    ordered : OffsetRates
        On average between them.
    utc : datetime
        In the middle.
    """

    rates: OffsetRates
    ra_sigma_arcsec_s: float
    dec_sigma_arcsec_s: float
    dec_deg: float
    ordered: OffsetRates
    span_s: float
    looks: int
    utc: datetime


def ordered_between(ordered: Sequence[OrderedRates], begin: datetime, end: datetime) -> tuple[float, float]:
    """How far the ordered rates lead from one instant to another, ″ of right ascension and of declination.

    Parameters
    ----------
    ordered : sequence of OrderedRates
        Oldest first; before the first one the mount tracked as for a star.
    """
    ra = dec = 0.0
    for number, one in enumerate(ordered):
        until = ordered[number + 1].since_utc if number + 1 < len(ordered) else end
        seconds = (min(until, end) - max(one.since_utc, begin)).total_seconds()
        if seconds > 0.0:
            ra += one.rates.ra_arcsec_s * seconds
            dec += one.rates.dec_arcsec_s * seconds
    return ra, dec


def rates_of(
    looks: Sequence[RateLook],
    ordered: Sequence[OrderedRates] = (),
    *,
    time_sigma_s: float = TIME_SIGMA_S,
) -> SeenRates | None:
    """Rates by a line through the centers, weighted by their errors.

    Parameters
    ----------
    looks : sequence of RateLook
        Of one posture, with no slew between; None if they are fewer than two, or of one instant.
    ordered : sequence of OrderedRates
        What the mount was sent, oldest first. How they bend the way meanwhile is taken off, so that the line
        is that of their average.

    Raises
    ------
    TypeError
        Places of two kinds.
    """
    if len(looks) < 2:
        return None
    if len({type(look.place) for look in looks}) > 1:
        raise TypeError("positions of different kinds: convert them first")
    first = looks[0]
    seconds = np.array([(look.utc - first.utc).total_seconds() for look in looks])
    span_s = float(seconds.max() - seconds.min())
    if span_s <= 0.0:
        return None
    ra = np.array([half_turn_deg(look.place.ra_deg - first.place.ra_deg) * 3600.0 for look in looks])
    dec = np.array([(look.place.dec_deg - first.place.dec_deg) * 3600.0 for look in looks])
    led = np.array([ordered_between(ordered, first.utc, look.utc) for look in looks])
    cosine = np.array([max(1e-6, math.cos(math.radians(look.place.dec_deg))) for look in looks])
    sigma = np.array(
        [max(1e-3, look.sigma_arcsec) if math.isfinite(look.sigma_arcsec) else 1e4 for look in looks]
    )
    rates, sigmas, means = [], [], []
    for values, on_sky, leads in ((ra, cosine, led[:, 0]), (dec, np.ones(len(looks)), led[:, 1])):
        guess = (values[-1] - values[0]) / span_s
        errors = np.hypot(sigma / on_sky, guess * time_sigma_s)
        mean = _slope(seconds, leads, errors)[0]
        bent = (
            leads - (leads @ (1.0 / errors**2) / np.sum(1.0 / errors**2)) - mean * _centered(seconds, errors)
        )
        rate, error, chi2 = _slope(seconds, values - bent, errors)
        freedom = len(looks) - 2
        # looks that scatter more than they should are as uncertain as they scatter
        stretch = math.sqrt(max(1.0, chi2 / freedom)) if freedom > 0 else 1.0
        rates.append(rate)
        sigmas.append(error * stretch)
        means.append(mean)
    return SeenRates(
        rates=OffsetRates(*rates),
        ra_sigma_arcsec_s=sigmas[0],
        dec_sigma_arcsec_s=sigmas[1],
        dec_deg=float(np.mean([look.place.dec_deg for look in looks])),
        ordered=OffsetRates(*means),
        span_s=span_s,
        looks=len(looks),
        utc=first.utc + timedelta(seconds=float(seconds.mean())),
    )


def _centered(seconds: Matrix, errors: Matrix) -> Matrix:
    weights = 1.0 / errors**2
    return seconds - float(weights @ seconds / weights.sum())


def _slope(seconds: Matrix, values: Matrix, errors: Matrix) -> tuple[float, float, float]:
    """Slope, its sigma, and the squares that are left, of a weighted line."""
    weights = 1.0 / errors**2
    times = _centered(seconds, errors)
    mean = float(weights @ values / weights.sum())
    square = float(weights @ times**2)
    slope = float(weights @ (times * (values - mean))) / square
    left = values - mean - slope * times
    return slope, 1.0 / math.sqrt(square), float(weights @ left**2)


NO_TRAIL = 0.15
"""Ellipticity that optics, seeing and guiding give stars that are not trailed. Doubled, trails must be half
as long again to be seen."""
TRAIL_SHARE = 0.1
"""What the length of a trail is uncertain by at least: a profile is fitted to it that is none. Doubled,
trails say half as much."""


def trail_of(
    quality: SkyQuality | None,
    *,
    scale_arcsec_px: float,
    rotation_deg: float,
    parity: int,
    exposure_s: float,
) -> TrailSeen | None:
    """How far a frame's stars are drawn out, by the shape of its typical star; None where that isn't known.

    Parameters
    ----------
    rotation_deg : float
        Position angle of the image's +y axis.
    parity : int
        +1: as the sky is seen; -1: mirrored.

    Notes
    -----
    A trail of length L adds L²/12 to the variance along it. What optics and seeing may draw out is its error:
    of short trails that is all there is.
    """
    if quality is None or None in (quality.fwhm_px, quality.ellipticity, quality.elongation_deg):
        return None
    assert quality.fwhm_px is not None
    assert quality.ellipticity is not None
    assert quality.elongation_deg is not None
    if not (exposure_s > 0.0 and quality.fwhm_px > 0.0 and 0.0 <= quality.ellipticity < 1.0):
        return None
    ratio = 1.0 - quality.ellipticity
    area = (quality.fwhm_px / 2.3548) ** 2
    along2, across2 = area / ratio, area * ratio
    length2 = 12.0 * (along2 - across2)
    own2 = 12.0 * across2 * (1.0 / (1.0 - NO_TRAIL) ** 2 - 1.0)
    length = math.sqrt(max(0.0, length2))
    sigma = min(math.sqrt(own2), own2 / (2.0 * length) if length > 0.0 else math.inf)
    angle, turn = math.radians(quality.elongation_deg), math.radians(rotation_deg)
    right, up = math.cos(angle) * parity, math.sin(angle)
    east = up * math.sin(turn) - right * math.cos(turn)
    north = up * math.cos(turn) + right * math.sin(turn)
    return TrailSeen(
        length_arcsec=length * scale_arcsec_px,
        sigma_arcsec=math.hypot(sigma, TRAIL_SHARE * length) * scale_arcsec_px,
        position_angle_deg=math.degrees(math.atan2(east, north)) % 180.0,
        exposure_s=exposure_s,
    )
