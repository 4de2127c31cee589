"""Families have the same file names for the same subjects, and the architecture page says which."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers import registry

ROOT = Path(__file__).parents[2]
LINES = frozenset({"family", "codec", "exchange", "readings", "rates", "language", "fake"})
"""Of a family over a line of its own."""
SERVERS = frozenset({"family", "codec", "client", "device", "readings", "rates", "language"})
"""Of a family behind a server, which has its own fakes."""
ALSO = {
    "nexstar": {"parking"},
    "skywatcher": {"axes", "steering"},
    "indi": {"camera", "rotator", "discovery"},
    "alpaca": {"camera", "rotator", "discovery"},
}
"""What a family has besides: its own subjects, and other devices."""


def subjects(folder: Path) -> set[str]:
    return {path.stem for path in folder.iterdir() if not path.name.startswith("__")}


def named(family: str) -> Path:
    return ROOT / "drivers" / family


@pytest.mark.parametrize("family", sorted({where.split(".")[1] for where in registry._FAMILIES.values()}))
def test_one_shape(family):
    there = subjects(named(family))
    of_line = "fake" in there
    assert there - ALSO.get(family, set()) == (LINES if of_line else SERVERS)


def test_the_page_names_the_subjects():
    page = (ROOT / "docs/explanation/architecture.md").read_text(encoding="utf-8")
    table = page[page.index("### One family of mounts") :]
    told = set(re.findall(r"^\| `(\w+)(?:\.py)?`", table[: table.index("\n### `api`")], re.MULTILINE))
    assert told == LINES | SERVERS | set().union(*ALSO.values())
