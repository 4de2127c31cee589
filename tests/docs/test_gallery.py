"""Each notebook of the gallery runs, keeps its own assertions, and its page shows what it makes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.walk import ROOT

GALLERY = ROOT / "docs" / "gallery"
NOTEBOOKS = sorted(path.stem for path in GALLERY.glob("*.py"))
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def _words(page: str) -> str:
    """A page without its numbers: the last digits hang on the machine's arithmetic."""
    return re.sub(r"[ -]+", " ", _NUMBER.sub("#", page))


def test_each_notebook_stands_in_the_index() -> None:
    assert len(NOTEBOOKS) >= 5
    index = (GALLERY / "index.md").read_text(encoding="utf-8")
    assert [name for name in NOTEBOOKS if f"({name}.md)" not in index] == []


@pytest.mark.long
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_its_page_is_what_it_makes(name: str, tmp_path: Path) -> None:
    ran = subprocess.run(
        [sys.executable, "tools/gallery.py", name, "--out", str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    made = (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    kept = (GALLERY / f"{name}.md").read_text(encoding="utf-8")
    assert _words(made) == _words(kept), "run `python tools/gallery.py`"
    plots = re.findall(r"\]\((images/[^)]+)\)", made)
    assert plots
    for plot in plots:
        assert (tmp_path / plot).read_bytes()[:4] == b"\x89PNG"
        assert (GALLERY / plot).exists()
