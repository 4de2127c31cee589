"""Pictures: every depth, color and byte order with all its bits, nothing turned, damage refused."""

from __future__ import annotations

import contextlib
import io
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from tests.reading.fits_files import deep_png, picture_bytes, tiff

RNG = np.random.default_rng(4)
SHAPE = (40, 50)
GRAY = RNG.integers(0, 256, SHAPE).astype(np.uint8)
COLOR = RNG.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
DEEP = RNG.integers(0, 65536, (*SHAPE, 4)).astype(np.uint16)


@pytest.fixture(autouse=True)
def _the_same_pixels_in_any_order() -> None:
    RNG.bit_generator.state = np.random.default_rng(4).bit_generator.state


def read(content: bytes) -> NDArray[np.generic]:
    return read_frame(content, raw=True).pixels


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "BMP"])
def test_gray_color_and_transparent(kind: str) -> None:
    mean = COLOR.mean(axis=2)
    opaque = RNG.integers(0, 256, SHAPE).astype(np.uint8)
    assert np.array_equal(read(picture_bytes(Image.fromarray(GRAY), kind)), GRAY)
    assert np.allclose(read(picture_bytes(Image.fromarray(COLOR), kind)), mean)
    veiled = Image.fromarray(np.dstack([COLOR, opaque]))
    assert np.allclose(read(picture_bytes(veiled, kind)), mean)
    if kind != "BMP":
        pair = Image.merge("LA", (Image.fromarray(GRAY), Image.fromarray(opaque)))
        assert np.array_equal(read(picture_bytes(pair, kind)), GRAY)


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "BMP"])
def test_palettes_and_black_and_white(kind: str) -> None:
    palette = Image.fromarray(GRAY // 64).convert("P")
    palette.putpalette([0, 0, 0, 10, 20, 30, 100, 110, 120, 255, 255, 255] + [0] * 756)
    assert np.allclose(read(picture_bytes(palette, kind)), np.array([0, 20, 110, 255])[GRAY // 64])
    two = Image.fromarray(GRAY > 127)
    assert np.array_equal(read(picture_bytes(two, kind)), np.where(GRAY > 127, 255, 0))


@pytest.mark.parametrize("length", range(1, 9))
@pytest.mark.parametrize("head", [b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08"])
def test_the_mere_head_of_a_tiff_is_a_bad_frame(head: bytes, length: int) -> None:
    with pytest.raises(BadFrame):
        read(head[:length])


def test_pgm_and_its_kin() -> None:
    deep = DEEP[..., 0]
    head = f"P5\n# a comment\n{SHAPE[1]} {SHAPE[0]}\n"
    assert np.array_equal(read(f"{head}255\n".encode() + GRAY.tobytes()), GRAY)
    assert np.array_equal(read(f"{head}65535\n".encode() + deep.astype(">u2").tobytes()), deep)
    assert np.allclose(read(picture_bytes(Image.fromarray(COLOR), "PPM")), COLOR.mean(axis=2))
    bits = read(picture_bytes(Image.fromarray(GRAY > 127), "PPM"))
    assert np.array_equal(bits, np.where(GRAY > 127, 255, 0))
    with pytest.raises(BadFrame, match="cut short"):
        read(f"{head}255\n".encode() + GRAY.tobytes()[:-200])


def test_equal_channels_stay_whole_numbers() -> None:
    pixels = read(picture_bytes(Image.fromarray(np.dstack([GRAY] * 3)), "PNG"))
    assert pixels.dtype == np.uint8
    assert np.array_equal(pixels, GRAY)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_deep_png_keeps_all_bits(channels: int) -> None:
    pixels = read(deep_png(DEEP[..., :channels]))
    truth = DEEP[..., 0] if channels < 3 else DEEP[..., :3].mean(axis=2, dtype=np.float32)
    assert np.allclose(pixels, truth, rtol=1e-6)
    if channels < 3:
        assert pixels.dtype == np.uint16


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("deflate", [False, True])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_deep_tiff_keeps_all_bits(order: Literal["<", ">"], deflate: bool, channels: int) -> None:
    deep = DEEP[..., 0] if channels == 1 else DEEP[..., :channels]
    pixels = read(tiff(deep, order, deflate=deflate))
    truth = deep if channels == 1 else DEEP[..., :3].mean(axis=2, dtype=np.float32)
    assert np.allclose(pixels, truth, rtol=1e-6)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["float32", "int16", "int32"])
def test_tiff_of_floats_and_signed_numbers(order: Literal["<", ">"], kind: str) -> None:
    data = RNG.normal(0, 1000, SHAPE).astype(kind)
    pixels = read(tiff(data, order))
    assert pixels.dtype.isnative
    assert np.allclose(pixels, data, rtol=1e-6)


def test_an_orientation_tag_turns_nothing() -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    smooth = np.tile(np.linspace(10, 240, 50).astype(np.uint8), (40, 1))
    raw = picture_bytes(Image.fromarray(smooth), "JPEG", exif=exif.tobytes(), quality=95)
    with Image.open(io.BytesIO(raw)) as picture:
        assert picture.getexif()[0x0112] == 6
    pixels = read(raw)
    assert pixels.shape == SHAPE
    assert np.abs(pixels.astype(int) - smooth).max() <= 3


def test_jpeg_in_gray_color_and_print_colors() -> None:
    smooth = np.tile(np.linspace(10, 240, 50).astype(np.uint8), (40, 1))
    for mode in ("L", "RGB", "CMYK"):
        pixels = read(picture_bytes(Image.fromarray(smooth).convert(mode), "JPEG", quality=95))
        assert np.abs(pixels.astype(float) - smooth).max() <= 6


def test_a_frame_never_says_where_or_when_it_was_taken_from_a_picture() -> None:
    frame = read_frame(picture_bytes(Image.fromarray(GRAY), "PNG"))
    assert (frame.mid_exposure_utc, frame.exposure_s, frame.hint.center, frame.header) == (
        None,
        None,
        None,
        {},
    )


def test_an_extension_of_a_picture_is_refused() -> None:
    raw = picture_bytes(Image.fromarray(GRAY), "PNG")
    assert np.array_equal(read_frame(raw, hdu=0).pixels, GRAY)
    with pytest.raises(BadFrame, match="not a FITS"):
        read_frame(raw, hdu="SCI")


@pytest.mark.parametrize("side", [20_000, 60_000])
def test_absurd_sizes_are_refused_before_they_are_decoded(side: int) -> None:
    raw = bytearray(picture_bytes(Image.fromarray(GRAY), "BMP"))
    raw[18:26] = side.to_bytes(4, "little") * 2
    with pytest.raises(BadFrame, match=r"absurd size|20000 × 20000"):
        read_frame(bytes(raw))


DAMAGED = [
    picture_bytes(Image.fromarray(COLOR), "PNG"),
    picture_bytes(Image.fromarray(COLOR), "JPEG"),
    picture_bytes(Image.fromarray(GRAY), "BMP"),
    deep_png(DEEP[..., :3]),
    tiff(DEEP[..., :3], "<", deflate=True),
    tiff(DEEP[..., 0], ">"),
]


@pytest.mark.filterwarnings("ignore")  # pillow warns of odd tags; nobody is harmed
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_pictures_give_a_frame_or_a_bad_frame(data: st.DataObject) -> None:
    raw = bytearray(DAMAGED[data.draw(st.integers(0, len(DAMAGED) - 1))])
    for _ in range(data.draw(st.integers(0, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(BadFrame):  # all else is a defect
        assert read_frame(bytes(raw[: data.draw(st.integers(1, len(raw)))])).pixels.ndim == 2
