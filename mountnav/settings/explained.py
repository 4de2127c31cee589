"""A broken settings file explained: file, line, field, what is wrong, and the fix.

tomllib doesn't say which line a setting stands on, so the lines of the TOML text are scanned for it here.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Collection
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from mountnav.errors import BadSettings

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]#]+?)\s*\]\]?\s*(?:#.*)?$")
_NAME = r"""(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')"""
_KEY = re.compile(rf"^\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*=")
_PART = re.compile(_NAME)
_LONG_QUOTES = ('"""', "'''")

Path = tuple[str | int, ...]


def line_of(text: str, path: Path) -> int | None:
    """Line (from 1) of the setting `path`, or of the nearest table that should hold it.

    Parameters
    ----------
    text : str
        A TOML text that tomllib accepted.
    path : tuple of str and int
        Keys from the top; an integer picks the n-th `[[table]]`, from 0.

    Returns
    -------
    int or None
        None when not even the first key is in the text.
    """
    lines = _lines_of_paths(text)
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return None


def _parts(dotted: str) -> list[str]:
    return [part.strip("\"'") for part in _PART.findall(dotted)]


def _lines_of_paths(text: str) -> dict[Path, int]:
    found: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    inside: str | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        if inside is not None:
            if inside in line:
                inside = None
            continue
        header = _HEADER.match(line)
        if header:
            table = _enter(_parts(header.group(2)), header.group(1) == "[[", counts)
            for length in range(1, len(table) + 1):
                found.setdefault(table[:length], number)
            continue
        key = _KEY.match(line)
        if key:
            path = table
            for part in _parts(key.group(1)):
                path = (*path, part)
                found.setdefault(path, number)
            _note_inline(line[key.end() :], path, number, found)
        inside = next((quotes for quotes in _LONG_QUOTES if line.count(quotes) == 1), None)
    return found


def _enter(names: list[str], is_array: bool, counts: dict[Path, int]) -> Path:
    """Path of the table that a header opens; `[a.b]` after `[[a]]` lies in the last `a`."""
    path: Path = ()
    for position, name in enumerate(names):
        path = (*path, name)
        if is_array and position == len(names) - 1:
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
    return path


def _note_inline(value: str, path: Path, number: int, found: dict[Path, int]) -> None:
    """Note the keys of an inline table that stands on one line: `mount = {url = "..."}`."""
    if not value.lstrip().startswith("{"):
        return
    bare = re.sub(r"\"[^\"]*\"|'[^']*'", "''", value)
    for name in re.findall(r"[{,]\s*([A-Za-z0-9_-]+)\s*=", bare):
        found.setdefault((*path, name), number)


# Faults of a file that are explained; the rest is counted. Chosen by hand to keep the message readable.
_SHOWN = 5

_LONGEST_SHOWN = 80
"""Characters of a wrong line that are told."""


def syntax_fault(name: str, text: str, error: tomllib.TOMLDecodeError) -> BadSettings:
    """Tell what to raise for a text that is not TOML."""
    found = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
    what = re.sub(r"\s*\(at [^)]*\)", "", str(error))
    lines = text.splitlines() or [""]
    number = int(found.group(1)) if found else len(lines)
    shown = lines[min(number, len(lines)) - 1].strip()[:_LONGEST_SHOWN]
    fix = f"correct this line: {shown!r}" if found else f"the file ends too early, after {shown!r}"
    return BadSettings(f"line {number}: this is not TOML: {what}", device=name, advice=fix)


def explain(
    error: ValidationError, name: str, text: str, data: dict[str, Any], *, known: Collection[str]
) -> BadSettings:
    """Tell what to raise for TOML that doesn't say what it should; the first few faults are told.

    Parameters
    ----------
    data : dict
        The parsed text, to tell keys from the tags that pydantic puts in a location.
    known : collection of str
        All names of settings, for "did you mean".
    """
    details = error.errors(include_url=False, include_input=False)
    faults = [_fault(detail, text, data, known) for detail in details[:_SHOWN]]
    if len(faults) == 1:
        what, fix = faults[0]
        return BadSettings(what, device=name, advice=fix)
    told = "; ".join(f"{what} [fix: {fix}]" for what, fix in faults)
    more = f"; and {len(details) - _SHOWN} more" if len(details) > _SHOWN else ""
    return BadSettings(
        f"{len(details)} faults: {told}{more}", device=name, advice="correct each, in this order"
    )


def _fault(detail: ErrorDetails, text: str, data: dict[str, Any], known: Collection[str]) -> tuple[str, str]:
    context = detail.get("ctx") or {}
    path = _without_tags(detail["loc"], data)
    if "key" in context:
        key = context["key"]
        path = (*path, *(key if isinstance(key, tuple) else (str(key),)))
    line = line_of(text, path)
    where = f"line {line}: " if line else ""
    return f"{where}{_dotted(path)}: {_what(detail)}", _fix(detail, path, known)


def _without_tags(loc: tuple[str | int, ...], data: object) -> tuple[str | int, ...]:
    """`loc` as keys of the file: pydantic names the variant of a tagged table in between."""
    path: list[str | int] = []
    here: object = data
    for position, part in enumerate(loc):
        is_last = position == len(loc) - 1
        if isinstance(here, dict) and part not in here and part == here.get("kind") and not is_last:
            continue
        path.append(part)
        if isinstance(here, dict):
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            here = here[part]
        else:
            here = None
    return tuple(path)


def _dotted(path: tuple[str | int, ...]) -> str:
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "settings"


def _what(detail: ErrorDetails) -> str:
    kind = detail["type"]
    if kind == "extra_forbidden":
        return "there is no such setting"
    if kind == "missing":
        return "this is required, and it is missing"
    return detail["msg"][:1].lower() + detail["msg"][1:]


def _fix(detail: ErrorDetails, path: tuple[str | int, ...], known: Collection[str]) -> str:
    context = detail.get("ctx") or {}
    if "fix" in context:
        return str(context["fix"])
    kind = detail["type"]
    key = str(path[-1]) if path else ""
    if kind == "extra_forbidden":
        close = difflib.get_close_matches(key, sorted(known), n=1, cutoff=0.5)
        return (
            f"did you mean {close[0]}?"
            if close
            else "remove it; `mountnav docs configuration` lists all settings"
        )
    if kind == "missing":
        return f"add {key} = ... to {_dotted(path[:-1])}" if len(path) > 1 else f"add a [{key}] table"
    if kind.startswith("union_tag"):
        return 'write kind = "folder" or kind = "simulated"'
    if key == "api_token_sha256":
        return "it is 64 hexadecimal digits: the output of `printf %s YOUR-TOKEN | sha256sum`"
    if key == "url":
        return 'write for example url = "lx200+serial:///dev/ttyUSB0?baud=9600"'
    if key == "id":
        return "use lower-case letters, digits, - and _"
    return f"change {key}; `mountnav docs configuration` lists its range"
