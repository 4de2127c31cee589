"""Parameters of Alpaca requests: names, numbers, truth values, by the standard's own rules. No I/O.

GET: in the query, names in any case. PUT: in a form, names in exactly this case; another is as if absent.
What can't be read is `BadParameter` (HTTP 400); what can be read and is out of range is the member's business
(200 with 0x401) [Alpaca §1, §2].
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from urllib.parse import parse_qsl

LARGEST_ID = 2**32 - 1
_MOST_FIELDS = 100
_DECIMAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,4})?")
_WHOLE = re.compile(r"[+-]?[0-9]{1,10}")
_UNSIGNED = re.compile(r"[0-9]{1,10}")


class BadParameter(Exception):
    """A parameter that is missing, or can't be read: HTTP 400 with plain words."""


def from_query(query: bytes) -> dict[str, str]:
    """Of a GET: by their names in lower case; the first of several counts. Raises `BadParameter`."""
    return {name.lower(): value for name, value in reversed(_fields(query))}


def from_form(body: bytes) -> dict[str, str]:
    """Of a PUT: by their names as written; the first of several counts. Raises `BadParameter`."""
    return dict(reversed(_fields(body)))


def _fields(text: bytes) -> list[tuple[str, str]]:
    try:
        # latin-1 loses no byte; what is escaped is UTF-8
        return parse_qsl(
            text.decode("latin-1"), keep_blank_values=True, encoding="utf-8", max_num_fields=_MOST_FIELDS
        )
    except ValueError as error:
        raise BadParameter(f"the parameters can't be read: {error}") from None


def required(parameters: Mapping[str, str], name: str, *, any_case: bool) -> str:
    """One parameter's text. Raises `BadParameter` when it is missing."""
    found = parameters.get(name.lower() if any_case else name)
    if found is None:
        raise BadParameter(f"the parameter {name} is missing")
    return found


def decimal(name: str, text: str) -> float:
    """A number with a decimal point, no thousands, finite. Raises `BadParameter`."""
    if _DECIMAL.fullmatch(text) is None or not math.isfinite(value := float(text)):
        raise BadParameter(f"{name} is not a finite decimal number: {text[:40]!r}")
    return value


def whole(name: str, text: str) -> int:
    """A whole number of 32 bits. Raises `BadParameter`."""
    if _WHOLE.fullmatch(text) is None or not -(2**31) <= (value := int(text)) < 2**31:
        raise BadParameter(f"{name} is not a whole number: {text[:40]!r}")
    return value


def truth(name: str, text: str) -> bool:
    """``true`` or ``false`` in any case. Raises `BadParameter`."""
    match text.lower():
        case "true":
            return True
        case "false":
            return False
    raise BadParameter(f"{name} is neither true nor false: {text[:40]!r}")


def words(name: str, text: str) -> str:
    """Any text."""
    return text


def instant(name: str, text: str) -> datetime:
    """An instant of UTC, with Z, an offset, or neither. Raises `BadParameter`."""
    try:
        found = datetime.fromisoformat(text)
        return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
    except (ValueError, OverflowError):
        raise BadParameter(f"{name} is no date and time: {text[:40]!r}") from None


def unsigned(text: str | None) -> int:
    """A client's number or transaction; 0, which is never wrong, for what is none."""
    if text is None or _UNSIGNED.fullmatch(text) is None or (value := int(text)) > LARGEST_ID:
        return 0
    return value


__all__ = [
    "LARGEST_ID",
    "BadParameter",
    "decimal",
    "from_form",
    "from_query",
    "instant",
    "required",
    "truth",
    "unsigned",
    "whole",
    "words",
]
