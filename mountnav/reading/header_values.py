"""Numbers, units and angles out of header cards, in every form that programs write them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

Value = str | int | float | bool
Header = Mapping[str, Value]
Comments = Mapping[str, str]

_NUMBER_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?)\s*([^\d\s].*)?$")
# sign, then up to three fields; only the last of them may have decimals
_FIELDS = re.compile(
    r"([+-]?)\s*(\d{1,3})\s*([:hd°*\s])\s*(\d{1,2}(?:\.\d*)?)\s*(?:[:m'′\s]\s*(\d{1,2}(?:\.\d*)?))?\s*[ms\"″']*$",
    re.I,
)


def number(value: object) -> float | None:
    """Return a finite number, written as one or as text without a unit; None for all else."""
    if value is None or isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        result = float(value)
    except (ValueError, OverflowError):
        return None
    return result if math.isfinite(result) else None


def number_unit(header: Header, comments: Comments, key: str) -> tuple[float, str] | None:
    """Return a card's number, and in lower case what value and comment say about its unit."""
    value, told = header.get(key), comments.get(key, "")
    found = number(value)
    if found is None and isinstance(value, str) and (match := _NUMBER_UNIT.match(value)):
        found, told = number(match[1].upper().replace("D", "E")), f"{match[2] or ''} {told}"
    return None if found is None else (found, told.lower())


def sexagesimal(text: str) -> tuple[float, bool] | None:
    """Read "12 34 56.7", "-0:30.5", "5h35m17s" or "+22*30'15".

    Returns
    -------
    value : float
        In units of the first field; "-00 30 00" is -0.5.
    degrees : bool
        The text itself says that the first field counts degrees.
    """
    match = _FIELDS.match(text.strip())
    if match is None or ("." in match[4] and match[5]):
        return None
    minutes, seconds = float(match[4]), float(match[5] or 0.0)
    if minutes >= 60.0 or seconds >= 60.0:
        return None
    size = int(match[2]) + minutes / 60.0 + seconds / 3600.0
    return (-size if match[1] == "-" else size), match[3].lower() in ("d", "°", "*")
