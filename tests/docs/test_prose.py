"""What a slip of an editor's search-and-replace leaves in prose: words that stand there twice in a row."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md")) + [ROOT / name for name in ("README.md", "CHANGELOG.md")]
FEWEST, MOST = 3, 14
"""Words of a phrase that is looked for."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_phrase_stands_twice_in_a_row(page: Path) -> None:
    prose = page.read_text(encoding="utf-8")
    for code in (r"(?s)```.*?```", r"(?m)^(?:\|| {4}).*$", r"`[^`]*`", r"\]\([^)]*\)", r"<[^>]*>"):
        prose = re.sub(code, " 0 ", prose)
    twice = [
        " ".join(words[at : at + size])
        for paragraph in re.split(r"\n\s*\n", prose)
        for words in [re.findall(r"[\w'’-]+", paragraph)]
        for size in range(FEWEST, MOST)
        for at in range(len(words) - 2 * size + 1)
        if words[at : at + size] == words[at + size : at + 2 * size]
        and sum(word.isalpha() for word in words[at : at + size]) >= FEWEST
    ]
    assert twice == []
