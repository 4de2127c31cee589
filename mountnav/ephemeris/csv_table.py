"""The plain table: CSV with a few lines that say what it is. docs/explanation/moving-targets.md shows one.

::

    # name: 2026 AB
    # observer: geocenter
    # frame: icrs
    utc,ra_deg,dec_deg,distance_au,sigma_arcsec
    2026-11-26T20:00:00Z,101.73343,26.78554,0.0123,0.4

`observer` is ``geocenter``, ``here`` (made for the telescope that uses it) or ``latitude, longitude, height``
in degrees (east positive) and meters. `frame` is ``icrs`` (astrometric) or ``apparent`` (airless, equinox of
date).
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from typing import Final

from mountnav.ephemeris.angles_text import dec_of, plain_number, ra_of, utc_of_julian_date
from mountnav.ephemeris.table import MOST_ROWS, Observer, Table, TableRow
from mountnav.errors import BadRequest
from mountnav.parsing import repeated
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.units import AU_KM

_COLUMNS: Final = (
    "utc",
    "jd_utc",
    "ra_deg",
    "ra_hms",
    "dec_deg",
    "dec_dms",
    "distance_au",
    "distance_km",
    "sigma_arcsec",
)
_SAID: Final = ("name", "observer", "frame")
_APPARENT_SIGMA_ARCSEC: Final = 0.35
"""As of Horizons' apparent places: of the aberration of the turning Earth, and of the equinox."""


_NAMES: Final = re.compile(
    r"^[a-z_]+[ \t]*[,;\t][a-z_,;\t ]*\b(?:ra_deg|ra_hms|dec_deg|dec_dms)\b", re.MULTILINE
)


def looks_like_csv(text: str) -> bool:
    """Whether a text has a line of columns' names; what is wrong with them is told when it is read."""
    return _NAMES.search(text) is not None


def read_csv_table(text: str) -> Table:
    """Read a plain table.

    Raises
    ------
    BadRequest
        Something is missing, wrong or said twice; where.
    """
    said: dict[str, str] = {}
    columns: list[str] | None = None
    rows: list[TableRow] = []
    digits = 0.0
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        at = f"line {number}"
        if not line:
            continue
        if line.startswith("#"):
            key, colon, value = line.lstrip("# ").partition(":")
            if colon and key.strip().lower() in _SAID:
                if key.strip().lower() in said:
                    raise BadRequest(f"{at} says {key.strip()} a second time")
                said[key.strip().lower()] = value.strip()
            continue
        if columns is None:
            if "," not in line:
                raise BadRequest(f"{at}: columns are separated by commas, not by {_separator(line)}")
            columns = _header([one.strip() for one in line.split(",")], at)
            observer, apparent = _observer(said.get("observer")), _is_apparent(said.get("frame"))
            continue
        fields = [one.strip() for one in line.split(",")]
        if len(fields) != len(columns):
            raise BadRequest(f"{at} has {len(fields)} fields, the header {len(columns)}")
        row, digit = _row(dict(zip(columns, fields, strict=True)), apparent, at)
        rows.append(row)
        digits = max(digits, digit)
        if len(rows) > MOST_ROWS:
            raise BadRequest(f"the table has more than {MOST_ROWS} rows")
    if columns is None:
        raise BadRequest(f"the table has no header line; its columns are of {', '.join(_COLUMNS)}")
    return Table(
        said.get("name", "a target by a table")[:80] or "a target by a table", tuple(rows), observer, digits
    )


def _separator(line: str) -> str:
    return "semicolons" if ";" in line else "tabs"


def _header(columns: list[str], at: str) -> list[str]:
    if unknown := [one for one in columns if one not in _COLUMNS]:
        raise BadRequest(f"{at}: no column is called {unknown[0][:30]!r}; there are {', '.join(_COLUMNS)}")
    if twice := repeated(columns):
        raise BadRequest(f"{at}: the column {twice[0]} stands there twice")
    for pair in (("utc", "jd_utc"), ("ra_deg", "ra_hms"), ("dec_deg", "dec_dms")):
        if len(set(pair).intersection(columns)) != 1:
            raise BadRequest(f"{at}: the table wants one of {' and '.join(pair)}")
    if {"distance_au", "distance_km"} <= set(columns):
        raise BadRequest(f"{at}: the table wants one distance, in au or in km")
    return columns


def _observer(text: str | None) -> Observer:
    if text is None:
        raise BadRequest(
            "the table doesn't say for whom it is",
            advice="begin it with `# observer: geocenter`, `# observer: here`, or latitude, longitude, m",
        )
    if text.lower() == "geocenter":
        return "geocenter"
    if text.lower() == "here":
        return "here"
    parts = [one.strip() for one in text.split(",")]
    if len(parts) != 3:
        raise BadRequest(
            f"the observer {text[:40]!r} is neither geocenter, here, nor latitude, longitude, height"
        )
    lat, lon, height = (plain_number(one, "coordinate", "observer") for one in parts)
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 360.0 and -500.0 <= height <= 100_000.0):
        raise BadRequest(f"the observer {text[:40]!r} is no place on the ground")
    return Site(lat, (lon + 180.0) % 360.0 - 180.0, height)


def _is_apparent(text: str | None) -> bool:
    if text is None or text.lower() not in ("icrs", "apparent"):
        raise BadRequest(
            f"the frame is {'not told' if text is None else repr(text[:30])}",
            advice="begin it with `# frame: icrs` (astrometric) or `# frame: apparent` (equinox of date)",
        )
    return text.lower() == "apparent"


def _row(told: dict[str, str], apparent: bool, at: str) -> tuple[TableRow, float]:
    utc = _time(told, at)
    ra, ra_digit = ra_of(_parts(told.get("ra_deg"), told.get("ra_hms")), at)
    dec, dec_digit = dec_of(_parts(told.get("dec_deg"), told.get("dec_dms")), at)
    place = apparent_to_icrs(Apparent(ra, dec, utc)) if apparent else Icrs(ra, dec)
    sigma = plain_number(told["sigma_arcsec"], "uncertainty", at) if "sigma_arcsec" in told else 0.0
    if not 0.0 <= sigma <= 36_000.0:
        raise BadRequest(f"{at}: an uncertainty of {sigma:g}″ is outside 0 to 36000")
    distance = None
    if "distance_au" in told:
        distance = plain_number(told["distance_au"], "distance", at)
    elif "distance_km" in told:
        distance = plain_number(told["distance_km"], "distance", at) / AU_KM
    if distance is not None and not 1e-7 < distance < 1e5:
        raise BadRequest(f"{at}: a distance of {distance:g} au is impossible")
    digit = max(ra_digit * math.cos(math.radians(dec)), dec_digit)
    return TableRow(
        utc, place, distance, math.hypot(sigma, _APPARENT_SIGMA_ARCSEC if apparent else 0.0)
    ), digit


def _parts(degrees: str | None, sexagesimal: str | None) -> list[str]:
    if degrees is not None:
        return [degrees]
    parts = re.split(r"[:\s]+", (sexagesimal or "").strip())
    # one part alone would be taken for degrees
    return parts if len(parts) > 1 else [*parts, ""]


def _time(told: dict[str, str], at: str) -> datetime:
    if "jd_utc" in told:
        return utc_of_julian_date(plain_number(told["jd_utc"], "Julian date", at), "UT")
    text = told["utc"]
    try:
        read = datetime.fromisoformat(text)
    except ValueError:
        raise BadRequest(f"{at}: {text[:30]!r} is not a time such as 2026-11-26T20:00:00Z") from None
    if read.utcoffset() is None:
        # the column is called utc
        read = read.replace(tzinfo=UTC)
    try:
        return read.astimezone(UTC)
    except OverflowError:
        raise BadRequest(f"{at}: {text[:30]!r} is outside the years that are supported") from None
