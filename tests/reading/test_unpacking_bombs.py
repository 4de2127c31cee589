"""Files that unpack to far more than a picture of the sky holds are refused before that is done."""

from __future__ import annotations

import bz2
import gzip
import io
import os
import subprocess
import sys
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from mountnav.errors import BadFrame
from mountnav.measuring.calibration.raw_files import open_raw
from mountnav.reading import read_frame, unpacking

MOST_MB = 200.0
"""What reading any of these may hold at most; a pillow or astropy that unpacks first takes 1 to 2.5 GB."""


@pytest.fixture
def _little_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_MB * 1e6
    finally:
        tracemalloc.stop()


def _header(*cards: str) -> bytes:
    text = "".join(card.ljust(80) for card in (*cards, "END"))
    return text.ljust(-(-len(text) // 2880) * 2880).encode()


def _image(width: int, height: int, bits: int = 16) -> bytes:
    first = ("SIMPLE  =                    T", f"BITPIX  = {bits:20d}", "NAXIS   =                    2")
    return _header(*first, f"NAXIS1  = {width:20d}", f"NAXIS2  = {height:20d}")


def _pack_bz2(start: bytes, zeros: int) -> bytes:
    """Many small streams in a row: 2.5 GB in 2 kB."""
    block = 40_000_000
    return bz2.compress(start) + bz2.compress(bytes(block)) * (zeros // block)


def _pack_gzip(start: bytes, zeros: int) -> bytes:
    block = 40_000_000
    return gzip.compress(start) + gzip.compress(bytes(block)) * (zeros // block)


@pytest.mark.long
@pytest.mark.usefixtures("_little_memory")
@pytest.mark.parametrize("pack", [_pack_bz2, _pack_gzip])
@pytest.mark.parametrize(
    "start",
    [
        b"no image at all ",
        b"SIMPLE  =                    T".ljust(80),  # a header without an end
        _image(17_000, 17_000),
        _image(100_000, 100_000),
        b"BM" + bytes(60),
    ],
)
def test_a_bomb_is_refused(pack: Callable[[bytes, int], bytes], start: bytes) -> None:
    packed = pack(start, 2_400_000_000 if pack is _pack_bz2 else 400_000_000)
    assert len(packed) < (6_000 if pack is _pack_bz2 else 420_000)
    with pytest.raises(BadFrame, match=r"absurd size|header has no end"):
        read_frame(packed, name="bomb.fits")


@pytest.mark.long
@pytest.mark.usefixtures("_little_memory")
@pytest.mark.parametrize("pack", [_pack_bz2, _pack_gzip])
def test_what_follows_the_image_is_not_unpacked(pack: Callable[[bytes, int], bytes]) -> None:
    data = np.arange(4000, dtype=">i2").reshape(40, 100)
    start = _image(100, 40) + data.tobytes().ljust(-(-8000 // 2880) * 2880, b"\0")
    assert np.array_equal(read_frame(pack(start, 2_400_000_000)).pixels, data)


@pytest.mark.parametrize("pack", [bz2.compress, gzip.compress])
def test_many_extensions_come_whole(pack: Callable[[bytes], bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "_SLACK_BYTES", 5000)  # so that the headers are gone through often
    rng = np.random.default_rng(3)
    planes = [rng.integers(0, 30_000, (40 + number, 60)).astype(np.int16) for number in range(30)]
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), *map(fits.ImageHDU, planes)]).writeto(file)
    packed = pack(file.getvalue())
    assert np.array_equal(read_frame(packed).pixels, planes[-1])
    assert np.array_equal(read_frame(packed, hdu=7).pixels, planes[6])


def test_a_drawn_frame_without_noise_is_read() -> None:
    data = np.zeros((3000, 4000), np.int16)
    data[::100, ::100] = 1000
    assert (
        read_frame(gzip.compress(_image(4000, 3000) + data.astype(">i2").tobytes())).pixels.shape
        == data.shape
    )


@pytest.mark.long
@pytest.mark.usefixtures("_little_memory")
def test_a_picture_of_nothing_is_refused() -> None:
    rows = zlib.compress(bytes(13_000 * 12_001), 9)
    chunks = (
        (b"IHDR", (12_000).to_bytes(4, "big") + (13_000).to_bytes(4, "big") + b"\x08\0\0\0\0"),
        (b"IDAT", rows),
    )
    content = b"\x89PNG\r\n\x1a\n"
    for kind, data in (*chunks, (b"IEND", b"")):
        content += len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")
    assert len(content) < 200_000
    with pytest.raises(BadFrame, match="absurd size"):
        read_frame(content)


@pytest.mark.usefixtures("_little_memory")
def test_tiles_of_nothing_are_refused() -> None:
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(np.zeros((100, 100), np.int16))]).writeto(file)
    content = file.getvalue()
    for axis in (1, 2):
        content = content.replace(
            f"ZNAXIS{axis} = {100:20d}".encode(), f"ZNAXIS{axis} = {17_000:20d}".encode()
        )
    with pytest.raises(BadFrame, match="absurd size"):
        read_frame(content)


def _tiled(kind: str, *, side: int = 600) -> bytearray:
    file = io.BytesIO()
    noise = np.random.default_rng(3).integers(0, 4096, (side, side)).astype(np.int16)
    image = fits.CompImageHDU(noise, compression_type=kind, tile_shape=(side, side))
    fits.HDUList([fits.PrimaryHDU(), image]).writeto(file)
    content = bytearray(file.getvalue())
    assert read_frame(bytes(content)).pixels.shape == (side, side)
    return content


@cache
def _many_zeros(members: int) -> bytes:
    """Of gzip, in so many members: 400 MB."""
    bomb = b""
    for _ in range(members):
        packing = zlib.compressobj(9, wbits=16 + zlib.MAX_WBITS)
        bomb += b"".join(packing.compress(bytes(4_000_000)) for _ in range(100 // members))
        bomb += packing.flush()
    return bomb


@pytest.mark.long
@pytest.mark.usefixtures("_little_memory")
@pytest.mark.parametrize("kind", ["GZIP_1", "GZIP_2"])
@pytest.mark.parametrize("members", [1, 9])
def test_a_tile_under_an_honest_header_that_unpacks_without_end_is_refused(kind: str, members: int) -> None:
    content, bomb = _tiled(kind), _many_zeros(members)
    at = content.index(b"\x1f\x8b")
    content[at : at + len(bomb)] = bomb
    with pytest.raises(BadFrame, match="unpacks to more than the whole image"):
        read_frame(bytes(content))


def test_a_tile_of_hcompress_that_says_it_is_larger_is_refused() -> None:
    content = _tiled("HCOMPRESS_1")
    at = content.index(b"\xdd\x99")
    content[at + 2 : at + 10] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(BadFrame, match="unpacks to more than the whole image"):
        read_frame(bytes(content))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["RICE_1", "GZIP_1", "GZIP_2", "HCOMPRESS_1", "PLIO_1"])
@pytest.mark.parametrize("tile", [(1, 500), (64, 64), (400, 500)])
def test_honest_tiles_of_every_kind_are_read(kind: str, tile: tuple[int, int]) -> None:
    if kind == "HCOMPRESS_1" and tile[0] == 1:
        tile = (16, 500)
    pixels = np.random.default_rng(4).integers(0, 4096, (400, 500)).astype(np.int16)
    file = io.BytesIO()
    image = fits.CompImageHDU(pixels, compression_type=kind, tile_shape=tile)
    fits.HDUList([fits.PrimaryHDU(), image]).writeto(file)
    np.testing.assert_array_equal(read_frame(file.getvalue()).pixels, pixels)


@pytest.mark.long
def test_a_bomb_among_calibration_frames_is_refused(tmp_path: Path) -> None:
    bomb = tmp_path / "dark.fits.bz2"
    bomb.write_bytes(_pack_bz2(_image(17_000, 17_000), 200_000_000))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with pytest.raises(BadFrame, match="absurd size"):
        open_raw(bomb, scratch)
    assert sum(one.stat().st_size for one in scratch.iterdir()) < 100_000_000


@pytest.mark.long
@pytest.mark.usefixtures("_little_memory")
@pytest.mark.parametrize("kind", ["GZIP_1", "GZIP_2", "HCOMPRESS_1"])
def test_a_calibration_frames_tile_that_unpacks_without_end_is_refused(tmp_path: Path, kind: str) -> None:
    content = _tiled(kind)
    if kind == "HCOMPRESS_1":
        at = content.index(b"\xdd\x99")
        content[at + 2 : at + 10] = (60_000).to_bytes(4, "big") * 2
    else:
        bomb = _many_zeros(1)
        at = content.index(b"\x1f\x8b")
        content[at : at + len(bomb)] = bomb
    frame, scratch = tmp_path / "dark.fits.fz", tmp_path / "scratch"
    frame.write_bytes(content)
    scratch.mkdir()
    with pytest.raises(BadFrame, match="unpacks to more than the whole image"):
        open_raw(frame, scratch)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["RICE_1", "GZIP_1", "GZIP_2", "HCOMPRESS_1", "PLIO_1"])
def test_honest_calibration_frames_of_every_kind_are_read(tmp_path: Path, kind: str) -> None:
    frame, scratch = tmp_path / "dark.fits.fz", tmp_path / "scratch"
    frame.write_bytes(_tiled(kind))
    scratch.mkdir()
    raw = open_raw(frame, scratch)
    np.testing.assert_array_equal(raw.rows(0, 600), read_frame(frame).pixels)


@pytest.mark.long
def test_warnings_of_pillow_stay_off_stderr(tmp_path: Path) -> None:
    """Tags of a TIFF that are cut short, which pillow warns of."""
    file = io.BytesIO()
    Image.fromarray(np.zeros((40, 50), np.uint8)).save(file, "TIFF")
    content = bytearray(file.getvalue())
    where = int.from_bytes(content[4:8], "little")
    content[where + 2 + 12 * 2 + 2 : where + 2 + 12 * 2 + 8] = b"\x02\0\xff\xff\xff\x7f"
    (tmp_path / "odd.tif").write_bytes(content)
    said = subprocess.run(
        [
            sys.executable,
            "-W",
            "default",
            "-c",
            "import sys\nfrom pathlib import Path\nfrom mountnav.reading import read_frame\n"
            "from mountnav.errors import BadFrame\n"
            "try: print(read_frame(Path(sys.argv[1])).pixels.shape)\nexcept BadFrame as told: print(told)",
            str(tmp_path / "odd.tif"),
        ],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert said.returncode == 0
    assert said.stdout
    assert said.stderr == ""
