"""Where the cards say that the telescope pointed: hours or degrees, and which equinox."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from mountnav.reading.header_times import mid_exposure_from_header
from mountnav.reading.header_values import Comments, Header, number, sexagesimal
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

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


@dataclass(frozen=True, slots=True)
class Place:
    """One reading of a pair of cards.

    Attributes
    ----------
    center : Icrs
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


def places_from_cards(header: Header, comments: Comments) -> list[Place]:
    """List the places that a header's position cards tell (not its WCS), the best known cards first.

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
    return _settled(found)


def sane_place(ra_deg: float | None, dec_deg: float | None) -> Icrs | None:
    """Return a place on the sphere, or None; 0, 0 is what a mount writes that isn't connected."""
    if ra_deg is None or dec_deg is None or not -360.0 <= ra_deg <= 360.0 or not -90.0 <= dec_deg <= 90.0:
        return None
    if abs(ra_deg) < 1e-6 and abs(dec_deg) < 1e-6:
        return None
    turned = ra_deg % 360.0
    return Icrs(0.0 if turned >= 360.0 else turned, dec_deg)


def to_icrs(place: Icrs, equinox_yr: float | None) -> Icrs:
    """Precess a place counted from the mean equinox of a year [Vondrák 2011]; None is J2000.

    Nutation, aberration and the FK4 system are left out of account: together below 1′, no matter for a hint.
    """
    if equinox_yr is None or abs(equinox_yr - 2000.0) < 0.5:
        return place
    import erfa

    vector = erfa.s2c(math.radians(place.ra_deg), math.radians(place.dec_deg))
    lon, lat = erfa.c2s(erfa.ltp(equinox_yr).T @ vector)
    turned = math.degrees(float(lon)) % 360.0
    return Icrs(0.0 if turned >= 360.0 else turned, math.degrees(float(lat)))


def _place(header: Header, comments: Comments, ra_key: str, dec_key: str, radius_deg: float) -> Place | None:
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
    center = sane_place(ra_deg, dec_deg)
    if center is None:
        return None
    equinox_yr = _equinox(header, comments, ra_key)
    other = None if other_deg is None or other_deg == ra_deg else sane_place(other_deg, dec_deg)
    return Place(
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


def _settled(places: list[Place]) -> list[Place]:
    """Decide between hours and degrees where another pair of cards agrees with one of the readings."""
    settled = []
    for place in places:
        other = place.other
        if other is not None:
            sure = [one for one in places if one.other is None]
            if any(_apart_deg(place.center, one.center) < one.radius_deg for one in sure):
                place = Place(place.center, place.radius_deg, place.source)
            elif any(_apart_deg(other, one.center) < one.radius_deg for one in sure):
                place = Place(other, place.radius_deg, place.source)
        settled.append(place)
    return settled


def _apart_deg(a: Icrs, b: Icrs) -> float:
    return separation_arcsec(a, b) / 3600.0
