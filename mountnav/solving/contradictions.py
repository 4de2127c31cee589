"""Hints that disprove each other, or that a solved frame disproves, in plain words."""

from __future__ import annotations

import math

from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Contradiction

_BINNINGS = (2, 3, 4)
"""Binnings that a wrong scale is explained by, in words of advice."""
_RATIO_ROOM = 0.12
"""A ratio of scales this near to a binning (share) is taken for it: focal lengths are stated to some percent.
Halved, longer tubes than stated get no advice; doubled, 2 and 3 would meet at 2.4."""


def contradictions_of_hints(header: Hint, given: Hint | None = None) -> tuple[Contradiction, ...]:
    """Report hints that can't both be true.

    Parameters
    ----------
    header : Hint
        What the header says, with its other readings (`Hint.alternatives`).
    given : Hint, optional
        What the caller says. It goes before the header.

    Returns
    -------
    tuple of Contradiction
        `source` and `said` are the hint that gives way, `found` is the one that is trusted, with its source.
    """
    reported: list[Contradiction] = []
    center, scale = header, header
    if given is not None and given.center is not None:
        center = given
    if given is not None and _bounded(given):
        scale = given
    for other in (header, *header.alternatives):
        # Other readings of the very same cards are doubts, not contradictions.
        if other.center_source != center.center_source and _centers_apart(center, other):
            _add(
                reported,
                Contradiction(
                    "center",
                    other.center_source,
                    _center(other),
                    f"{_center(center)} by {center.center_source}",
                ),
            )
        if other.scale_source != scale.scale_source and _scales_apart(scale, other):
            _add(
                reported,
                Contradiction(
                    "scale", other.scale_source, _scale(other), f"{_scale(scale)} by {scale.scale_source}"
                ),
            )
    return tuple(reported)


def contradictions_with(hint: Hint, center: Icrs, scale_arcsec_px: float) -> tuple[Contradiction, ...]:
    """Report what of a hint a solved frame disproves.

    Parameters
    ----------
    hint : Hint
        What was believed: the header's, or merged with the caller's.
    center : Icrs
        The solved position of the frame's geometric center.
    scale_arcsec_px : float
        The solved scale.

    Returns
    -------
    tuple of Contradiction
        Empty if the solution lies within the hint's radius and bounds.
    """
    reported = []
    if hint.center is not None:
        apart_deg = separation_arcsec(hint.center, center) / 3600.0
        if apart_deg > hint.radius_deg:
            advice = _center_advice(hint, center)
            found = f"{_place(center)}, {apart_deg:.2f}° off{advice}"
            reported.append(Contradiction("center", hint.center_source, _center(hint), found))
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if (low is not None and scale_arcsec_px < low) or (high is not None and scale_arcsec_px > high):
        found = f"{scale_arcsec_px:.4g} ″/px{_scale_advice(hint, scale_arcsec_px)}"
        reported.append(Contradiction("scale", hint.scale_source, _scale(hint), found))
    return tuple(reported)


def _add(reported: list[Contradiction], one: Contradiction) -> None:
    if one not in reported:
        reported.append(one)


def _bounded(hint: Hint) -> bool:
    return hint.scale_low_arcsec_px is not None or hint.scale_high_arcsec_px is not None


def _centers_apart(one: Hint, other: Hint) -> bool:
    if one.center is None or other.center is None:
        return False
    return separation_arcsec(one.center, other.center) / 3600.0 > max(one.radius_deg, other.radius_deg)


def _scales_apart(one: Hint, other: Hint) -> bool:
    low = max(hint.scale_low_arcsec_px or 0.0 for hint in (one, other))
    high = min(
        math.inf if hint.scale_high_arcsec_px is None else hint.scale_high_arcsec_px for hint in (one, other)
    )
    return low > high


def _place(place: Icrs) -> str:
    return f"RA {place.ra_deg:.3f}° Dec {place.dec_deg:+.3f}°"


def _center(hint: Hint) -> str:
    if hint.center is None:
        return "no place"
    return f"{_place(hint.center)} within {hint.radius_deg:g}°"


def _scale(hint: Hint) -> str:
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if low is None or high is None:
        return f"at least {low:.4g} ″/px" if low is not None else f"at most {high:.4g} ″/px"
    return f"{0.5 * (low + high):.4g} ″/px ({low:.4g} to {high:.4g})"


def _middle(hint: Hint) -> float | None:
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    return None if low is None or high is None else 0.5 * (low + high)


def _scale_advice(hint: Hint, found_arcsec_px: float) -> str:
    """Guess why the scale is off; empty where nothing is likely."""
    said = _middle(hint)
    if said is None or said <= 0.0:
        return ""
    ratio = said / found_arcsec_px
    pixel = hint.scale_source.rpartition(" and ")[2] if hint.scale_source.startswith("FOC") else ""
    for binning in _BINNINGS:
        if abs(ratio / binning - 1.0) < _RATIO_ROOM:
            return f": is {pixel} multiplied by the binning?" if pixel else f": {binning} times too large"
        if abs(ratio * binning - 1.0) < _RATIO_ROOM:
            return f": does {pixel or 'it'} leave out a binning of {binning}?"
    return f": is the focal length {ratio:.3g} times what the header says?" if pixel else ""


def _center_advice(hint: Hint, found: Icrs) -> str:
    """Guess why the center is off; empty where nothing is likely."""
    if hint.center is None:
        return ""
    readings = {
        "is right ascension in hours, not degrees?": Icrs(
            (15.0 * hint.center.ra_deg) % 360.0, hint.center.dec_deg
        ),
        "is right ascension in degrees, not hours?": Icrs(hint.center.ra_deg / 15.0, hint.center.dec_deg),
        "is the sign of the declination lost?": Icrs(hint.center.ra_deg, -hint.center.dec_deg),
    }
    for advice, place in readings.items():
        if separation_arcsec(place, found) / 3600.0 < hint.radius_deg:
            return f": {advice}"
    return ""
