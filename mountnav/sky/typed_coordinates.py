"""Coordinates as people type them: a position or a name; a lone or ambiguous coordinate is refused.

The rules (`docs/explanation/coordinates.md` has them for users; `api/web/js/angles.js` reads by the same
ones, and `tests/sky/typed_coordinates.json` holds both to them):

1. A position has two coordinates. They are parted by a comma or semicolon, by the declination's sign, or by
   nothing but blanks; then there must be exactly one way to part them.
2. A text that could be one coordinate alone ("12h30m", "10:30", "10 30") is refused: declination is missing.
3. Without a unit, a right ascension of two or three numbers is in hours, one with a decimal point or from 24
   on is in degrees; a whole number below 24 could be either, and is refused.
4. Within a coordinate only the last number has a decimal point, and minutes and seconds are below 60.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mountnav.errors import BadRequest

LONGEST_TEXT = 100
"""Characters; the longest position with all its units and labels has about 60."""

_LOOSE = re.ASCII | re.IGNORECASE
"""The same letters and digits count here as in JavaScript."""
_REPLACED = (
    (re.compile("[ \t\n\r\u00a0\u2007\u2009\u202f]+"), " "),
    (re.compile("[−–—]"), "-"),
    (re.compile("[′’´]"), "'"),
    (re.compile("[″”]|''"), '"'),
    (re.compile("º"), "°"),
    (re.compile("[ʰʱ]"), "h"),
    (re.compile("ᵐ"), "m"),
    (re.compile("ˢ"), "s"),
)
_LABEL = re.compile(r"\b(?:ra|dec|alpha|delta|icrs|j2000)\b *[:=]?|[αδ] *[:=]?", _LOOSE)
_NUMBERLIKE = re.compile(r"[0-9+\-.,; :°'\"hmsd]*", _LOOSE)
_BEGINS_A_NUMBER = re.compile(r"[+-]? *[0-9.]")
_NUMBER = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)"
# one coordinate, its numbers parted in one way: by colons, by blanks, or by units
_COLONS = re.compile(rf"([+-]?) *({_NUMBER}):({_NUMBER})(?::({_NUMBER}))?")
_BLANKS = re.compile(rf"([+-]?) *({_NUMBER})(?: +({_NUMBER})(?: +({_NUMBER}))?)?")
_UNITS = re.compile(
    rf"([+-]?) *({_NUMBER}) *([hd°]) *(?:({_NUMBER}) *[m']? *(?:(?<=[m' ])({_NUMBER}) *[s\"]?)?)?", _LOOSE
)
# what may be one coordinate, however its numbers are parted
_ONE = re.compile(rf"[+-]? *{_NUMBER} *[hd°:]?(?: *{_NUMBER} *[m':]?(?: *{_NUMBER} *[s\"]?)?)?", _LOOSE)
_BEGINS = re.compile(r"(?<=[ °'\"hmsd])[0-9.]+", _LOOSE)
_MISSING = "Declination is missing, or it is not clear where it begins: put a comma before it, or its sign."


@dataclass(frozen=True, slots=True)
class TypedPosition:
    """A position as it was typed.

    Attributes
    ----------
    ra_deg, dec_deg : float
        In whatever frame the person means.
    ra_in_hours : bool
        Whether the right ascension was read as hours: worth showing before anything moves.
    """

    ra_deg: float
    dec_deg: float
    ra_in_hours: bool


@dataclass(frozen=True, slots=True)
class TypedName:
    """What was typed is no number: the name of an object, perhaps."""

    name: str


@dataclass(frozen=True, slots=True)
class _Numbers:
    """The numbers of one coordinate, as text."""

    sign: str
    unit: str
    head: str
    minutes: str | None
    seconds: str | None


def read_target(text: str) -> TypedPosition | TypedName:
    """Read what was typed into one field: a position, or a name.

    Raises
    ------
    BadRequest
        It is empty, a lone or ambiguous coordinate, or out of range.
    """
    plain = _plain(text)
    if not plain:
        raise _refused("Nothing was typed.")
    bare = _LABEL.sub(" ", plain).strip(" ")
    if _NUMBERLIKE.fullmatch(bare) is None or _BEGINS_A_NUMBER.match(bare) is None:
        return TypedName(plain)
    first, second = _parted(bare)
    ra_deg, ra_in_hours = _ra(first)
    return TypedPosition(ra_deg, _dec(second), ra_in_hours)


def read_position(text: str) -> TypedPosition:
    """Read a position.

    Raises
    ------
    BadRequest
        It is none, a lone or ambiguous coordinate, or out of range.
    """
    read = read_target(text)
    if isinstance(read, TypedName):
        raise _refused(f'"{read.name}" is not a position.')
    return read


def read_ra_deg(text: str) -> float:
    """Read a right ascension where the field says that it is one; a single number without a unit is degrees.

    Raises
    ------
    BadRequest
        It can't be read, or is out of range.
    """
    return _ra(_LABEL.sub(" ", _plain(text)).strip(" "), whole_is_degrees=True)[0]


def read_dec_deg(text: str) -> float:
    """Read a declination where the field says that it is one.

    Raises
    ------
    BadRequest
        It can't be read, or is out of range.
    """
    return _dec(_LABEL.sub(" ", _plain(text)).strip(" "))


def _plain(text: str) -> str:
    if len(text) > LONGEST_TEXT:
        raise _refused(f"More than {LONGEST_TEXT} characters.")
    for found, written in _REPLACED:
        text = found.sub(written, text)
    return text.strip(" ")


def _parted(text: str) -> tuple[str, str]:
    parts = [part.strip(" ") for part in re.split(r"[,;]", text)]
    if len(parts) > 2:
        raise _refused("More than one comma: put one before the declination, and points in numbers.")
    if len(parts) == 2:
        if re.search(r"(?<![0-9.])[0-9]+,[0-9]+$", text) is not None:
            raise _refused("Is that comma a decimal point? Put a blank after it if it is not.")
        return parts[0], parts[1]
    signs = [found.start() for found in re.finditer(r"[+-]", text) if found.start() > 0]
    if len(signs) > 1:
        raise _refused("There is more than one sign.")
    if signs:
        return text[: signs[0]].strip(" "), text[signs[0] :].strip(" ")
    if _ONE.fullmatch(text) is not None and not _points_within(text):
        raise _refused(_MISSING)
    # a coordinate begins after a blank or a unit, never within one's own colons or digits
    begins = [found.start() for found in _BEGINS.finditer(text)]
    ways = [(text[:at].strip(" "), text[at:].strip(" ")) for at in begins]
    ways = [way for way in ways if _is_coordinate(way[0], hours=True) and _is_coordinate(way[1], hours=False)]
    if len(ways) != 1:
        raise _refused(_MISSING if len(ways) != 0 or len(begins) < 2 else "That can't be read as a position.")
    return ways[0]


def _points_within(text: str) -> bool:
    """Whether a number before the last one has a decimal point: then it is the last of its coordinate."""
    return any("." in number for number in re.findall(_NUMBER, text)[:-1])


def _is_coordinate(text: str, *, hours: bool) -> bool:
    numbers = _numbers(text)
    return numbers is not None and not _points_within(text) and (hours or numbers.unit != "h")


def _numbers(text: str) -> _Numbers | None:
    if (found := _COLONS.fullmatch(text)) is not None:
        return _Numbers(found[1], ":", found[2], found[3], found[4])
    if (found := _UNITS.fullmatch(text)) is not None:
        unit = "h" if found[3].lower() == "h" else "°"
        return _Numbers(found[1], unit, found[2], found[4], found[5])
    if (found := _BLANKS.fullmatch(text)) is not None:
        return _Numbers(found[1], "", found[2], found[3], found[4])
    return None


def _size(name: str, text: str) -> tuple[float, _Numbers]:
    numbers = _numbers(text)
    if numbers is None:
        raise _refused(f'{name} can\'t be read: "{text}".')
    if _points_within(text):
        raise _refused(f"{name}: only the last number may have a point.")
    minutes, seconds = float(numbers.minutes or 0.0), float(numbers.seconds or 0.0)
    if minutes >= 60.0:
        raise _refused(f"{name}: minutes go up to 59.")
    if seconds >= 60.0:
        raise _refused(f"{name}: seconds go up to 59.")
    return float(numbers.head) + minutes / 60.0 + seconds / 3600.0, numbers


def _ra(text: str, *, whole_is_degrees: bool = False) -> tuple[float, bool]:
    size, numbers = _size("Right ascension", text)
    if numbers.sign == "-":
        raise _refused("Right ascension has no minus.")
    hours = numbers.unit == "h" or (numbers.minutes is not None and numbers.unit != "°")
    alone = numbers.unit == "" and numbers.minutes is None
    if alone and not whole_is_degrees and "." not in numbers.head and 0.0 < size < 24.0:
        head = numbers.head
        raise _refused(f"Is right ascension {head} hours or degrees? Write {head}h, {head}° or {head}.0.")
    if size >= (24.0 if hours else 360.0):
        raise _refused(f"Right ascension goes up to {'24 h' if hours else '360°'}.")
    return (size * 15.0, True) if hours else (size, False)


def _dec(text: str) -> float:
    size, numbers = _size("Declination", text)
    if numbers.unit == "h":
        raise _refused("Declination is in degrees, not in hours.")
    if size > 90.0:
        raise _refused("Declination goes from -90° to +90°.")
    return -size if numbers.sign == "-" else size


def _refused(why: str) -> BadRequest:
    return BadRequest(
        why, advice='type both coordinates, for example "05h34m31.9s +22°00′52″" or "83.633, 22.014"'
    )


__all__ = [
    "LONGEST_TEXT",
    "TypedName",
    "TypedPosition",
    "read_dec_deg",
    "read_position",
    "read_ra_deg",
    "read_target",
]
