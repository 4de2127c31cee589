"""What a caller believes about a frame, made into a hint; half a belief is refused."""

from __future__ import annotations

from dataclasses import replace

from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs


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
        raise BadRequest("the lower bound of the scale is above the upper one", advice="exchange them")
    center = None if ra_deg is None or dec_deg is None else Icrs(ra_deg, dec_deg)
    hint = Hint(
        center=center, scale_low_arcsec_px=scale_low_arcsec_px, scale_high_arcsec_px=scale_high_arcsec_px
    )
    if radius_deg is not None:
        hint = replace(hint, radius_deg=radius_deg)
    return None if hint == Hint() else hint
