"""Alpaca's parameters, paths and envelopes, by the standard's own rules. No I/O [Alpaca §1, §2, §6].

Parameters: GET has them in the query, names in any case; PUT in a form, names in exactly this case; another
is as if absent. What can't be read is `BadParameter` (HTTP 400); what can be read and is out of range is
the member's business (200 with 0x401). In a path case counts, and so does each slash. The JSON around each
answer has exactly the standard's keys, never one more.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal
from urllib.parse import parse_qsl

from api.alpaca.errors import AlpacaError

__all__ = [
    "LARGEST_ID",
    "NOTHING",
    "BadParameter",
    "DevicePath",
    "ManagementPath",
    "Page",
    "SetupPath",
    "Transactions",
    "decimal",
    "envelope",
    "from_form",
    "from_query",
    "instant",
    "read_path",
    "required",
    "truth",
    "turned",
    "unsigned",
    "whole",
    "words",
]


LARGEST_ID = 2**32 - 1
"""Largest client, transaction and device number: unsigned 32 bits [Alpaca §2]."""
_MOST_FIELDS = 100
"""Fields of a query or form; chosen by hand, far above what a member takes. Doubled, nonsense takes twice
as long to parse."""
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
        raise BadParameter(f"{name} is not a date and time: {text[:40]!r}") from None


def unsigned(text: str | None) -> int:
    """A client's number or transaction; 0, which is never wrong, for what is none."""
    if text is None or _UNSIGNED.fullmatch(text) is None or (value := int(text)) > LARGEST_ID:
        return 0
    return value


_DEVICE = re.compile(r"/api/v1/telescope/([0-9]{1,10})/([a-z0-9]+)")
_SETUP = re.compile(r"/setup/v1/telescope/([0-9]{1,10})/setup")

Page = Literal["apiversions", "description", "configureddevices"]
_PAGES: dict[str, Page] = {
    "/management/apiversions": "apiversions",
    "/management/v1/description": "description",
    "/management/v1/configureddevices": "configureddevices",
}


@dataclass(frozen=True, slots=True)
class DevicePath:
    """A member of a telescope."""

    number: int
    command: str


@dataclass(frozen=True, slots=True)
class ManagementPath:
    """One of the management's three answers."""

    page: Page


@dataclass(frozen=True, slots=True)
class SetupPath:
    """A page for people: the server's (None) or a telescope's."""

    number: int | None


def read_path(path: str) -> DevicePath | ManagementPath | SetupPath | None:
    """What a path asks for; None if it is none of ours."""
    if (page := _PAGES.get(path)) is not None:
        return ManagementPath(page)
    if path in ("/setup", "/setup/"):
        return SetupPath(None)
    if (found := _DEVICE.fullmatch(path)) is not None and int(found[1]) <= LARGEST_ID:
        return DevicePath(int(found[1]), found[2])
    if (found := _SETUP.fullmatch(path)) is not None and int(found[1]) <= LARGEST_ID:
        return SetupPath(int(found[1]))
    return None


class Transactions:
    """Counts the server's transactions: 1, 2, ... and from the largest number of 32 bits back to 1."""

    def __init__(self, last: int = 0) -> None:
        self._last = last

    def next(self) -> int:
        """The next number."""
        self._last = 1 if self._last >= LARGEST_ID else self._last + 1
        return self._last


class _Nothing:
    pass


NOTHING = _Nothing()
"""For answers without a value: those to a PUT."""


def envelope(
    client_transaction: int,
    server_transaction: int,
    value: object = NOTHING,
    error: AlpacaError | None = None,
    *,
    of_device: bool = True,
) -> bytes:
    """An answer as JSON.

    Parameters
    ----------
    value : object
        JSON of it must exist; left out if `NOTHING`.
    of_device : bool
        Answers of the management have no error.

    Raises
    ------
    ValueError
        NaN or an infinity is among the values: no JSON can hold it.
    """
    answer: dict[str, object] = {} if value is NOTHING else {"Value": value}
    answer |= {"ClientTransactionID": client_transaction, "ServerTransactionID": server_transaction}
    if of_device:
        answer |= {
            "ErrorNumber": 0 if error is None else error.number,
            "ErrorMessage": "" if error is None else error.words or "refused",
        }
    return json.dumps(answer, allow_nan=False).encode()


def turned(angle: float, turn: float) -> float:
    """An angle in [0, turn): ``%`` alone gives `turn` itself for a tiny negative one [§10]."""
    rest = math.fmod(angle, turn)
    if rest < 0.0:
        rest += turn
    return 0.0 if rest >= turn else rest + 0.0
