"""Two-line elements of Earth satellites, as Celestrak and Space-Track write them.

Strict: the columns are where they belong, the checksums are right, and both lines are of one object.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta

from mountnav.ephemeris.satellite import SatelliteElements
from mountnav.errors import BadRequest

MOST_NAME = 80
"""Letters of a satellite's name that are kept; the standard has 24. Doubled, messages are longer."""

_ID = r"(?P<id>[A-HJ-NP-Z0-9 ][0-9 ]{4})"
_ANGLE = r"[0-9 ]{3}\.[0-9]{4}"
_LINE_1 = re.compile(
    rf"1 {_ID}[A-Z ] (?P<intl>[0-9A-Z ]{{8}}) "
    r"(?P<year>[0-9]{2})(?P<day>[0-9 ]{3}\.[0-9]{8}) (?P<dot>[ +-]\.[0-9]{8}) "
    r"(?P<ddot>[ +-][0-9]{5}[+-][0-9]) (?P<bstar>[ +-][0-9 ]{5}[+-][0-9]) (?P<kind>[0-9 ]) "
    r"[0-9 ]{4}(?P<sum>[0-9])"
)
_LINE_2 = re.compile(
    rf"2 {_ID} (?P<incl>{_ANGLE}) (?P<node>{_ANGLE}) (?P<ecc>[0-9 ]{{7}}) "
    rf"(?P<perigee>{_ANGLE}) (?P<anomaly>{_ANGLE}) (?P<motion>[0-9 ]{{2}}\.[0-9]{{8}})"
    r"[0-9 ]{5}(?P<sum>[0-9])"
)
_SHORTEST = 69
"""Letters of a line, its checksum the last."""
_PIVOT_YEAR = 57
"""Two-digit years from 57 on are of the last century: Sputnik flew then."""
_SGP4_XP = "4"
"""Ephemeris type of elements for SGP4-XP, another theory that isn't public: SGP4 would be kilometers
wrong."""


def looks_like_tle(text: str) -> bool:
    """Whether a text holds a first line of two-line elements."""
    return re.search(r"(?m)^1 [A-Z0-9 ]{5}[A-Z ] ", text) is not None


def read_tle(text: str) -> tuple[SatelliteElements, ...]:
    """Read sets of two lines, each with or without a name's line before it (two- and three-line forms).

    Parameters
    ----------
    text : str
        Blank lines and lines that begin with ``#`` don't count.

    Returns
    -------
    tuple of SatelliteElements
        In the order of the text.

    Raises
    ------
    BadRequest
        A line is wrong: which, and what about it.
    """
    found = tuple(iterate_tle(text.splitlines()))
    if not found:
        raise BadRequest("there are no two-line elements in it", advice="a set begins with '1 ' and '2 '")
    return found


def iterate_tle(lines: Iterable[str]) -> Iterator[SatelliteElements]:
    """As `read_tle`, line by line, for long files. Raises BadRequest."""
    name, first = "", ""
    first_number = 0
    for number, raw in enumerate(lines, 1):
        line = raw.rstrip()
        if not line or line.startswith("#"):
            continue
        if first:
            yield _elements(name, first, first_number, line, number)
            name, first = "", ""
        elif re.match(r"1 [A-Z0-9 ]{5}[A-Z ] ", line):
            first, first_number = line, number
        elif re.match(r"2 [A-Z0-9 ]{5} ", line) and len(line) >= _SHORTEST - 1:
            raise BadRequest(f"line {number} is a second line without a first")
        elif name:
            raise BadRequest(
                f"line {number} is neither a name nor a first line of elements: {line[:30]!r}",
                advice="a set is: name (or none), '1 ...', '2 ...'",
            )
        else:
            name = line.removeprefix("0 ").strip()[:MOST_NAME]
    if first:
        raise BadRequest(f"the elements end after the first line (line {first_number})")
    if name:
        raise BadRequest(f"after the name {name[:30]!r} come no elements")


def _elements(name: str, first: str, first_at: int, second: str, second_at: int) -> SatelliteElements:
    one = _matched(_LINE_1, first, first_at, "first")
    two = _matched(_LINE_2, second, second_at, "second")
    if one["id"] != two["id"]:
        raise BadRequest(
            f"lines {first_at} and {second_at} are of different objects: {one['id']} and {two['id']}"
        )
    if one["kind"] == _SGP4_XP:
        raise BadRequest(
            f"line {first_at} is for SGP4-XP, which isn't public", advice="get elements of ephemeris type 0"
        )
    year = int(one["year"])
    year += 1900 if year >= _PIVOT_YEAR else 2000
    day = float(one["day"])
    if not 1.0 <= day < 367.0:
        raise BadRequest(f"line {first_at}: there is no day {one['day'].strip()} of a year")
    norad_id = _number(one["id"])
    epoch = datetime(year, 1, 1, tzinfo=UTC) + timedelta(days=day - 1.0)
    international = one["intl"].strip()
    return SatelliteElements(
        name=name or f"satellite {norad_id}",
        norad_id=norad_id,
        epoch_utc=epoch,
        mean_motion_rev_day=float(two["motion"]),
        eccentricity=float("0." + two["ecc"].replace(" ", "0")),
        inclination_deg=float(two["incl"]),
        node_deg=float(two["node"]),
        perigee_deg=float(two["perigee"]),
        mean_anomaly_deg=float(two["anomaly"]),
        bstar=_power(one["bstar"]),
        motion_dot_rev_day2=float(one["dot"].replace(" ", "")),
        motion_ddot_rev_day3=_power(one["ddot"]),
        international_id=_international(international),
    )


def _matched(form: re.Pattern[str], line: str, at: int, which: str) -> dict[str, str]:
    if len(line) < _SHORTEST:
        raise BadRequest(
            f"line {at} has {len(line)} letters, a {which} line of elements has {_SHORTEST}",
            advice="copy the lines whole, with all blanks and the checksum at the end",
        )
    fields = form.fullmatch(line)
    if fields is None:
        raise BadRequest(
            f"line {at} is not a {which} line of elements, its columns are in other places: {line[:24]!r}...",
            advice="copy the lines whole, with all blanks",
        )
    want = checksum(line)
    if int(fields["sum"]) != want:
        raise BadRequest(
            f"the checksum of line {at} is {fields['sum']}, its digits give {want}: it was changed",
            advice="get the elements again",
        )
    try:
        for key in ("day", "incl", "node", "perigee", "anomaly", "motion"):
            if key in fields.re.groupindex:
                float(fields[key])
        _number(fields["id"])
    except ValueError as wrong:
        raise BadRequest(f"line {at} has a blank within a number") from wrong
    return {key: value or "" for key, value in fields.groupdict().items()}


def checksum(line: str) -> int:
    """The last digit of the sum of a line's digits, each minus sign counting as one."""
    return sum(int(one) if one in "0123456789" else one == "-" for one in line[:68]) % 10


def _number(text: str) -> int:
    """A catalog number, in the Alpha-5 form from 100,000 on: A0000 is 100000; I and O are left out."""
    if text[0].isalpha():
        letters = "ABCDEFGHJKLMNPQRSTUVWXYZ"
        return (letters.index(text[0]) + 10) * 10_000 + int(text[1:])
    return int(text)


def _power(text: str) -> float:
    """A number such as ``-12345-6``: -0.12345e-6."""
    digits = text[1:6].replace(" ", "0")
    return float(f"{text[0].strip()}0.{digits}e{text[6:8]}")


def _international(text: str) -> str:
    if not re.fullmatch(r"[0-9]{5}[A-Z]{1,3}", text):
        return ""
    year = int(text[:2])
    return f"{year + (1900 if year >= _PIVOT_YEAR else 2000)}-{text[2:]}"
