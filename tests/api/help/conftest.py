"""A small site in the place of the built one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from api.help import site

HTML = "<html><script>var base='..'</script><p>Nights</p></html>"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the site, empty as in a checkout that has not built it."""
    monkeypatch.setattr(site, "FOLDER", tmp_path / "site")
    site.site_files.cache_clear()
    site.pages.cache_clear()
    yield tmp_path / "site"
    site.site_files.cache_clear()
    site.pages.cache_clear()


@pytest.fixture
def built(folder: Path) -> Path:
    """The folder with three pages."""
    entries = [
        ("", "mountnav", "It points telescopes."),
        ("how-to/night.html", "Nights: science frames in", "rules &amp; frames"),
        ("how-to/night.html#limits", "Limits", "of a <em>night</em>"),
        ("reference/mounts/lx200.html", "LX200 mounts", "night " * 50),
    ]
    (folder / "search").mkdir(parents=True)
    (folder / "search/search_index.json").write_text(
        json.dumps({"docs": [dict(zip(("location", "title", "text"), one, strict=True)) for one in entries]})
    )
    for path in ("index.html", "how-to/night.html", "reference/mounts/lx200.html"):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(HTML)
    (folder / "secret.bin").write_bytes(b"\x00")
    return folder
