"""XISF files: each kind of samples and packing reads back, and what is made to harm is refused in a line."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from mountnav.reading.xisf import read_xisf
from tests.reading.xisf_files import xisf

PACKINGS = ["", "zlib", "zlib+sh", "lz4", "lz4+sh", "lz4hc", "lz4hc+sh", "zstd", "zstd+sh"]
RNG = np.random.default_rng(4)
PIXELS = RNG.integers(0, 60_000, (20, 31)).astype(np.uint16)


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "u4", "f4", "f8"])
def test_each_packing_and_kind_reads_back(packing: str, kind: str, tmp_path: Path) -> None:
    pixels = (PIXELS % 251).astype(kind)
    path = tmp_path / "frame.xisf"
    path.write_bytes(xisf(pixels, packing=packing))
    frame = read_frame(path)
    assert frame.pixels.dtype == pixels.dtype.newbyteorder("=")
    assert (frame.pixels == pixels).all()
    assert frame.notes == ()


@pytest.mark.parametrize("normal", [False, True])
@pytest.mark.parametrize("packing", ["", "zstd+sh"])
def test_colors_become_their_mean(normal: bool, packing: str) -> None:
    colors = np.stack([PIXELS, PIXELS // 2, PIXELS // 4])
    frame = read_frame(xisf(colors, packing=packing, normal=normal))
    assert frame.pixels == pytest.approx(colors.mean(axis=0), rel=1e-6)


@pytest.mark.parametrize("packing", ["zlib", "lz4+sh", "zstd+sh"])
def test_blocks_in_parts_read_back(packing: str) -> None:
    assert (read_xisf(xisf(PIXELS, packing=packing, parts=3), "x").pixels == PIXELS).all()


def test_parts_that_packing_made_no_shorter_are_as_they_were() -> None:
    pixels = PIXELS.copy()
    pixels[10:] = 1000  # the first part is noise, and packs to more than it was
    content = xisf(pixels, packing="zlib", parts=2)
    assert b'subblocks="620,620:' in content
    assert (read_xisf(content, "x").pixels == pixels).all()
    with pytest.raises(BadFrame, match="its data are damaged"):
        read_xisf(content.replace(b'subblocks="620,620:', b'subblocks="630,620:'), "x")


@given(
    width=st.integers(1, 9),
    height=st.integers(1, 9),
    seed=st.integers(0, 9),
    packing=st.sampled_from(PACKINGS),
)
def test_any_size_reads_back(width: int, height: int, seed: int, packing: str) -> None:
    pixels = np.random.default_rng(seed).integers(0, 65536, (height, width)).astype(np.uint16)
    assert (read_xisf(xisf(pixels, packing=packing), "x").pixels == pixels).all()


def test_keywords_become_the_header() -> None:
    keywords = {
        "DATE-OBS": "'2026-01-02T03:04:05'",
        "EXPTIME": "4.0",
        "OBJCTRA": "'05 40 00'",
        "OBJCTDEC": "+30 00 00",
        "FOCALLEN": "400",
        "XPIXSZ": "3.76",
        "COMMENT": "",
        "ODD": "nan",
    }
    inside = (
        "<ColorFilterArray pattern='RGGB' width='2' height='2'/><Property id='a'><FITSKeyword/></Property>"
    )
    frame = read_frame(xisf(PIXELS, keywords=keywords, inside=inside))
    assert frame.mid_exposure_utc == datetime(2026, 1, 2, 3, 4, 7, tzinfo=UTC)
    assert frame.hint.center is not None
    assert frame.hint.center.ra_deg == pytest.approx(85.0)
    assert frame.header["BAYERPAT"] == "RGGB"
    assert frame.header["FOCALLEN"] == 400
    assert "COMMENT" not in frame.header


def test_one_of_several_images_is_chosen() -> None:
    one = xisf(PIXELS, id="one")
    small = "<Image id='small' geometry='4:4:1' sampleFormat='UInt8' location='attachment:0:16'/>"
    both = one.replace(b"</Image></xisf>", b"</Image>" + small.encode() + b"</xisf>")
    xml = both.index(b"</xisf>") + len(b"</xisf>") - 16
    both = both[:8] + xml.to_bytes(4, "little") + both[12:]
    both = both.replace(f"attachment:{4096}".encode(), f"attachment:{4096 + len(small)}".encode())
    found = read_xisf(both, "x")
    assert (found.pixels == PIXELS).all()
    assert "others in the file: 1" in found.note
    assert read_xisf(both, "x", "small").pixels.shape == (4, 4)
    assert read_xisf(both, "x", 0).note == ""
    with pytest.raises(BadFrame, match="there is no image 7; there are: 0 one, 1 small"):
        read_xisf(both, "x", 7)


LAUGHS = "<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;'>]>"
DEEP = "<a>" * 40 + "</a>" * 40
WHOLE = xisf(PIXELS, packing="zlib+sh")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (xisf(PIXELS, before=LAUGHS), "document type"),
        (xisf(PIXELS, inside=DEEP), "too many elements"),
        (xisf(PIXELS, geometry="4000000:4000000:1"), "claims 4000000 × 4000000 pixels"),
        (xisf(PIXELS, geometry="31:20:5"), "5 channels"),
        (xisf(PIXELS, geometry="31:20"), "is not a picture"),
        (xisf(PIXELS, geometry="-31:20:1"), "is not a picture"),
        (xisf(PIXELS, geometry="0:20:1"), "the image is empty"),
        (xisf(PIXELS, sampleFormat="Complex32"), "are not supported"),
        (xisf(PIXELS, location="inline:base64"), "not attached"),
        (xisf(PIXELS, location="attachment:4096:99999999"), "cut short"),
        (xisf(PIXELS, location="attachment:4096:10"), "its data have 10 bytes, and 1240 are needed"),
        (xisf(PIXELS, compression="zlib:99999999999"), "unpack to 99999999999 bytes, and 1240 are needed"),
        (xisf(PIXELS, compression="rar:1240"), "packed by 'rar:1240' are not supported"),
        (xisf(PIXELS, compression="zlib+sh:1240"), "are not supported"),
        (xisf(PIXELS, compression="zlib:1240"), "damaged"),
        (xisf(PIXELS, compression="lz4:1240"), "damaged"),
        (xisf(PIXELS, compression="zstd:1240"), "damaged"),
        (xisf(PIXELS, packing="zlib", subblocks="10,99999"), "more than the image has"),
        (xisf(PIXELS, packing="zlib", subblocks="10"), "can't be told apart"),
        (WHOLE[:200], "cut short within its header"),
        (WHOLE[:-10], "cut short"),
        (b"XISF0100" + b"\xff" * 12, "header claims"),
        (b"XISF0100" + bytes(8) + b"x" * 40, "not XML"),
        (xisf(PIXELS).replace(b"UTF-8", b"UTF-9"), "header"),
        (xisf(PIXELS).replace(b"<Image", b"<Imago").replace(b"</Image", b"</Imago"), "no image"),
    ],
)
def test_what_is_damaged_or_made_to_harm_is_refused(content: bytes, why: str) -> None:
    with pytest.raises(BadFrame, match=why) as refused:
        read_frame(content)
    assert "\n" not in str(refused.value)


def test_a_bomb_is_refused_before_it_is_unpacked() -> None:
    zeros = np.zeros((12_000, 12_000), np.uint8)
    with pytest.raises(BadFrame, match="absurd size"):
        read_frame(xisf(zeros, packing="zstd"))
