"""Raw files of cameras: the sensor's own numbers come out, and without rawpy a clear line."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from mountnav.reading.camera_raw import is_camera_raw
from tests.reading.raw_files import dng

rng = np.random.default_rng(3)
MOSAIC = rng.normal(1000.0, 20.0, (120, 160)).astype(np.uint16)
MOSAIC[::2, ::2] //= 2
MOSAIC[1::2, 1::2] //= 3


def test_a_dng_gives_the_sensors_numbers(tmp_path: Path) -> None:
    pytest.importorskip("rawpy", reason="raw files need the extra mountnav[raw]")
    path = tmp_path / "frame.dng"
    path.write_bytes(dng(MOSAIC))
    frame = read_frame(path, raw=True)
    assert (frame.pixels == MOSAIC).all()
    assert frame.header["BAYERPAT"] == "RGGB"
    assert frame.exposure_s == pytest.approx(2.5)
    assert frame.mosaic
    assert frame.mid_exposure_utc is None
    assert read_frame(path).pixels.shape == MOSAIC.shape


@pytest.mark.parametrize("length", [400, 1000, 20_000])
def test_a_raw_file_that_is_cut_short_is_refused_in_a_line(length: int) -> None:
    pytest.importorskip("rawpy", reason="raw files need the extra mountnav[raw]")
    with pytest.raises(BadFrame, match="raw file") as refused:
        read_frame(dng(MOSAIC)[:length])
    assert "\n" not in str(refused.value)


def test_without_rawpy_it_is_said_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(BadFrame, match="rawpy, which is not installed") as refused:
        read_frame(dng(MOSAIC))
    assert "mountnav[raw]" in str(refused.value)


def test_other_tiffs_are_none() -> None:
    for options in ({}, {"tiffinfo": {271: "Maker", 272: "Model"}}):
        file = io.BytesIO()
        Image.fromarray(MOSAIC).save(file, "TIFF", **options)
        assert not is_camera_raw(file.getvalue())
        assert (read_frame(file.getvalue(), raw=True).pixels == MOSAIC).all()
    assert is_camera_raw(b"\0\0\0\x18ftypcrx \0\0\0\1")
    assert is_camera_raw(b"II*\0\x10\0\0\0CR\2\0" + bytes(20))
    assert not is_camera_raw(b"II*\0\xff\xff\xff\xff")


@pytest.mark.parametrize("head", [b"II*\0", b"MM\0*", b"II*\0\x08\0\0", b"II*\0\x08\0\0\0\xff"])
def test_a_few_bytes_of_a_tiff_are_no_raw_file(head: bytes) -> None:
    assert not is_camera_raw(head)
    with pytest.raises(BadFrame):
        read_frame(head)
