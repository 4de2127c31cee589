"""Which line of a TOML text a setting stands on; tomllib itself doesn't tell."""

from __future__ import annotations

import re

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
