"""Light that isn't stars standing still: satellites crossing the frame, and stars trailed by a drift."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from mountnav.errors import BadSettings
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec

Array = NDArray[np.float64]

# Positions along a drift for each sigma of a star's image: half a sigma apart, a sum of them is smooth.
_STEPS_PER_SIGMA = 2.0
# A trail is drawn out to so many sigmas, where a Gaussian is 4e-6 of its peak.
_WINGS_SIGMA = 5.0
# A tube that moves less than this among the stars in an exposure, pixels, draws no trails: a third of what
# measuring sees of them. Doubled, slow comets leave stars as round as if they were followed as stars.
_STILL_PX = 0.3
# So many positions of a trail are drawn at most: longer ones become dotted. Doubled, frames of a mount that
# slews
# take twice as long to be drawn.
_MOST_PARTS = 400
# Rows that are drawn at once, to bound the memory.
_STRIP_PX = 256


@dataclass(frozen=True, slots=True)
class SatelliteTrail:
    """A satellite's, plane's or meteor's straight trail.

    Attributes
    ----------
    x0_px, y0_px, x1_px, y1_px : float
        Its ends (0-based); they may lie outside the frame.
    adu_per_px : float
        Light per pixel of length, summed over the width.
    fwhm_px : float
        Width of its Gaussian profile.

    Raises
    ------
    BadSettings
        When a value makes no trail.
    """

    x0_px: float
    y0_px: float
    x1_px: float
    y1_px: float
    adu_per_px: float
    fwhm_px: float = 3.0

    def __post_init__(self) -> None:
        values = (self.x0_px, self.y0_px, self.x1_px, self.y1_px, self.adu_per_px, self.fwhm_px)
        if not all(math.isfinite(value) for value in values):
            raise BadSettings("a satellite trail has a value that is not a number")
        if self.fwhm_px <= 0 or self.adu_per_px < 0:
            raise BadSettings("a satellite trail needs a width above 0 and no negative light")
        if self.x0_px == self.x1_px and self.y0_px == self.y1_px:
            raise BadSettings("a satellite trail needs two different ends")


def add_trails(light: NDArray[np.float32], trails: Sequence[SatelliteTrail]) -> None:
    """Add trails to an image.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        ADU; changed in place.
    trails : sequence of SatelliteTrail
        Each is a line of even light, blurred by a Gaussian; sampled at the pixels' centers.
    """
    height, width = light.shape
    for trail in trails:
        sigma = trail.fwhm_px / math.sqrt(8.0 * math.log(2.0))
        length = math.hypot(trail.x1_px - trail.x0_px, trail.y1_px - trail.y0_px)
        along_x, along_y = (trail.x1_px - trail.x0_px) / length, (trail.y1_px - trail.y0_px) / length
        margin = _WINGS_SIGMA * sigma + 1.0
        low = max(0, math.floor(min(trail.y0_px, trail.y1_px) - margin))
        high = min(height, math.ceil(max(trail.y0_px, trail.y1_px) + margin) + 1)
        x = np.arange(width, dtype=np.float64)[None, :] - trail.x0_px
        norm = math.sqrt(2.0) * sigma
        for start in range(low, high, _STRIP_PX):
            stop = min(start + _STRIP_PX, high)
            y = np.arange(start, stop, dtype=np.float64)[:, None] - trail.y0_px
            along, across = x * along_x + y * along_y, y * along_x - x * along_y
            near = (np.abs(across) < margin) & (along > -margin) & (along < length + margin)
            s, d = along[near], across[near]
            profile = np.exp(-0.5 * (d / sigma) ** 2) / (math.sqrt(math.tau) * sigma)
            ends = 0.5 * (erf(s / norm) - erf((s - length) / norm))
            light[start:stop][near] += (trail.adu_per_px * profile * ends).astype(np.float32)


@dataclass(frozen=True, slots=True)
class MovingBody:
    """Something that moves among the stars and shines: a comet's core, a minor planet, a satellite.

    Attributes
    ----------
    path : callable
        ``path(utc)``: where it stands.
    mag : float
        Its magnitude.

    Raises
    ------
    BadSettings
        When the magnitude is no number.
    """

    path: Callable[[datetime], Icrs]
    mag: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.mag):
            raise BadSettings(f"a body of magnitude {self.mag} can't be drawn")


def instants_during(
    path: Callable[[datetime], Icrs],
    mid_utc: datetime,
    exposure_s: float,
    *,
    scale_arcsec_px: float,
    sigma_px: float,
    beside: Callable[[datetime], Icrs] | None = None,
) -> list[datetime]:
    """Instants of an exposure, so many that something which moves is drawn as a smooth trail.

    Parameters
    ----------
    path : callable
        Where it is at an instant.
    beside : callable, optional
        What moves with the frame: only the motion beside it counts.

    Returns
    -------
    list of datetime
        Middles of equal parts of the exposure; only its middle when nothing moves.
    """
    ends = [mid_utc + timedelta(seconds=share * exposure_s) for share in (-0.5, 0.0, 0.5)]
    apart = [separation_arcsec(path(a), path(b)) for a, b in itertools.pairwise(ends)]
    if beside is not None:
        apart = [_beside(path(a), path(b), beside(a), beside(b)) for a, b in itertools.pairwise(ends)]
    length_px = sum(apart) / scale_arcsec_px
    if not math.isfinite(length_px):
        raise BadSettings("the motion during the exposure is not a number")
    if length_px < _STILL_PX:
        return [mid_utc]
    parts = min(_MOST_PARTS, max(2, math.ceil(_STEPS_PER_SIGMA * length_px / sigma_px)))
    return [mid_utc + timedelta(seconds=((n + 0.5) / parts - 0.5) * exposure_s) for n in range(parts)]


def _beside(first: Icrs, second: Icrs, frame_first: Icrs, frame_second: Icrs) -> float:
    """How far something moves in a frame that moves as well, arcsec."""
    a, b = offset_arcsec(first, frame_first), offset_arcsec(second, frame_second)
    return math.hypot(b.east_arcsec - a.east_arcsec, b.north_arcsec - a.north_arcsec)


def centers_during(
    center: Icrs,
    drift_arcsec_s: tuple[float, float],
    exposure_s: float,
    *,
    scale_arcsec_px: float,
    sigma_px: float,
) -> list[Icrs]:
    """Where the optical axis looks at even instants of an exposure.

    Parameters
    ----------
    center : Icrs
        At mid-exposure.
    drift_arcsec_s : (float, float)
        Rate of the optical axis, east and north (true angles); the stars' images go the other way.
    scale_arcsec_px, sigma_px : float
        Scale, and sigma of a star's image: instants are half a sigma apart.

    Returns
    -------
    list of Icrs
        Middles of equal parts of the exposure; only the center when nothing moves.
    """
    east, north = drift_arcsec_s[0] * exposure_s, drift_arcsec_s[1] * exposure_s
    length_px = math.hypot(east, north) / scale_arcsec_px
    if not math.isfinite(length_px):
        raise BadSettings("the drift during the exposure is not a number")
    parts = math.ceil(_STEPS_PER_SIGMA * length_px / sigma_px)
    if parts <= 1:
        return [center]
    times = (np.arange(parts) + 0.5) / parts - 0.5
    return [displaced(center, float(east * t), float(north * t)) for t in times]
