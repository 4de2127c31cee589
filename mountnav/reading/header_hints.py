"""The hint of a header: where it says the frame is, and at which scale; contradictions are settled."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from mountnav.frames import Hint
from mountnav.reading.header_times import (
    Comments,
    Header,
    mid_exposure_from_header,
    number,
    number_unit,
    sexagesimal,
)
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse, separation_arcsec
from mountnav.units import pixel_scale_arcsec

#: How far a nominal place may be off: the target, or what a mount believed that was synced.
NOMINAL_RADIUS_DEG = 2.0
#: How far the plain reading of a mount may be off.
MOUNT_RADIUS_DEG = 3.0
_CARDS = (
    ("OBJCTRA", "OBJCTDEC", NOMINAL_RADIUS_DEG),
    ("RA", "DEC", NOMINAL_RADIUS_DEG),
    ("RA_OBJ", "DEC_OBJ", NOMINAL_RADIUS_DEG),
    ("RA_TARG", "DEC_TARG", NOMINAL_RADIUS_DEG),
    ("OBJRA", "OBJDEC", NOMINAL_RADIUS_DEG),
    ("RADEG", "DECDEG", NOMINAL_RADIUS_DEG),
    ("RA_DEG", "DEC_DEG", NOMINAL_RADIUS_DEG),
    ("RA2000", "DEC2000", NOMINAL_RADIUS_DEG),
    ("RA_PNT", "DEC_PNT", NOMINAL_RADIUS_DEG),
    ("RA_NOM", "DEC_NOM", NOMINAL_RADIUS_DEG),
    ("CAT-RA", "CAT-DEC", NOMINAL_RADIUS_DEG),
    ("TELRA", "TELDEC", MOUNT_RADIUS_DEG),
    ("RA-TEL", "DEC-TEL", MOUNT_RADIUS_DEG),
    ("RA_TEL", "DEC_TEL", MOUNT_RADIUS_DEG),
    ("RA-MNT", "DEC-MNT", MOUNT_RADIUS_DEG),
    ("MNT_RA", "MNT_DEC", MOUNT_RADIUS_DEG),
)
_HOURS = re.compile(r"\[h\]|\bhours?\b|\bhrs?\b|\bhms\b|\bh[ :]?m[ :]?s\b|\(h\)|\[h m s\]|\[hours?\]")
_DEGREES = re.compile(r"deg|°|\bdms\b|\[d\]")
_J2000 = re.compile(r"j2000|\bicrs\b|\b2000(\.0*)?\b")
_OF_DATE = re.compile(r"jnow|\bof date\b|\bapparent\b|\bcurrent epoch\b")
_YEARS = (1800.0, 2100.0)
"""Equinoxes between these years are believed; others are no equinox."""


@dataclass(frozen=True, slots=True)
class HeaderPosition:
    """One reading of a pair of cards.

    Attributes
    ----------
    radius_deg : float
        How far off it may be.
    source : str
        The cards.
    other : Icrs or None
        What it would be with right ascension counted in hours instead of degrees, or the other way round;
        None where that is no question.
    """

    center: Icrs
    radius_deg: float
    source: str
    other: Icrs | None = None


def positions_from_cards(header: Header, comments: Comments) -> list[HeaderPosition]:
    """List the positions that a header's cards give (not its WCS), the best known cards first.

    Text with separators is hours and degrees. A bare number is degrees, unless its comment says hours; one
    below 24 whose comment says nothing is ambiguous, and settled by the other cards where one agrees with
    either reading. Places of another equinox (``EQUINOX``, ``EPOCH``, a comment that says JNow) are
    precessed.

    Parameters
    ----------
    header, comments : mapping
        The cards' values and comments.

    Returns
    -------
    list of Place
        Without absurd ones: outside the sphere, or exactly 0, 0 as a mount writes that isn't connected.
    """
    found = []
    for ra_key, dec_key, radius_deg in _CARDS:
        place = _place(header, comments, ra_key, dec_key, radius_deg)
        if place is not None:
            found.append(place)
    return _settled_position(found)


def sane_position(ra_deg: float | None, dec_deg: float | None) -> Icrs | None:
    """Return a position on the sphere, or None; 0, 0 is what a mount writes that isn't connected."""
    if ra_deg is None or dec_deg is None or not -360.0 <= ra_deg <= 360.0 or not -90.0 <= dec_deg <= 90.0:
        return None
    if abs(ra_deg) < 1e-6 and abs(dec_deg) < 1e-6:
        return None
    turned = ra_deg % 360.0
    return Icrs(0.0 if turned >= 360.0 else turned, dec_deg)


def to_icrs(place: Icrs, equinox_yr: float | None) -> Icrs:
    """Precess a position counted from the mean equinox of a year [Vondrák 2011]; None is J2000.

    Nutation, aberration and the FK4 system are left out of account: together below 1′, no matter for a hint.
    """
    if equinox_yr is None or abs(equinox_yr - 2000.0) < 0.5:
        return place
    import erfa

    vector = erfa.s2c(math.radians(place.ra_deg), math.radians(place.dec_deg))
    lon, lat = erfa.c2s(erfa.ltp(equinox_yr).T @ vector)
    turned = math.degrees(float(lon)) % 360.0
    return Icrs(0.0 if turned >= 360.0 else turned, math.degrees(float(lat)))


def _place(
    header: Header, comments: Comments, ra_key: str, dec_key: str, radius_deg: float
) -> HeaderPosition | None:
    ra, dec = header.get(ra_key), header.get(dec_key)
    told = comments.get(ra_key, "").lower()
    dec_deg = _angle(dec)
    ra_value = number(ra)
    other_deg = None
    if ra_value is None:
        ra_deg, other_deg = _text_ra(ra, told)
    elif _HOURS.search(told) and not _DEGREES.search(told):
        ra_deg = 15.0 * ra_value if -24.0 < ra_value < 24.0 else None
    else:
        ra_deg = ra_value
        if 0.0 <= ra_value < 24.0 and not _DEGREES.search(told) and "DEG" not in ra_key:
            other_deg = 15.0 * ra_value
    center = sane_position(ra_deg, dec_deg)
    if center is None:
        return None
    equinox_yr = _equinox(header, comments, ra_key)
    other = None if other_deg is None or other_deg == ra_deg else sane_position(other_deg, dec_deg)
    return HeaderPosition(
        to_icrs(center, equinox_yr),
        radius_deg,
        f"{ra_key} and {dec_key}",
        None if other is None else to_icrs(other, equinox_yr),
    )


def _angle(value: object) -> float | None:
    found = number(value)
    if found is None and isinstance(value, str) and (read := sexagesimal(value)):
        found = read[0]
    return found


def _text_ra(value: object, told: str) -> tuple[float | None, float | None]:
    """Read text in degrees: what it says, and what it may say where its comment calls it degrees."""
    read = sexagesimal(value) if isinstance(value, str) else None
    if read is None:
        return None, None
    size, degrees = read
    if degrees or abs(size) >= 24.0:  # hours don't go so far
        return size, None
    told_degrees = _DEGREES.search(told) and not _HOURS.search(told)
    return 15.0 * size, size if told_degrees else None


def _equinox(header: Header, comments: Comments, ra_key: str) -> float | None:
    """Tell the year from whose equinox the cards count, None for J2000 and where nothing is said."""
    if "2000" in ra_key:
        return None
    told = comments.get(ra_key, "").lower()
    if _OF_DATE.search(told):
        utc = mid_exposure_from_header(header, comments)
        of_date = None if utc is None else utc.year + (utc.month - 0.5) / 12.0
        return _year(header.get("EQUINOX")) or of_date
    if _J2000.search(told):
        return None
    if ra_key == "TELRA" and (year := _year(header.get("TELEQUIN"))):
        return year
    if ra_key == "OBJRA" and (year := _year(header.get("OBJEQUIN"))):
        return year
    system = str(header.get("RADESYS", header.get("RADECSYS", ""))).strip().upper()
    if system == "ICRS":
        return None
    return _year(header.get("EQUINOX")) or _year(header.get("EPOCH")) or (1950.0 if system == "FK4" else None)


def _year(value: object) -> float | None:
    """Read "J2000", "B1950.0", 2026.87; None for all that is no year."""
    if isinstance(value, str):
        value = value.strip().upper().lstrip("JB")
    year = number(value)
    return year if year is not None and _YEARS[0] <= year <= _YEARS[1] else None


def _settled_position(places: list[HeaderPosition]) -> list[HeaderPosition]:
    """Decide between hours and degrees where another pair of cards agrees with one of the readings."""
    settled = []
    for place in places:
        other = place.other
        if other is not None:
            sure = [one for one in places if one.other is None]
            if any(_apart_deg(place.center, one.center) < one.radius_deg for one in sure):
                place = HeaderPosition(place.center, place.radius_deg, place.source)
            elif any(_apart_deg(other, one.center) < one.radius_deg for one in sure):
                place = HeaderPosition(other, place.radius_deg, place.source)
        settled.append(place)
    return settled


def _apart_deg(a: Icrs, b: Icrs) -> float:
    return separation_arcsec(a, b) / 3600.0


#: No telescope or lens gives less or more.
RANGE_ARCSEC_PX = (0.01, 600.0)
_FOCAL_CARDS = ("FOCALLEN", "FOCAL", "FOCALLENGTH", "FOCLEN", "TELFOCAL", "CAMOPTIC")
_PIXEL_CARDS = ("XPIXSZ", "PIXSIZE1", "XPIXELSZ", "PIXSIZE", "PIXELSIZE", "XPIXSIZE", "PIXSZ", "CCDXPIXE")
_SCALE_CARDS = ("PIXSCALE", "SECPIX", "SECPIX1", "PIXSCAL", "PIXSCAL1", "CCDSCALE", "IM_SCALE", "SCALE")
_BINNING_CARDS = ("XBINNING", "CCDXBIN", "BINX", "XBIN", "BIN1", "BINNING", "CCDSUM", "CCDBIN1")
_MOST_BINNING = 16.0
"""Larger values of a binning card are no binning."""
_INCLUDES = re.compile(r"binned|after binning|includ\w* binning|effective")
_EXCLUDES = re.compile(r"unbinned|without binning|exclud\w* binning|before binning|physical")
#: A focal length below this many millimeters is more likely given in meters.
_SHORTEST_LENS_MM = 20.0


@dataclass(frozen=True, slots=True)
class HeaderScale:
    """One reading of the cards.

    Attributes
    ----------
    source : str
        The cards.
    others : tuple of float
        What it would be if the binning (or the unit) was meant the other way; empty where that is no
        question.
    """

    arcsec_px: float
    source: str
    others: tuple[float, ...] = ()


def scales_from_cards(header: Header, comments: Comments) -> list[HeaderScale]:
    """List the scales that a header gives (not its WCS): by focal length and pixel size, then by scale cards.

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


def _optics(header: Header, comments: Comments) -> HeaderScale | None:
    focal = next((found for key in _FOCAL_CARDS if (found := _focal_mm(header, comments, key))), None)
    pixel = next((size for key in _PIXEL_CARDS if (size := _pixel_um(header, comments, key))), None)
    if focal is None or pixel is None:
        return None
    focal_key, focal_mm, meters = focal
    pixel_key, pixel_um = pixel
    scale = pixel_scale_arcsec(pixel_um, focal_mm)
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
        return HeaderScale(scale, source, others)
    return HeaderScale(others[0], source, others[1:]) if others else None


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


def _scale_card(header: Header, comments: Comments, key: str) -> HeaderScale | None:
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
        return (
            HeaderScale(other, key, (value,)) if _EXCLUDES.search(unit) else HeaderScale(value, key, (other,))
        )
    return HeaderScale(value, key)


#: Bounds lie this far on either side of what the cards say.
SCALE_MARGIN = 0.1
_MOST_ALTERNATIVES = 4
"""Hints beside the first that a solve may try where cards contradict each other; chosen by hand. Each costs a
search, so twice as many may cost twice the time on a header that is all wrong."""
_WCS_SOURCE = "WCS in the header"
Matrix = tuple[float, float, float, float]


def hint_from_header(header: Header, width: int, height: int, comments: Comments | None = None) -> Hint:
    """Collect what a header says about the frame's center and scale.

    A celestial WCS is asked first (its value at the geometric center, never CRVAL itself [DESIGN §6]), then
    ``OBJCTRA``/``OBJCTDEC``, ``RA``/``DEC`` and their kin (`mountnav.reading.header_hints`). The scale
    comes from the WCS, from ``FOCALLEN`` and ``XPIXSZ``, or from a scale card
    (`mountnav.reading.header_hints`).

    Parameters
    ----------
    header : mapping
        Values by keyword.
    width, height : int
        Size of the frame, pixels.
    comments : mapping, optional
        The cards' comments, which often name the unit or the equinox.

    Returns
    -------
    Hint
        Fields that are missing or absurd are None. Other readings of the same cards, and other cards that
        disagree, are its `alternatives`.
    """
    comments = comments or {}
    places, scales = positions_from_cards(header, comments), scales_from_cards(header, comments)
    center, scale = _from_wcs(header, width, height)
    if center is not None:
        places.insert(0, HeaderPosition(center, NOMINAL_RADIUS_DEG, _WCS_SOURCE))
    if scale is not None:
        scales.insert(0, HeaderScale(scale, _WCS_SOURCE))
    scales = _settled(scales)
    hints = [
        _with_scale(_with_place(Hint(radius_deg=NOMINAL_RADIUS_DEG), place), reading)
        for reading in _scale_readings(scales) or [None]
        for place in _place_readings(places) or [None]
    ]
    return replace(hints[0], alternatives=tuple(hints[1 : 1 + _MOST_ALTERNATIVES]))


def _with_place(hint: Hint, place: HeaderPosition | None) -> Hint:
    if place is None:
        return hint
    return replace(hint, center=place.center, radius_deg=place.radius_deg, center_source=place.source)


def _with_scale(hint: Hint, scale: HeaderScale | None) -> Hint:
    if scale is None:
        return hint
    return replace(
        hint,
        scale_low_arcsec_px=scale.arcsec_px * (1.0 - SCALE_MARGIN),
        scale_high_arcsec_px=scale.arcsec_px * (1.0 + SCALE_MARGIN),
        scale_source=scale.source,
    )


def _place_readings(places: list[HeaderPosition]) -> list[HeaderPosition | None]:
    """The positions that differ by more than their radius, the more trustworthy first."""
    readings: list[HeaderPosition] = []
    for place in [*places, *(replace(one, center=one.other) for one in places if one.other is not None)]:
        if all(separation_arcsec(place.center, one.center) / 3600.0 > one.radius_deg for one in readings):
            readings.append(place)
    return list(readings)


def _scale_readings(scales: list[HeaderScale]) -> list[HeaderScale | None]:
    """The scales whose bounds don't overlap, the more trustworthy first."""
    readings: list[HeaderScale] = []
    others = [HeaderScale(other, one.source) for one in scales for other in one.others]
    for scale in [*scales, *others]:
        if not any(_agree(scale.arcsec_px, one.arcsec_px) for one in readings):
            readings.append(scale)
    return list(readings)


def _settled(scales: list[HeaderScale]) -> list[HeaderScale]:
    """Decide between the readings of one card where another, unambiguous one agrees with either."""
    settled = []
    for scale in scales:
        sure = [one for one in scales if one is not scale and not one.others]
        for reading in (scale.arcsec_px, *scale.others):
            if any(_agree(reading, one.arcsec_px) for one in sure):
                scale = HeaderScale(reading, scale.source)
                break
        settled.append(scale)
    return settled


def _agree(one_arcsec_px: float, other_arcsec_px: float) -> bool:
    return abs(math.log(one_arcsec_px / other_arcsec_px)) < math.log(
        (1.0 + SCALE_MARGIN) / (1.0 - SCALE_MARGIN)
    )


def _from_wcs(header: Header, width: int, height: int) -> tuple[Icrs | None, float | None]:
    """Return position of the geometric center and scale by a gnomonic WCS, each None if there is none."""
    kinds = [str(header.get(f"CTYPE{i}", "")).upper() for i in (1, 2)]
    values = [number(header.get(f"CRVAL{i}")) for i in (1, 2)]
    if kinds[0].startswith("DEC-") and kinds[1].startswith("RA--"):
        lon, lat = 2, 1
    elif kinds[0].startswith("RA--") and kinds[1].startswith("DEC-"):
        lon, lat = 1, 2
    else:
        return None, None
    if any(
        str(header.get(f"CUNIT{i}", "deg")).strip().lower() not in ("deg", "degree", "degrees", "")
        for i in (1, 2)
    ):
        return None, None
    place = sane_position(values[lon - 1], values[lat - 1])
    if place is not None:
        place = to_icrs(place, _wcs_equinox(header))
    matrix = _cd_matrix(header, lon, lat)
    if matrix is None:
        # A capture program's guess: CRVAL of a reference pixel within the frame.
        reference = number(header.get("CRPIX1", width / 2)), number(header.get("CRPIX2", height / 2))
        inside = all(
            pixel is not None and 0.0 <= pixel <= side + 1.0
            for pixel, side in zip(reference, (width, height), strict=True)
        )
        told = any(f"{key}{i}" in header for key in ("CDELT", "CD1_", "CD2_") for i in (1, 2))
        return (place if inside and not told else None), None
    a, b, c, d = matrix
    scale = 3600.0 * math.sqrt(abs(a * d - b * c))
    long, short = max(math.hypot(a, c), math.hypot(b, d)), min(math.hypot(a, c), math.hypot(b, d))
    if not sane_scale(scale) or long > 1.5 * short:
        return None, None
    if abs(abs(a) - 1.0) < 1e-9 and abs(abs(d) - 1.0) < 1e-9:
        return None, None  # CDELT = 1 is the default of a header nobody filled in
    if place is None:
        return None, scale
    dx = (width + 1) / 2.0 - (number(header.get("CRPIX1")) or 0.0)
    dy = (height + 1) / 2.0 - (number(header.get("CRPIX2")) or 0.0)
    xi, eta = math.radians(a * dx + b * dy), math.radians(c * dx + d * dy)
    if not math.hypot(xi, eta) <= 1.0:
        return None, scale
    ra_deg, dec_deg = gnomonic_inverse(xi, eta, place.ra_deg, place.dec_deg)
    return sane_position(float(ra_deg), float(dec_deg)), scale


def _wcs_equinox(header: Header) -> float | None:
    """Tell the equinox of a WCS: only FK4 and FK5 have one [FITS 4.0 §8.3]."""
    system = str(header.get("RADESYS", header.get("RADECSYS", ""))).strip().upper()
    year = number(header.get("EQUINOX"))
    if year is None or not 1800.0 <= year <= 2100.0:
        return 1950.0 if system == "FK4" else None
    return None if system == "ICRS" else year


def _cd_matrix(header: Header, lon: int, lat: int) -> Matrix | None:
    """Return dξ/dx, dξ/dy, dη/dx, dη/dy in degrees per pixel from CD, PC and CDELT, or CDELT and CROTA2."""
    if any(f"CD{i}_{j}" in header for i in (1, 2) for j in (1, 2)):
        return _finite(number(header.get(f"CD{i}_{j}", 0.0)) for i in (lon, lat) for j in (1, 2))
    step_lon, step_lat = number(header.get(f"CDELT{lon}")), number(header.get(f"CDELT{lat}"))
    if step_lon is None or step_lat is None:
        return None
    if any(f"PC{i}_{j}" in header for i in (1, 2) for j in (1, 2)):
        turn = _finite(
            number(header.get(f"PC{i}_{j}", 1.0 if i == j else 0.0)) for i in (lon, lat) for j in (1, 2)
        )
        if turn is None:
            return None
        return step_lon * turn[0], step_lon * turn[1], step_lat * turn[2], step_lat * turn[3]
    angle = math.radians(number(header.get(f"CROTA{lat}")) or 0.0)
    cos, sin = math.cos(angle), math.sin(angle)
    if lon == 2:  # the axes are exchanged: x runs along declination
        return -step_lat * sin, step_lon * cos, step_lat * cos, step_lon * sin
    return step_lon * cos, -step_lat * sin, step_lon * sin, step_lat * cos


def _finite(entries: Iterable[float | None]) -> Matrix | None:
    values = [value for value in entries if value is not None]
    return (values[0], values[1], values[2], values[3]) if len(values) == 4 else None
