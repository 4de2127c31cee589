"""What is known of an image before it is solved is what reading it whole says; lines stay lines."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from api.solver_commands.image_facts import image_facts, number, one_line
from api.solver_commands.in_process import SolverInProcess
from mountnav.errors import BadFrame
from mountnav.reading import read_frame

GRAY = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60)
COLOR = np.dstack([(GRAY % 251).astype(np.uint8)] * 3)


def _extensions(path: Path) -> None:
    mask = fits.ImageHDU(np.zeros((50, 70), np.uint8), name="MASK")
    small = fits.ImageHDU(np.zeros((20, 30), np.int16), name="SCI2")
    fits.HDUList([fits.PrimaryHDU(), mask, small, fits.ImageHDU(GRAY, name="SCI")]).writeto(path)


KINDS = {
    "plain.fits": lambda path: fits.PrimaryHDU(GRAY).writeto(path),
    "planes.fits": lambda path: fits.PrimaryHDU(np.moveaxis(COLOR, 2, 0)).writeto(path),
    "last.fits": lambda path: fits.PrimaryHDU(COLOR).writeto(path),
    "idle.fits": lambda path: fits.PrimaryHDU(GRAY[None, None]).writeto(path),
    "extensions.fits": _extensions,
    "tiled.fits.fz": lambda path: fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(GRAY)]).writeto(path),
    "gray.png": lambda path: Image.fromarray(GRAY).save(path),
    "color.png": lambda path: Image.fromarray(COLOR).save(path),
    "color.jpg": lambda path: Image.fromarray(COLOR).save(path),
    "gray.tif": lambda path: Image.fromarray(GRAY).save(path),
    "color.bmp": lambda path: Image.fromarray(COLOR).save(path),
    "color.ppm": lambda path: Image.fromarray(COLOR).save(path),
}


@pytest.mark.parametrize("name", KINDS)
def test_the_head_says_what_the_whole_file_says(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    KINDS[name](path)
    frame = read_frame(path)
    with path.open("rb") as file:
        facts = image_facts(file, name, SolverInProcess())
        assert file.read() == path.read_bytes()  # it is read from its beginning by whoever comes next
    assert (facts.width_px, facts.height_px) == (frame.width_px, frame.height_px)
    assert facts.rows_down == (".fits" not in name and not name.endswith("ppm"))
    assert bool(facts.header) == (".fits" in name)


def test_a_packed_file_is_unpacked(tmp_path: Path) -> None:
    fits.PrimaryHDU(GRAY).writeto(tmp_path / "f.fits")
    path = tmp_path / "f.fits.gz"
    path.write_bytes(gzip.compress((tmp_path / "f.fits").read_bytes()))
    with path.open("rb") as file:
        facts = image_facts(file, "f", SolverInProcess())
    assert (facts.width_px, facts.height_px, facts.rows_down) == (60, 40, False)


@pytest.mark.parametrize("content", [b"", b"no image", b"SIMPLE", b"\x89PNG\r\n\x1a\n", b"\x1f\x8b"])
def test_what_is_no_image_is_a_bad_frame(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(BadFrame):
        image_facts(file, "x", SolverInProcess())


@given(st.text())
def test_any_text_becomes_one_line_of_ascii(text: str) -> None:
    line = one_line(text)
    assert line.isascii()
    assert line == line.strip()
    assert line.isprintable()
    assert one_line(line) == line


def test_numbers_have_a_point_or_a_comma() -> None:
    assert number("1.5") == number(" 1,5 ") == 1.5
    assert number("-2e3") == -2000.0
    assert [number(text) for text in (None, "", "x", "nan", "inf", "1 2")] == [None] * 6
