"""Observer tables of JPL's Horizons: as text, as CSV, and in the JSON of its API.

The header says who the observer is, in which scale the times are, and which columns there are. Right
ascension and declination may be in hours or degrees, astrometric (ICRF) or airless apparent; the distance and
the 3σ uncertainties count if they are there. What can't be taken for certain is refused: refracted places,
B1950, vectors, other centers.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from mountnav.ephemeris.angles_text import calendar_instant, dec_of, plain_number, ra_of, utc_of_julian_date
from mountnav.ephemeris.table import MOST_ROWS, Observer, Table, TableRow
from mountnav.errors import BadRequest
from mountnav.parsing import json_of
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.units import AU_KM

_BEGIN: Final = "$$SOE"
_END: Final = "$$EOE"
_ASK: Final = "ask Horizons for an observer table with quantities 1 and 20, for your coordinates"
_APPARENT_SIGMA_ARCSEC: Final = 0.35
"""Of an apparent place that is taken back: its equinox differs by 0.05″ from ours, and the aberration of the
turning Earth (0.3″) is in it or not. Doubled, those tables are searched a little wider."""
_LONGEST_LINE: Final = 3000
"""Letters of a line at most; all quantities together have 900."""
_MOST_AU: Final = 200.0
"""The farthest that anything is followed, au. Doubled, satellites 200 to 400 km away whose table doesn't tell
its unit would be taken for that far."""
_LONGEST_LEGEND: Final = 200_000
"""Letters below the table in which the unit is looked for; that of all quantities has 40,000."""
_LARGE_KM: Final = 6000.0
"""Where the table doesn't tell the distance's unit (its legend is cut off), smaller numbers than `_MOST_AU`
are au, and larger ones than this are km; between them it is neither for certain: a satellite of the Earth is
so near. Halved, one that is 4000 km away would be read without its unit, and rightly."""


def looks_like_horizons(text: str) -> bool:
    """Whether a text is an answer of Horizons."""
    return _BEGIN in text


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where what stands in a line: labels of the table's header with their ends."""

    labels: tuple[str, ...]
    ends: tuple[int, ...]
    csv: bool

    def fields(self, line: str, at: str) -> list[str]:
        if self.csv:
            found = line.split(",")
            if len(found) < len(self.labels):
                raise BadRequest(f"{at} has {len(found)} fields, its header {len(self.labels)}")
            return found
        begins = (0, *self.ends[:-1])
        found = [line[begin:end] for begin, end in zip(begins, self.ends, strict=True)]
        for end in self.ends:
            if line[end - 1 : end + 1].strip() != line[end - 1 : end].strip():
                raise BadRequest(f"{at}: its columns don't stand below their header")
        return found


def read_horizons(text: str) -> Table:
    """Read an observer table.

    Parameters
    ----------
    text : str
        The whole answer, header and all.

    Raises
    ------
    BadRequest
        It isn't one, or something in it is ambiguous; which, and how to ask for a better one.
    """
    text = _unwrapped(text)
    lines = text.splitlines()
    begin = next((number for number, line in enumerate(lines) if line.strip() == _BEGIN), None)
    if begin is None:
        raise BadRequest(f"there is no table in it: no {_BEGIN}", advice=_ASK)
    end = next((number for number in range(begin, len(lines)) if lines[number].strip() == _END), None)
    if end is None:
        raise BadRequest(f"the table is cut off: no {_END}", advice="copy the answer whole")
    if end - begin - 1 > MOST_ROWS:
        raise BadRequest(f"the table has {end - begin - 1} rows; {MOST_ROWS} are the most")
    header = lines[:begin]
    if any(len(line) > _LONGEST_LINE for line in lines[: end + 1]):
        raise BadRequest(f"a line is longer than {_LONGEST_LINE} letters")
    columns = _columns(header)
    name = _told(header, "Target body name") or "a target of Horizons"
    name = re.sub(r"\s*\{source:.*", "", name).strip()[:80] or "a target of Horizons"
    observer = _observer(header)
    unit = _range_unit(lines[end + 1 :])
    rows, digits = [], 0.0
    for number in range(begin + 1, end):
        line = lines[number]
        if not line.strip() or line.lstrip().startswith(">"):
            continue
        row, digit = _row(columns, line, unit, f"line {number + 1}")
        rows.append(row)
        digits = max(digits, digit)
    return Table(name, tuple(rows), observer, digits)


def _unwrapped(text: str) -> str:
    """The text within the API's JSON, if it is that."""
    if text.lstrip()[:1] != "{":
        return text
    try:
        found = json_of(text)
    except json.JSONDecodeError as wrong:
        raise BadRequest(f"the JSON is broken at line {wrong.lineno}: {wrong.msg}") from wrong
    result = found.get("result") if isinstance(found, dict) else None
    if not isinstance(result, str):
        raise BadRequest("the JSON has no result of Horizons", advice=_ASK)
    return result


def _told(header: list[str], key: str) -> str | None:
    found = [line.partition(":")[2].strip() for line in header if re.match(rf"\s*{re.escape(key)}\s*:", line)]
    if len(set(found)) > 1:
        raise BadRequest(f"the header tells {key!r} twice, differently")
    return found[0] if found else None


def _observer(header: list[str]) -> Observer:
    center = _told(header, "Center body name")
    if center is None:
        raise BadRequest(
            "the header doesn't say for whom the table is (Center body name)", advice="copy the answer whole"
        )
    if not re.match(r"Earth \(399\)", center):
        raise BadRequest(f"the table is for an observer at {center[:40]!r}, not on the Earth", advice=_ASK)
    site_name = _told(header, "Center-site name") or ""
    where = _told(header, "Center geodetic")
    if site_name.upper().startswith("GEOCENTRIC"):
        return "geocenter"
    numbers = re.match(r"([-+0-9.]+)\s*,\s*([-+0-9.]+)\s*,\s*([-+0-9.]+)", where or "")
    if numbers is None:
        raise BadRequest("the header doesn't give the observer's coordinates (Center geodetic)", advice=_ASK)
    lon, lat, km = (plain_number(one, "coordinate", "Center geodetic") for one in numbers.groups())
    if not (-360.0 <= lon <= 360.0 and -90.0 <= lat <= 90.0 and -7000.0 <= km <= 100.0):
        raise BadRequest(f"the observer's coordinates {lon:g}, {lat:g}, {km:g} km are not on the ground")
    if lon == lat == km == 0.0:
        return "geocenter"
    return Site(lat, (lon + 180.0) % 360.0 - 180.0, km * 1000.0)


def _columns(header: list[str]) -> _Columns:
    titles = [line for line in header if line.lstrip().startswith("Date_")]
    kind = _told(header, "Output type")
    if not titles and kind is not None:
        raise BadRequest(f"it is no observer table, but one of {kind[:60]}", advice=_ASK)
    if not titles:
        raise BadRequest("the table has no header line that begins with Date", advice=_ASK)
    title = titles[-1]
    if "," in title:
        labels = tuple(one.strip() for one in title.split(","))
        return _Columns(labels, (), csv=True)
    # two columns such as "S-O-T /r" have a blank within: their parts are labels of their own, and no harm
    found = list(re.finditer(r"\S+", title))
    return _Columns(tuple(one.group() for one in found), tuple(one.end() for one in found), csv=False)


def _range_unit(legend: list[str]) -> str | None:
    """The unit of the distances, "AU" or "KM", by what stands below the table; None if nothing does."""
    told = re.search(
        r"\brange\b[^:]{0,400}?\bUnits\s*:\s*(AU|KM)\b", " ".join(legend)[:_LONGEST_LEGEND], re.I
    )
    return told[1].upper() if told else None


def _row(columns: _Columns, line: str, unit: str | None, at: str) -> tuple[TableRow, float]:
    fields = columns.fields(line, at)
    told = dict(zip(columns.labels, fields, strict=False))
    utc = _time(told, at)
    place, digit, sigma = _place(columns, told, utc, at)
    distance = _distance(told, unit, at)
    return TableRow(utc, place, distance, math.hypot(sigma, _three_sigma(told, at))), digit


def _time(told: dict[str, str], at: str) -> datetime:
    for label, text in told.items():
        if jd := re.fullmatch(r"Date_+JD(UT|TT|TDB|CT)", label):
            return utc_of_julian_date(plain_number(text, "Julian date", at), jd[1])
    for label, text in told.items():
        if calendar := re.fullmatch(r"Date__\((UT|TT|TDB|CT)\)__HR:MN(?::S[SC](?:\.f+)?)?", label):
            words = text.split()
            if len(words) < 2:
                raise BadRequest(f"{at}: {text.strip()!r} is not a time such as 2022-Jun-10 00:00")
            return calendar_instant(words[0], words[1], calendar[1], at)
    shown = next((label for label in told if label.startswith("Date_")), "none")
    raise BadRequest(
        f"the times ({shown}) are in a scale or zone that is not supported; UT, TT and TDB are", advice=_ASK
    )


_KINDS: Final = (
    ("astrometric", re.compile(r"R\.A\._*\((?:ICRF|ICRF/J2000\.0|J2000\.0)\)(?:_*DEC)?")),
    ("apparent", re.compile(r"R\.A\._*\(a-app(?:arent|ar|r)?\)(?:_*DEC)?\.?_?")),
)


def _place(columns: _Columns, told: dict[str, str], utc: datetime, at: str) -> tuple[Icrs, float, float]:
    """Place, its last digit and what its kind costs."""
    for kind, form in _KINDS:
        label = next((one for one in columns.labels if form.fullmatch(one)), None)
        if label is None:
            continue
        if columns.csv:
            index = columns.labels.index(label)
            following = columns.labels[index + 1] if index + 1 < len(columns.labels) else ""
            if not following.startswith("DEC"):
                raise BadRequest(f"beside {label} stands no declination, but {following!r}")
            ra_parts, dec_parts = told[label].split(), told[following].split()
        else:
            ra_parts, dec_parts = _both(told[label], at)
        ra, ra_digit = ra_of(ra_parts, at)
        dec, dec_digit = dec_of(dec_parts, at)
        digit = max(ra_digit * math.cos(math.radians(dec)), dec_digit)
        if kind == "astrometric":
            return Icrs(ra, dec), digit, 0.0
        return apparent_to_icrs(Apparent(ra, dec, utc)), digit, _APPARENT_SIGMA_ARCSEC
    others = ", ".join(one for one in columns.labels if one.startswith("R.A.")) or "none"
    raise BadRequest(
        f"there is no column with astrometric or airless apparent right ascension (there: {others})",
        advice=_ASK,
    )


def _both(text: str, at: str) -> tuple[list[str], list[str]]:
    """Right ascension and declination of one field, after the marks of Sun and Moon."""
    words = text.split()
    while words and re.fullmatch(r"[*CNA]?[a-z]?", words[0]):
        words = words[1:]
    if len(words) == 6:
        return words[:3], words[3:]
    if len(words) == 2:
        return words[:1], words[1:]
    raise BadRequest(f"{at}: {text.strip()[:40]!r} is not a right ascension and declination")


def _distance(told: dict[str, str], unit: str | None, at: str) -> float | None:
    text = told.get("delta")
    if text is None or text.strip() in ("", "n.a."):
        return None
    value = plain_number(text, "distance", at)
    if not value > 0.0:
        raise BadRequest(f"{at}: a distance of {value:g} is impossible")
    if unit is None and _MOST_AU < value <= _LARGE_KM:
        raise BadRequest(
            f"{at}: a distance of {value:g} is in au or in km, and the table doesn't say which",
            advice="copy the answer whole: its unit stands below the table",
        )
    return value / AU_KM if unit == "KM" or (unit is None and value > _LARGE_KM) else value


def _three_sigma(told: dict[str, str], at: str) -> float:
    """One sigma of the 3σ columns, if they are there; the larger of both axes."""
    largest = 0.0
    for label in ("RA_3sigma", "DEC_3sigma", "SMAA_3sig", "POS_3sigma"):
        text = told.get(label, "").strip()
        if text and text != "n.a.":
            largest = max(largest, abs(plain_number(text, label, at)) / 3.0)
    return largest
