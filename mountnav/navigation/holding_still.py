"""Whether a tube that looks at its target holds still there, or only passes by.

After a slew that ended against the turn of the sky, an axis with play stands until tracking has taken that
up: the sky drifts through the frame, by up to 15″ in each second. Wind swings a tube to and fro. A target
that is in the middle then is so for a moment. Either shows in the frame, if it was exposed for long enough,
or else by another one, taken afterwards at the same place.
"""

from __future__ import annotations

import math

from mountnav.measuring.quality import StarImages
from mountnav.navigation.reports import Look
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S
from mountnav.sky.sphere import separation_arcsec

LOOKED_AGAIN = 6
"""So many more looks may be taken until it is seen to hold still: play of 600″ is taken up meanwhile."""
_OF_DRIFT = 0.5
"""Stars drawn out by less than this share of the sky's turn did not drift with it."""
_OF_TOLERANCE = 0.1
"""A tube whose stars are drawn out by so much of the tolerance in seconds may leave it in the next ones."""
_SHOWS_S = 3.0
"""Gusts swing a tube within some seconds: a shorter exposure shows a moment of that."""
_SIGMA_OF_FWHM = 1.0 / 2.3548
"""Of a Gaussian."""
_AGREE = 0.2
"""Looks that agree to so much of the tolerance show a tube that stays in it."""
_SIGMAS, _OF_NOISE = 3.0, 0.5
"""What looks scatter is allowed besides, but no more than this share: trailed ones scatter by anything."""


def shows_rest(found: Look, tolerance_arcsec: float, exposure_s: float) -> bool:
    """Whether a look shows by itself that the sky stood in the frame: its stars are round, and weren't else.

    Parameters
    ----------
    found : Look
    tolerance_arcsec : float
    exposure_s : float
        As it is usual: a shorter one was tried since the stars were drawn out.
    """
    trail_arcsec, took_s = _trail_arcsec(found), found.exposure_s
    if trail_arcsec is None or took_s is None or took_s < max(_SHOWS_S, 0.9 * exposure_s):
        return False
    drift_arcsec = SIDEREAL_ARCSEC_S * math.cos(math.radians(found.seen.dec_deg)) * took_s
    return trail_arcsec <= min(_OF_DRIFT * drift_arcsec, _OF_TOLERANCE * tolerance_arcsec)


def _trail_arcsec(found: Look) -> float | None:
    """How long the typical star is drawn out at most, by its two widths; None if that can't be told."""
    quality = found.verdict.quality
    if quality is None or quality.images in (StarImages.DEFOCUSED, StarImages.NONE):
        return None
    if quality.fwhm_px is None or quality.ellipticity is None:
        return None
    axes_ratio = max(1.0 - quality.ellipticity, 0.01)
    # a trail of length L adds L² / 12 to the variance along it
    trail_px = quality.fwhm_px * _SIGMA_OF_FWHM * math.sqrt(12.0 * (1.0 / axes_ratio - axes_ratio))
    return trail_px * found.solution.scale_arcsec_px


def agreeing_looks(found: Look, exposure_s: float, *, moved: bool) -> int:
    """How many looks in a row must agree with the one before them until the tube is said to hold still.

    Parameters
    ----------
    found : Look
        The last one.
    exposure_s : float
        As it is usual.
    moved : bool
        Whether it was seen to move: it may stand at a turning point.
    """
    quality = found.verdict.quality
    trailed = quality is not None and quality.images is StarImages.TRAILED
    shortened = found.exposure_s is not None and found.exposure_s < 0.9 * exposure_s
    if trailed or shortened:
        # the optics may make such stars, or the mount track so; else it is chance that they agree
        return 3
    return 2 if moved else 1


def agree(first: Look, again: Look, tolerance_arcsec: float) -> bool:
    """Whether two looks at one place show the same sky, as near as it takes to stay within the tolerance.

    Parameters
    ----------
    first, again : Look
        One after the other, with no slew between.
    tolerance_arcsec : float
    """
    trail_arcsec = _trail_arcsec(again)
    if trail_arcsec is not None and trail_arcsec > tolerance_arcsec:
        return False  # wherever its middle is
    sigmas = [one.solution.center_sigma_arcsec for one in (first, again)]
    noise = _SIGMAS * math.hypot(*(one if math.isfinite(one) else 0.0 for one in sigmas))
    allowed_arcsec = _AGREE * tolerance_arcsec + min(noise, _OF_NOISE * tolerance_arcsec)
    return moved_arcsec(first, again) <= allowed_arcsec


def moved_arcsec(first: Look, again: Look) -> float:
    """How far the sky moved in the frame from one look to the next."""
    return separation_arcsec(first.seen, again.seen)


__all__ = ["LOOKED_AGAIN", "agree", "agreeing_looks", "moved_arcsec", "shows_rest"]
