"""What a header believes about place and scale; only a hint, so absurd cards are passed over in silence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from mountnav.frames import Hint
from mountnav.reading.header_places import NOMINAL_RADIUS_DEG, Place, places_from_cards, sane_place, to_icrs
from mountnav.reading.header_scales import Scale, sane_scale, scales_from_cards
from mountnav.reading.header_values import Comments, Header, number
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse, separation_arcsec

#: Bounds lie this far on either side of what the cards say.
SCALE_MARGIN = 0.1
_MOST_ALTERNATIVES = 4
_WCS_SOURCE = "WCS in the header"
Matrix = tuple[float, float, float, float]


def hint_from_header(header: Header, width: int, height: int, comments: Comments | None = None) -> Hint:
    """Collect what a header says about the frame's center and scale.

    A celestial WCS is asked first (its value at the geometric center, never CRVAL itself [DESIGN §6]), then
    ``OBJCTRA``/``OBJCTDEC``, ``RA``/``DEC`` and their kin (`mountnav.reading.header_places`). The scale
    comes from the WCS, from ``FOCALLEN`` and ``XPIXSZ``, or from a scale card
    (`mountnav.reading.header_scales`).

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
    places, scales = places_from_cards(header, comments), scales_from_cards(header, comments)
    center, scale = _from_wcs(header, width, height)
    if center is not None:
        places.insert(0, Place(center, NOMINAL_RADIUS_DEG, _WCS_SOURCE))
    if scale is not None:
        scales.insert(0, Scale(scale, _WCS_SOURCE))
    scales = _settled(scales)
    hints = [
        _with_scale(_with_place(Hint(radius_deg=NOMINAL_RADIUS_DEG), place), reading)
        for reading in _scale_readings(scales) or [None]
        for place in _place_readings(places) or [None]
    ]
    return replace(hints[0], alternatives=tuple(hints[1 : 1 + _MOST_ALTERNATIVES]))


def _with_place(hint: Hint, place: Place | None) -> Hint:
    if place is None:
        return hint
    return replace(hint, center=place.center, radius_deg=place.radius_deg, center_source=place.source)


def _with_scale(hint: Hint, scale: Scale | None) -> Hint:
    if scale is None:
        return hint
    return replace(
        hint,
        scale_low_arcsec_px=scale.arcsec_px * (1.0 - SCALE_MARGIN),
        scale_high_arcsec_px=scale.arcsec_px * (1.0 + SCALE_MARGIN),
        scale_source=scale.source,
    )


def _place_readings(places: list[Place]) -> list[Place | None]:
    """The places that differ by more than their radius, the more trustworthy first."""
    readings: list[Place] = []
    for place in [*places, *(replace(one, center=one.other) for one in places if one.other is not None)]:
        if all(separation_arcsec(place.center, one.center) / 3600.0 > one.radius_deg for one in readings):
            readings.append(place)
    return list(readings)


def _scale_readings(scales: list[Scale]) -> list[Scale | None]:
    """The scales whose bounds don't overlap, the more trustworthy first."""
    readings: list[Scale] = []
    others = [Scale(other, one.source) for one in scales for other in one.others]
    for scale in [*scales, *others]:
        if not any(_agree(scale.arcsec_px, one.arcsec_px) for one in readings):
            readings.append(scale)
    return list(readings)


def _settled(scales: list[Scale]) -> list[Scale]:
    """Decide between the readings of one card where another, unambiguous one agrees with either."""
    settled = []
    for scale in scales:
        sure = [one for one in scales if one is not scale and not one.others]
        for reading in (scale.arcsec_px, *scale.others):
            if any(_agree(reading, one.arcsec_px) for one in sure):
                scale = Scale(reading, scale.source)
                break
        settled.append(scale)
    return settled


def _agree(one_arcsec_px: float, other_arcsec_px: float) -> bool:
    return abs(math.log(one_arcsec_px / other_arcsec_px)) < math.log(
        (1.0 + SCALE_MARGIN) / (1.0 - SCALE_MARGIN)
    )


def _from_wcs(header: Header, width: int, height: int) -> tuple[Icrs | None, float | None]:
    """Return place of the geometric center and scale by a gnomonic WCS, each None if there is none."""
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
    place = sane_place(values[lon - 1], values[lat - 1])
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
    return sane_place(float(ra_deg), float(dec_deg)), scale


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
