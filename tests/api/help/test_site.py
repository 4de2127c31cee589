"""Pages are found by name, else by their words; without a site this is said plainly."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.app import app
from api.help.site import find_page, pages
from mountnav.errors import BadRequest, NotFound


def test_a_page_is_found_by_its_name_in_each_form(built: Path) -> None:
    for topic in ("lx200", "reference/mounts/lx200", "docs/reference/mounts/lx200.md", " LX200 "):
        assert [one.path for one in find_page(topic)] == ["reference/mounts/lx200.html"], topic


def test_a_word_in_a_title_counts_more_than_many_in_a_text(built: Path) -> None:
    assert [one.name for one in find_page("night limits")] == ["how-to/night"]
    assert [one.name for one in find_page("nights frames")] == ["how-to/night"]
    assert {one.name for one in find_page("limits of night")} == {"how-to/night"}


def test_a_word_counts_from_its_beginning(built: Path) -> None:
    with pytest.raises(NotFound):
        find_page("ights")


def test_pages_of_figures_come_after_others(built: Path) -> None:
    index = built / "search/search_index.json"
    docs = json.loads(index.read_text())["docs"]
    docs.append({"location": "figures/nights.html", "title": "Nights in figures", "text": "rules " * 9})
    index.write_text(json.dumps({"docs": docs}))
    assert [one.name for one in find_page("nights rules")] == ["how-to/night", "figures/nights"]


def test_markup_is_no_text(built: Path) -> None:
    (night,) = (one for one in pages() if one.name == "how-to/night")
    assert night.title == "Nights: science frames in"
    assert "rules & frames" in night.text
    assert "<" not in night.text


def test_what_no_page_has_is_not_found_and_nothing_is_refused(built: Path) -> None:
    with pytest.raises(NotFound, match="flat earth"):
        find_page("flat earth")
    for topic in ("", " ?! ", "a" * 201):
        with pytest.raises(BadRequest):
            find_page(topic)


def test_without_a_site_the_way_to_one_is_told(folder: Path) -> None:
    with pytest.raises(NotFound, match="make docs"):
        find_page("night")


@pytest.mark.long
def test_the_command_tells_the_file(built: Path) -> None:
    run = CliRunner().invoke(app, ["docs", "lx200"])
    assert (run.exit_code, run.stdout) == (0, (built / "reference/mounts/lx200.html").as_uri() + "\n")
    front = CliRunner().invoke(app, ["docs"])
    assert front.stdout == (built / "index.html").as_uri() + "\n"
    listed = CliRunner().invoke(app, ["docs", "--list", "--json"])
    assert [one["name"] for one in json.loads(listed.stdout)] == [
        "how-to/night",
        "index.html".removesuffix(".html"),
        "reference/mounts/lx200",
    ]
