"""Drawn star lists, of which some are poison."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks.archive.drawn import draw

POISON = Path(__file__).parent / "poison"
SOLVING = ("--no-blind", "--undated", "2026-01-01")


@pytest.fixture(scope="session")
def lists(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of ten lists; the fourth is cut short, the last one isn't there."""
    folder = tmp_path_factory.mktemp("lists")
    table = draw(folder, 10, seed=3)
    (folder / "lists" / "000003.xy").write_text("x,y,flux\n12.0,")
    (folder / "lists" / "000009.xy").unlink()
    return table


@pytest.fixture(scope="session")
def poisoned(lists: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, and a list that hangs its decoder, and one that ends it."""
    folder = tmp_path_factory.mktemp("poisoned")
    shutil.copytree(lists.parent, folder, dirs_exist_ok=True)
    table = folder / "frames.csv"
    head, *rows = table.read_text().splitlines()
    for at, name in ((2, "hang"), (7, "die")):
        shutil.copy(folder / "lists" / "000000.xy", folder / "lists" / f"{name}.xy")
        rows.insert(at, rows[0].replace("000000", name))
    table.write_text("\n".join([head, *rows]) + "\n")
    return table
