"""What stands in the options of a URL: numbers, and yes or no."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches

from mountnav.errors import BadSettings

_LARGEST = 1e9
_WORDS = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}


def require_known(options: Mapping[str, str], known: Iterable[str], what: str) -> None:
    """Raise `BadSettings` unless all options are known ones."""
    known = tuple(known)
    unknown = sorted(set(options) - set(known))
    if unknown:
        near = [close[0] for one in unknown if (close := get_close_matches(one, known, n=1, cutoff=0.6))]
        meant = f"did you mean {', '.join(near)}? " if near else ""
        raise BadSettings(
            f"unknown option {', '.join(unknown)} for {what}", advice=f"{meant}known: {', '.join(known)}"
        )


def whole_of(options: Mapping[str, str], option: str, default: int, least: int, most: int) -> int:
    """Read a whole number within bounds, or raise `BadSettings`; by default `default`."""
    text = options.get(option)
    if text is None:
        return default
    if not (text.isascii() and text.isdigit() and len(text) < 10 and least <= int(text) <= most):
        raise BadSettings(
            f"{option}={text} makes no sense",
            advice=f"a whole number from {least} to {most}, such as {default}",
        )
    return int(text)


def number_of(
    options: Mapping[str, str],
    option: str,
    default: float,
    *,
    may_be_zero: bool = False,
    most: float = _LARGEST,
) -> float:
    """Read a number above 0 (or 0, where that may be), or raise `BadSettings`; by default `default`."""
    text = options.get(option)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not (0.0 < value <= most or (may_be_zero and value == 0.0)):
        advice = "a number above 0" if most == _LARGEST else f"a number above 0, at most {most:g}"
        raise BadSettings(f"{option}={text} makes no sense", advice=advice)
    return value


def maybe_number_of(options: Mapping[str, str], option: str) -> float | None:
    """As `number_of`; None where it isn't there."""
    return number_of(options, option, 1.0) if option in options else None


def yes_of(options: Mapping[str, str], option: str, *, default: bool) -> bool:
    """Read yes or no, or raise `BadSettings`; `default` where it isn't there."""
    text = options.get(option)
    if text is None:
        return default
    if text.lower() not in _WORDS:
        raise BadSettings(f"{option}={text} is neither yes nor no", advice="yes or no")
    return _WORDS[text.lower()]
