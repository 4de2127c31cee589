"""A table is read by its rows: no cell is a paragraph. What needs more stands in a section below."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.walk import ROOT

MOST_CHARACTERS = 300
"""Of a cell's words, without targets of links. Names in backticks are looked up, not read: left out."""
_CODE = re.compile(r"`[^`]*`")
_TARGET = re.compile(r"\]\([^)]*\)")
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def cells_of(text: str) -> Iterator[tuple[int, str]]:
    """Line and words of each cell."""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("|"):
            for cell in line.strip().strip("|").split(" | "):
                yield number, _TARGET.sub("]", _CODE.sub("", cell)).strip()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_cell_is_a_paragraph(page: Path) -> None:
    long = [
        f"{number}: {words[:60]}"
        for number, words in cells_of(page.read_text(encoding="utf-8"))
        if len(words) > MOST_CHARACTERS
    ]
    assert long == []


def test_a_paragraph_is_found() -> None:
    row = f"| a | {'word ' * 70} | `{'b' * 400}` [c]({'d' * 400}) |\n"
    assert [len(words) > MOST_CHARACTERS for _, words in cells_of("text\n" + row)] == [False, True, False]
