"""Ephemerides of the Minor Planet Center's Ephemeris Service: the text of its page, or the page itself."""

from __future__ import annotations

import html
import math
import re
from datetime import UTC, datetime
from typing import Final

from mountnav.ephemeris.angles_text import dec_of, plain_number, ra_of
from mountnav.ephemeris.table import MOST_ROWS, Observer, Table, TableRow
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs

_TITLE: Final = re.compile(r"Date {1,20}UT {1,20}R\.A\. \(J2000\) Decl\. {1,20}Delta {1,20}r ")
_ROW: Final = re.compile(r"\s*([0-9]{4}) ([0-9]{2}) ([0-9]{2})(?: ([0-9]{2,6}))?\s+(.+)")
_MOST_PAGE: Final = 3_000_000
"""Letters of a page at most: rows for two months by the minute."""
_LONGEST_LINE: Final = 600
"""Letters of a row at most, links left out."""


def looks_like_mpes(text: str) -> bool:
    """Whether a text is an answer of the MPC's ephemeris service."""
    return _TITLE.search(text) is not None or "Minor Planet Ephemeris Service" in text


def read_mpes(text: str, *, made_for: Observer | None = None) -> Table:
    """Read an ephemeris.

    Parameters
    ----------
    text : str
        Of one object.
    made_for : Observer, optional
        Whom it is for; the page tells it for the Earth's center, and gives others by a code whose coordinates
        it doesn't tell.

    Raises
    ------
    BadRequest
        It is none, or not told for whom it is.
    """
    if len(text) > _MOST_PAGE:
        raise BadRequest(f"the page is longer than {_MOST_PAGE / 1e6:g} million letters")
    plain = html.unescape(re.sub(r"</?(?!pre)[A-Za-z][^<>]{0,2000}>", "", text))
    lines = re.sub(r"</?pre[^<>]{0,200}>", "\n", plain).splitlines()
    titles = [number for number, line in enumerate(lines) if _TITLE.match(line.strip())]
    if not titles:
        raise BadRequest(
            "there is no ephemeris of right ascension and declination J2000 in it",
            advice="ask for full sexagesimal or decimal positions, J2000, not for vectors",
        )
    if len(titles) > 1:
        raise BadRequest(f"these are ephemerides of {len(titles)} objects; exactly one is needed")
    title = titles[0]
    observer = made_for or _observer(lines)
    name = _name(lines, title)
    rows: list[TableRow] = []
    digits = 0.0
    for number in range(title + 1, len(lines)):
        line = lines[number]
        if len(line) > _LONGEST_LINE:
            raise BadRequest(f"line {number + 1} is longer than {_LONGEST_LINE} letters")
        found = _ROW.fullmatch(line.rstrip())
        if found is None:
            if rows and line.strip():
                break
            continue
        row, digit = _row(found, f"line {number + 1}")
        rows.append(row)
        digits = max(digits, digit)
        if len(rows) > MOST_ROWS:
            raise BadRequest(f"the ephemeris has more than {MOST_ROWS} rows")
    return Table(name, tuple(rows), observer, digits)


def _observer(lines: list[str]) -> Observer:
    told = " ".join(" ".join(lines[:400]).split())
    found = re.search(r"Ephemerides are for (the geocenter|observatory code ([0-9A-Z]{3}))", told)
    if found and (found[1] == "the geocenter" or found[2] == "500"):
        return "geocenter"
    code = found[2] if found else None
    raise BadRequest(
        f"the ephemeris is for observatory code {code}, whose coordinates it doesn't tell"
        if code
        else "the page doesn't say for whom the ephemeris is",
        advice="ask for observatory code 500 (the geocenter: its distances allow for your place), "
        'or say made_for = "here" if it is your own',
    )


def _name(lines: list[str], title: int) -> str:
    """The object's name: the line before the elements it is based on, or the one above the table."""
    for number in range(title - 1, max(title - 40, -1), -1):
        if "ephemeris below is based on" in lines[number]:
            above = [line.strip() for line in lines[max(0, number - 4) : number] if line.strip()]
            above = [line for line in above if not line.startswith(("Number of variant", "Ephemerides"))]
            if above:
                return above[-1][:80]
    return "an object of the MPC"


def _row(found: re.Match[str], at: str) -> tuple[TableRow, float]:
    year, month, day, clock, rest = found.groups()
    clock = clock or "00"
    if len(clock) % 2:
        raise BadRequest(f"{at}: {clock!r} is not a time such as 174613")
    numbers = [int(clock[place : place + 2]) for place in range(0, len(clock), 2)] + [0, 0]
    try:
        hour, minute, second = numbers[:3]
        utc = datetime(int(year), int(month), int(day), hour, minute, second, tzinfo=UTC)
    except ValueError as wrong:
        raise BadRequest(f"{at}: {year} {month} {day} {clock} is not a time") from wrong
    ra_parts, dec_parts, after = _places(rest.split(), at)
    ra, ra_digit = ra_of(ra_parts, at)
    dec, dec_digit = dec_of(dec_parts, at)
    if len(after) < 2:
        raise BadRequest(f"{at} is cut off after the place")
    distance = plain_number(after[0], "distance", at)
    if not 0.0 < distance < 1e4:
        raise BadRequest(f"{at}: a distance of {distance:g} au is impossible")
    digit = max(ra_digit * math.cos(math.radians(dec)), dec_digit)
    return TableRow(utc, Icrs(ra, dec), distance, _uncertainty(rest)), digit


def _places(words: list[str], at: str) -> tuple[list[str], list[str], list[str]]:
    """Split into right ascension, declination, and what follows: the declination has the first sign."""
    signed = next((place for place, word in enumerate(words) if word[0] in "+-"), None)
    if signed not in (1, 2, 3):
        raise BadRequest(f"{at}: no right ascension and declination: {' '.join(words[:6])!r}")
    if signed == 1 and "." not in words[0]:
        raise BadRequest(f"{at}: {words[0]!r} is not a right ascension in degrees")
    last = 2 * signed
    return words[:signed], words[signed:last], words[last:]


def _uncertainty(rest: str) -> float:
    """One sigma of the 3σ uncertainty that stands before links, if there is one."""
    found = re.search(r"\s([0-9]{1,7}(?:\.[0-9]*)?) [0-9]{3}\.[0-9] / Map", rest)
    return float(found[1]) / 3.0 if found else 0.0
