"""Each tutorial works as it stands: its blocks run in order, in an empty folder, and show what it says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.walk import ROOT, Walk, blocks_of, copy_of_the_checkout, free_port

CHANGES_CODE = "first-change"
"""The one that begins in a checkout; all others begin in an empty folder, with what is installed."""
PAGES = sorted(
    page for page in (ROOT / "docs" / "tutorials").glob("*.md") if page.stem not in ("index", CHANGES_CODE)
)
pytestmark = pytest.mark.long
FRAMES = 6
"""Instead of a thousand."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_newcomer_walks_it(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    replaced = {
        "8000": str(port),
        "1000 of 1001": f"{FRAMES} of {FRAMES + 1}",
        "py 1000\n": f"py {FRAMES}\n",
        "/tmp/mount": str(tmp_path / "mount"),
    }
    monkeypatch.setenv("MOUNTNAV_SERVICE", f"http://127.0.0.1:{port}")  # in place of :8000
    blocks = blocks_of(page)
    assert sum(bool(block.shows) for block in blocks) >= 2
    served = any("mountnav serve" in block.text for block in blocks)
    walk = Walk(tmp_path, replaced)
    try:
        for block, shown in walk.walk(blocks, port if served else None):
            for pattern in block.shows:
                wanted = walk.told(pattern).replace("1000 solved", f"{FRAMES} solved")
                assert re.search(wanted, shown), f"{block.text}\nshows no {wanted!r}:\n{shown}"
    finally:
        walk.close()


def test_an_engineer_walks_it_in_a_checkout(tmp_path: Path) -> None:
    copy_of_the_checkout(tmp_path)
    blocks = blocks_of(ROOT / "docs" / "tutorials" / f"{CHANGES_CODE}.md")
    for block, shown in Walk(tmp_path, {}, checkout=True).walk(blocks, None):
        for pattern in block.shows:
            assert re.search(pattern, shown), f"{block.text}\nshows no {pattern!r}:\n{shown}"


def test_every_walk_stands_in_the_index() -> None:
    index = (ROOT / "docs" / "tutorials" / "index.md").read_text(encoding="utf-8")
    assert [page.stem for page in PAGES if f"({page.name})" not in index] == []
    assert f"({CHANGES_CODE}.md)" in index
