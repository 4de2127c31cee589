"""TOML and JSON that somebody else wrote, parsed by the library: a refusal is a syntax error with its place.

The parsers give up on deep nesting and on numbers of thousands of digits with errors of other kinds, and
tomllib takes a time that grows with the square of a dotted key's parts: 22 s for 40 kB of ``a.a.a``. A whole
number of some hundred digits they take, and a float of it is an `OverflowError`: it is refused
here.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Hashable, Iterable
from typing import Any, TypeVar

_Name = TypeVar("_Name", bound=Hashable)

MOST_KEY_PARTS = 32
"""Parts of a dotted key; ours have four at most. tomllib takes 0.1 ms for as many; twice as many, 0.4."""

MOST_TOML_BYTES = 1_000_000
"""Longest TOML: settings of 100 telescopes have 100 kB. Doubled, a file that was made for it takes twice as
long to read."""

MOST_WHOLE = 2**64
"""Largest whole number, in its amount, that is taken: TOML promises 64 bits, and star numbers of catalogs
have as many. Squared it would fit into a float still; from 309 digits on none does."""

_KEY_PART = r"""(?:[\w-]{1,200}|"[^"\n]{0,200}"|'[^'\n]{0,200}')[ \t]*\.[ \t]*"""
_LONG_KEY = re.compile(f"(?:{_KEY_PART}){{{MOST_KEY_PARTS}}}")
_LONG_NUMBER = re.compile(r"[0-9_]{4000}")


def toml_of(text: str) -> dict[str, Any]:
    """Parse TOML.

    Returns
    -------
    dict
        Tables, as nested dictionaries.

    Raises
    ------
    tomllib.TOMLDecodeError
        Wrong, too long, nested too deep, or with a number or a key that no file of ours has.
    """
    if len(text) > MOST_TOML_BYTES:
        raise _toml_fault(f"Longer than {MOST_TOML_BYTES / 1e6:g} MB", text, MOST_TOML_BYTES)
    if long := _LONG_KEY.search(text):
        raise _toml_fault(f"Dotted key of more than {MOST_KEY_PARTS} parts", text, long.start())
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise _toml_fault("Nested too deep", text, _deepest(text)) from None
    except (ValueError, OverflowError) as fault:
        number = _LONG_NUMBER.search(text)
        what = "Number with too many digits" if number else f"Invalid value: {fault}"
        raise _toml_fault(what, text, number.start() if number else 0) from fault
    if _holds_too_large(values):
        raise _toml_fault("Number with too many digits", text, _longest_number(text))
    return values


def json_of(text: str | bytes | bytearray) -> Any:
    """Parse JSON.

    Parameters
    ----------
    text : str or bytes
        UTF-8.

    Raises
    ------
    json.JSONDecodeError
        Wrong, no UTF-8, nested too deep, or with a number of too many digits.
    """
    try:
        return json.loads(text, parse_int=_whole)
    except json.JSONDecodeError:
        raise
    except UnicodeDecodeError as fault:
        raise json.JSONDecodeError("No UTF-8", "", 0) from fault
    except (RecursionError, ValueError) as fault:
        plain = text if isinstance(text, str) else text.decode("utf-8", "replace")
        if isinstance(fault, RecursionError):
            raise json.JSONDecodeError("Nested too deep", plain, _deepest(plain)) from None
        raise json.JSONDecodeError("Number with too many digits", plain, _longest_number(plain)) from fault


def repeated(names: Iterable[_Name]) -> list[_Name]:
    """Find what stands there more than once, in the order of its first place, each name once.

    One pass: to count each name in the whole list takes a time that grows with its square, and a
    stranger who sends 25,000 keys stops the service for seconds.
    """
    return [name for name, times in Counter(names).items() if times > 1]


def _whole(digits: str) -> int:
    number = int(digits)
    if abs(number) > MOST_WHOLE:
        raise ValueError("a number with too many digits")
    return number


def _holds_too_large(values: object) -> bool:
    """Whether a whole number beyond `MOST_WHOLE` stands anywhere in it."""
    waiting = [values]
    while waiting:
        match waiting.pop():
            case dict() as table:
                waiting.extend(table.values())
            case list() as many:
                waiting.extend(many)
            case int() as number if abs(number) > MOST_WHOLE:
                return True
            case _:
                pass
    return False


def _longest_number(text: str) -> int:
    """Where the most digits stand in a row, for the place that a refusal tells."""
    rows = re.finditer(r"[0-9][0-9a-fA-FxX_]*", text)
    longest = max(rows, key=lambda row: row.end() - row.start(), default=None)
    return longest.start() if longest else 0


def _deepest(text: str) -> int:
    """Where brackets are nested deepest; those in strings are counted too, for the place is a help only."""
    depth = deepest = at = 0
    for found in re.finditer(r"[\[{\]}]", text):
        depth += 1 if found[0] in "[{" else -1
        if depth > deepest:
            deepest, at = depth, found.start()
    return at


def _toml_fault(what: str, text: str, at: int) -> tomllib.TOMLDecodeError:
    """As tomllib tells of a fault: with line and column, from 1."""
    if sys.version_info >= (3, 14):
        return tomllib.TOMLDecodeError(what, text, at)
    line = text.count("\n", 0, at) + 1
    column = at - (text.rfind("\n", 0, at) + 1) + 1
    return tomllib.TOMLDecodeError(f"{what} (at line {line}, column {column})")
