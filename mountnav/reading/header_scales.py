"""What the cards say about the scale: focal length and pixel size, or the scale itself; binned or not."""

from __future__ import annotations

import re
from dataclasses import dataclass

from mountnav.reading.header_values import Comments, Header, number, number_unit

#: No telescope or lens gives less or more.
RANGE_ARCSEC_PX = (0.01, 600.0)
_ARCSEC_PER_RADIAN = 206264.806
_FOCAL_CARDS = ("FOCALLEN", "FOCAL", "FOCALLENGTH", "FOCLEN", "TELFOCAL", "CAMOPTIC")
_PIXEL_CARDS = ("XPIXSZ", "PIXSIZE1", "XPIXELSZ", "PIXSIZE", "PIXELSIZE", "XPIXSIZE", "PIXSZ", "CCDXPIXE")
_SCALE_CARDS = ("PIXSCALE", "SECPIX", "SECPIX1", "PIXSCAL", "PIXSCAL1", "CCDSCALE", "IM_SCALE", "SCALE")
_BINNING_CARDS = ("XBINNING", "CCDXBIN", "BINX", "XBIN", "BIN1", "BINNING", "CCDSUM", "CCDBIN1")
_MOST_BINNING = 16.0
_INCLUDES = re.compile(r"binned|after binning|includ\w* binning|effective")
_EXCLUDES = re.compile(r"unbinned|without binning|exclud\w* binning|before binning|physical")
#: A focal length below this many millimeters is more likely given in meters.
_SHORTEST_LENS_MM = 20.0


@dataclass(frozen=True, slots=True)
class Scale:
    """One reading of the cards.

    Attributes
    ----------
    arcsec_px : float
    source : str
        The cards.
    others : tuple of float
        What it would be if the binning (or the unit) was meant the other way; empty where that is no
        question.
    """

    arcsec_px: float
    source: str
    others: tuple[float, ...] = ()


def scales_from_cards(header: Header, comments: Comments) -> list[Scale]:
    """List the scales that a header tells (not its WCS): by focal length and pixel size, then by scale cards.

    [SBFITSEXT] has ``XPIXSZ`` include the binning, and so do MaxIm DL, N.I.N.A., APT, SharpCap and INDI;
    others don't. That reading goes first, the other one is kept, unless the comment or ``PIXSIZE1`` settles
    it.

    Parameters
    ----------
    header, comments : mapping
        The cards' values and comments.

    Returns
    -------
    list of Scale
        Without absurd ones.
    """
    found = [_optics(header, comments)]
    found += [_scale_card(header, comments, key) for key in _SCALE_CARDS]
    return [scale for scale in found if scale is not None]


def sane_scale(arcsec_px: float) -> bool:
    """Whether any optics could have this scale."""
    return RANGE_ARCSEC_PX[0] < arcsec_px < RANGE_ARCSEC_PX[1]


def binning_from_header(header: Header) -> float:
    """How many pixels along x were added up; 1 where nothing sane is said."""
    for key in _BINNING_CARDS:
        value = header.get(key)
        if isinstance(value, str):
            value = re.split(r"[x*,\s]", value.strip().lower())[0]
        binning = number(value)
        if binning is not None and 1.0 <= binning <= _MOST_BINNING:
            return binning
    return 1.0


def _optics(header: Header, comments: Comments) -> Scale | None:
    focal = next((found for key in _FOCAL_CARDS if (found := _focal_mm(header, comments, key))), None)
    pixel = next((size for key in _PIXEL_CARDS if (size := _pixel_um(header, comments, key))), None)
    if focal is None or pixel is None:
        return None
    focal_key, focal_mm, meters = focal
    pixel_key, pixel_um = pixel
    scale = _ARCSEC_PER_RADIAN * 1e-3 * pixel_um / focal_mm
    others: tuple[float, ...] = ()
    binning = binning_from_header(header)
    if binning > 1.0:
        told = comments.get(pixel_key, "").lower()
        single = _pixel_um(header, comments, "PIXSIZE1")
        if pixel_key != "XPIXSZ" or _EXCLUDES.search(told):
            scale, others = scale * binning, (scale,)
        elif single is not None and abs(pixel_um / single[1] - binning) < 0.05 * binning:
            pass  # XPIXSZ is PIXSIZE1 times the binning
        elif single is not None and abs(pixel_um / single[1] - 1.0) < 0.02:
            scale, others = scale * binning, (scale,)
        elif not _INCLUDES.search(told):
            others = (scale * binning,)
    if meters:
        others = (*others, scale / 1000.0)
    source = f"{focal_key} and {pixel_key}"
    others = tuple(other for other in others if sane_scale(other))
    if sane_scale(scale):
        return Scale(scale, source, others)
    return Scale(others[0], source, others[1:]) if others else None


def _focal_mm(header: Header, comments: Comments, key: str) -> tuple[str, float, bool] | None:
    """Return card, millimeters, and whether it may have meant meters."""
    found = number_unit(header, comments, key)
    if found is None or found[0] <= 0.0:
        return None
    value, unit = found
    sure = True
    if re.search(r"\bmm\b|millim", unit):
        pass
    elif re.search(r"\bcm\b|centim", unit):
        value *= 10.0
    elif re.search(r"\binch|\bin\b\]", unit):
        value *= 25.4
    elif re.search(r"\bm\b|\bmet(er|re)s?\b", unit) or value < 1.0:
        value *= 1000.0
    else:
        sure = value >= _SHORTEST_LENS_MM
    return (key, value, not sure) if 1.0 <= value <= 1e5 else None


def _pixel_um(header: Header, comments: Comments, key: str) -> tuple[str, float] | None:
    """Return card and micrometers."""
    found = number_unit(header, comments, key)
    if found is None or found[0] <= 0.0:
        return None
    value, unit = found
    if value < 5e-4 or re.search(r"\[m\]", unit):
        value *= 1e6
    elif value < 0.2 or re.search(r"\bmm\b", unit):
        value *= 1e3
    return (key, value) if 0.5 <= value <= 200.0 else None


def _scale_card(header: Header, comments: Comments, key: str) -> Scale | None:
    found = number_unit(header, comments, key)
    if found is None:
        return None
    value, unit = abs(found[0]), found[1]
    if re.search(r"/\s*mm|per mm", unit):
        return None
    if re.search(r"\bdeg", unit) or ("arc" not in unit and value < RANGE_ARCSEC_PX[0]):
        value *= 3600.0
    elif re.search(r"arcmin", unit):
        value *= 60.0
    elif re.search(r"\bmas\b|milli-?arc", unit):
        value *= 1e-3
    if not sane_scale(value):
        return None
    binning = binning_from_header(header)
    other = value * binning
    if binning > 1.0 and sane_scale(other) and not _INCLUDES.search(_EXCLUDES.sub("", unit)):
        return Scale(other, key, (value,)) if _EXCLUDES.search(unit) else Scale(value, key, (other,))
    return Scale(value, key)
