"""Files asked for piece by piece give what their bytes would, and a file that shrinks is refused."""

from __future__ import annotations

import os
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from mountnav.reading.content import OnDisk, stored
from mountnav.reading.fits_images import read_fits

CONTENT = bytes(range(256)) * 3
SHAPES = [(40, 50), (3, 40, 50), (40, 50, 3), (1, 40, 50), (6, 40, 50)]


@given(start=st.integers(-900, 900), end=st.integers(-900, 900))
def test_a_piece_is_that_of_the_bytes(start: int, end: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "content"
    file.write_bytes(CONTENT)
    with FileIO(file) as opened:
        content = OnDisk(opened)
        assert len(content) == len(CONTENT)
        assert content[start:end] == CONTENT[start:end]


@pytest.mark.parametrize("kind", [">i2", ">f4", "u1"])
def test_stored_numbers_are_the_same_from_disk_and_memory(kind: str, tmp_path: Path) -> None:
    (tmp_path / "content").write_bytes(CONTENT)
    with FileIO(tmp_path / "content") as opened:
        from_disk = stored(OnDisk(opened), np.dtype(kind), 7, 4)
    in_memory = stored(CONTENT, np.dtype(kind), 7, 4)
    assert from_disk.dtype == in_memory.dtype
    assert from_disk.tobytes() == in_memory.tobytes()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["uint8", "int16", "uint16", "int32", "float32", "float64"])
def test_a_file_is_read_as_an_upload_is(shape: tuple[int, ...], kind: str, tmp_path: Path) -> None:
    data = np.random.default_rng(4).integers(0, 200, shape).astype(kind)
    fits.PrimaryHDU(data).writeto(tmp_path / "one.fits")
    from_disk = read_frame(tmp_path / "one.fits", raw=True)
    upload = read_frame((tmp_path / "one.fits").read_bytes(), raw=True)
    assert from_disk.pixels.dtype == upload.pixels.dtype
    assert np.array_equal(from_disk.pixels, upload.pixels)
    assert from_disk.header == upload.header
    assert from_disk.pixels.flags.writeable
    assert upload.pixels.flags.writeable


def test_strips_join_without_a_seam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = np.random.default_rng(5).integers(0, 60000, (97, 53)).astype(np.uint16)
    fits.PrimaryHDU(data).writeto(tmp_path / "one.fits")
    for at_once in (1, 53 * 2 * 10, 53 * 2 * 97, 10**6):
        monkeypatch.setattr("mountnav.reading.fits_images._BYTES_AT_ONCE", at_once)
        assert np.array_equal(read_frame(tmp_path / "one.fits", raw=True).pixels, data)


def test_a_file_that_shrinks_while_it_is_read_is_a_bad_frame(tmp_path: Path) -> None:
    file = tmp_path / "one.fits"
    fits.PrimaryHDU(np.zeros((400, 500), np.uint16)).writeto(file)
    with FileIO(file) as opened:
        content = OnDisk(opened)
        os.truncate(file, 200_000)
        with pytest.raises(BadFrame, match="cut short"):
            read_fits(content, "one.fits")


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadFrame, match="it is a pipe"):
        read_frame(tmp_path / "pipe")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadFrame, match="can't be read"):
        read_frame(tmp_path)
