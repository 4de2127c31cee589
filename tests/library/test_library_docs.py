"""The examples of docs/reference/library run as they stand."""

from __future__ import annotations

import doctest
from pathlib import Path

import matplotlib as mpl
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs" / "reference" / "library"
NEEDS = {"solve": "rendered/B02.fits.fz", "pointing": "pointing/pmfit_equat.dat"}


@pytest.mark.shared
@pytest.mark.parametrize("page", sorted(one.stem for one in DOCS.glob("*.md")))
def test_the_examples_of_a_page_hold(page: str, shared: Path) -> None:
    mpl.use("Agg")
    data = shared / "data"
    names = {"FRAME": data / NEEDS["solve"], "RUN": data / NEEDS["pointing"]}
    found = doctest.testfile(
        str(DOCS / f"{page}.md"), module_relative=False, globs=names, optionflags=doctest.NORMALIZE_WHITESPACE
    )
    assert found.attempted > 0
    assert found.failed == 0
