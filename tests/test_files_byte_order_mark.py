"""Text as an editor or a spreadsheet of Windows writes it: UTF-8 with a byte order mark, lines of CR LF."""

from __future__ import annotations

import codecs
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from api.archive.listing import listed_frames
from api.batch.inputs import found_files
from api.nights.safety_file import unsafe_by_file
from mountnav.ephemeris.imported import import_file
from mountnav.files import read_text
from mountnav.pointing.limits.horizon import Horizon
from mountnav.settings.observatory import Settings

ISS = (
    "ISS (ZARYA)\r\n"
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927\r\n"
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537\r\n"
)
Written = Callable[[str, str], Path]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    def write(name: str, text: str) -> Path:
        (tmp_path / name).write_bytes(codecs.BOM_UTF8 + text.encode())
        return tmp_path / name

    return write


def test_text_is_what_stands_behind_it(written: Written) -> None:
    assert read_text(written("a.txt", "é\r\nb\r")) == "é\nb\n"


def test_settings(written: Written) -> None:
    text = '[site]\r\nlatitude_deg = 47.0\r\nlongitude_deg = 11.0\r\n[[telescope]]\r\nid = "a"\r\n'
    text += '[telescope.mount]\r\nurl = "fake+lx200://"\r\n[telescope.camera]\r\nkind = "simulated"\r\n'
    assert Settings.load(written("observatory.toml", text)).telescope[0].id == "a"


@pytest.mark.parametrize(("word", "safe"), [("safe\r\n", True), ("unsafe\r\n", False)])
def test_a_safety_file(written: Written, word: str, safe: bool) -> None:
    assert (unsafe_by_file(written("safety.txt", word), 300.0, time.time) == "") is safe


def test_lists_of_frames(written: Written, tmp_path: Path) -> None:
    for name in ("a.fits", "b.fits"):
        (tmp_path / name).write_bytes(b"")
    frames = [tmp_path / "a.fits", tmp_path / "b.fits"]
    text = "".join(f"{frame}\r\n" for frame in frames)
    assert found_files([], str(written("frames.txt", text))) == frames
    assert [Path(entry.file) for entry in listed_frames([str(tmp_path / "frames.txt")], None)] == frames


def test_a_horizon(written: Written) -> None:
    assert Horizon.read(written("horizon.hrz", "0 12\r\n180 20\r\n")).altitude_at(0.0) == pytest.approx(12.0)


def test_elements(written: Written, tmp_path: Path) -> None:
    outcome = import_file(written("stations.tle", ISS), tmp_path / "imported")
    assert (outcome.objects, outcome.refused) == (1, 0)
