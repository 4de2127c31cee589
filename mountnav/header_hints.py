"""What a header believes about place and scale; only a hint, so absurd cards are passed over in silence."""

from __future__ import annotations

import math
import re

from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs

Header = dict[str, str | int | float | bool]

#: How far a believed place may be off, when a header tells it.
HINT_RADIUS_DEG = 2.0
_MARGIN = 0.1
_SCALE_RANGE_ARCSEC_PX = (0.01, 600.0)
_PLACES = (
    ("OBJCTRA", "OBJCTDEC"),
    ("RA", "DEC"),
    ("RA_OBJ", "DEC_OBJ"),
    ("TELRA", "TELDEC"),
    ("OBJRA", "OBJDEC"),
)
_SCALE_CARDS = ("PIXSCALE", "SECPIX", "SCALE", "PIXSCAL", "SECPIX1", "PIXSCAL1", "PLTSCALE", "CDELTM")
_SEXAGESIMAL = re.compile(
    r"^([+-]?)\s*(\d{1,3})\s*[:hd°\s]\s*(\d{1,2})(?:\s*[:m'′\s]\s*(\d{1,2}(?:\.\d*)?))?\s*[s\"″]?$", re.I
)


def hint_from_header(header: Header, width: int, height: int) -> Hint:
    """Collect what a header says about the frame's center and scale.

    A celestial WCS is asked first (its value at the geometric center, never CRVAL itself [DESIGN §6]),
    then ``OBJCTRA``/``OBJCTDEC``, ``RA``/``DEC`` and their kin. The scale comes from the WCS, from
    ``FOCALLEN`` and ``XPIXSZ``, or from a scale card. Only part of the drivers multiply ``XPIXSZ`` by the
    binning, so that with binning the bounds take in both readings.

    Parameters
    ----------
    header : dict
    width, height : int
        Size of the frame, pixels.

    Returns
    -------
    Hint
        Fields that are missing, contradictory or absurd are None.
    """
    center, scale = _from_wcs(header, width, height)
    for ra_key, dec_key in _PLACES:
        if center is not None:
            break
        center = _place(header.get(ra_key), header.get(dec_key))
    bounds = (scale, scale) if scale is not None else _optics(header) or _scale_card(header)
    if bounds is None:
        return Hint(center=center, radius_deg=HINT_RADIUS_DEG)
    low, high = bounds
    return Hint(
        center=center,
        radius_deg=HINT_RADIUS_DEG,
        scale_low_arcsec_px=low * (1.0 - _MARGIN),
        scale_high_arcsec_px=high * (1.0 + _MARGIN),
    )


def _number(value: object) -> float | None:
    if value is None or isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _sexagesimal(text: str) -> float | None:
    match = _SEXAGESIMAL.match(text.strip())
    if match is None:
        return None
    minutes, seconds = int(match[3]), float(match[4] or 0.0)
    if minutes >= 60 or seconds >= 60.0:
        return None
    size = int(match[2]) + minutes / 60.0 + seconds / 3600.0
    return -size if match[1] == "-" else size


def _place(ra: object, dec: object) -> Icrs | None:
    """Read one pair of cards: numbers are degrees, text with separators is hours and degrees."""
    ra_deg, dec_deg = _number(ra), _number(dec)
    if ra_deg is None and isinstance(ra, str):
        hours = _sexagesimal(ra)
        if hours is not None and 0.0 <= hours < 24.0:
            ra_deg = 15.0 * hours
        elif hours is not None and 24.0 <= hours <= 360.0:
            ra_deg = hours  # degrees, minutes, seconds: hours don't go so far
    if dec_deg is None and isinstance(dec, str):
        dec_deg = _sexagesimal(dec)
    return _sane_place(ra_deg, dec_deg)


def _sane_place(ra_deg: float | None, dec_deg: float | None) -> Icrs | None:
    if ra_deg is None or dec_deg is None or not -360.0 <= ra_deg <= 360.0 or not -90.0 <= dec_deg <= 90.0:
        return None
    if ra_deg == 0.0 and dec_deg == 0.0:
        return None  # what a mount that isn't connected writes
    return Icrs(ra_deg % 360.0, dec_deg)


def _from_wcs(header: Header, width: int, height: int) -> tuple[Icrs | None, float | None]:
    """Return place of the geometric center and scale by a gnomonic WCS, each None if there is none."""
    kinds = (str(header.get("CTYPE1", "")), str(header.get("CTYPE2", "")))
    if not (kinds[0].startswith("RA--") and kinds[1].startswith("DEC-")):
        return None, None
    matrix = _cd_matrix(header)
    place = _sane_place(_number(header.get("CRVAL1")), _number(header.get("CRVAL2")))
    if matrix is None:
        return None, None
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    scale = 3600.0 * math.sqrt(abs(determinant))
    skew = max(math.hypot(a, c), math.hypot(b, d)) / max(min(math.hypot(a, c), math.hypot(b, d)), 1e-30)
    if not _SCALE_RANGE_ARCSEC_PX[0] < scale < _SCALE_RANGE_ARCSEC_PX[1] or skew > 1.5:
        return None, None
    if abs(abs(a) - 1.0) < 1e-9 and abs(abs(d) - 1.0) < 1e-9:
        return None, None  # CDELT = 1 is the default of a header nobody filled in
    if place is None:
        return None, scale
    dx = (width + 1) / 2.0 - (_number(header.get("CRPIX1")) or 0.0)
    dy = (height + 1) / 2.0 - (_number(header.get("CRPIX2")) or 0.0)
    xi, eta = math.radians(a * dx + b * dy), math.radians(c * dx + d * dy)
    if math.hypot(xi, eta) > 1.0:
        return None, scale
    sin0, cos0 = math.sin(math.radians(place.dec_deg)), math.cos(math.radians(place.dec_deg))
    # [S23 eq. 20], put right as in METHODS §3
    ra_deg = place.ra_deg + math.degrees(math.atan2(xi, cos0 - eta * sin0))
    dec_deg = math.degrees(math.asin((eta * cos0 + sin0) / math.sqrt(1.0 + xi * xi + eta * eta)))
    return Icrs(ra_deg % 360.0, dec_deg), scale


def _cd_matrix(header: Header) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the WCS matrix in degrees per pixel from CD, or PC and CDELT, or CDELT and CROTA2."""
    if "CD1_1" in header or "CD1_2" in header:
        cd = [_number(header.get(f"CD{i}_{j}", 0.0)) for i in (1, 2) for j in (1, 2)]
        if any(value is None for value in cd):
            return None
        a, b, c, d = (value or 0.0 for value in cd)
        return (a, b), (c, d)
    step1, step2 = _number(header.get("CDELT1")), _number(header.get("CDELT2"))
    if step1 is None or step2 is None:
        return None
    if "PC1_1" in header or "PC1_2" in header:
        turn = _number(header.get("PC1_1", 1.0)), _number(header.get("PC1_2", 0.0))
        tilt = _number(header.get("PC2_1", 0.0)), _number(header.get("PC2_2", 1.0))
        if None in turn or None in tilt:
            return None
        return (
            (step1 * (turn[0] or 0.0), step1 * (turn[1] or 0.0)),
            (step2 * (tilt[0] or 0.0), step2 * (tilt[1] or 0.0)),
        )
    angle = math.radians(_number(header.get("CROTA2")) or 0.0)
    cos, sin = math.cos(angle), math.sin(angle)
    return (step1 * cos, -step2 * sin), (step1 * sin, step2 * cos)


def _optics(header: Header) -> tuple[float, float] | None:
    """Bounds of the scale from focal length (mm) and pixel size (µm)."""
    focal_mm = _number(header.get("FOCALLEN"))
    pixel_um = _number(header.get("XPIXSZ")) or _number(header.get("PIXSIZE1"))
    if focal_mm is None or pixel_um is None or not 1.0 <= focal_mm <= 1e5 or not 0.5 <= pixel_um <= 200.0:
        return None
    scale = 206.264806 * pixel_um / focal_mm
    binning = _number(header.get("XBINNING")) or 1.0
    widest = scale * binning if 1.0 < binning <= 16.0 else scale
    return _sane_bounds(scale, widest)


def _scale_card(header: Header) -> tuple[float, float] | None:
    for key in _SCALE_CARDS:
        value = _number(header.get(key))
        if value is not None and (bounds := _sane_bounds(abs(value), abs(value))):
            return bounds
    return None


def _sane_bounds(low: float, high: float) -> tuple[float, float] | None:
    if _SCALE_RANGE_ARCSEC_PX[0] < low <= high < _SCALE_RANGE_ARCSEC_PX[1]:
        return low, high
    return None
