"""Reading frames: every kind of file, pixels in file order, and plain words for what is no image."""

from __future__ import annotations

import bz2
import gzip
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from tests.reading.fits_files import fits_bytes, picture_bytes

RAMP = np.arange(40 * 30, dtype=np.int16).reshape(40, 30)


@pytest.mark.parametrize("kind", ["uint8", "int16", "uint16", "int32", "float32", "float64"])
def test_fits_of_every_type_keeps_its_values_in_file_order(kind: str) -> None:
    data = (RAMP % 200).astype(kind)
    frame = read_frame(fits_bytes(fits.PrimaryHDU(data)), name="a.fits")
    assert np.array_equal(frame.pixels, data)
    assert frame.pixels.dtype.isnative
    assert (frame.width_px, frame.height_px, frame.source) == (30, 40, "a.fits")


def test_scaled_integers_are_unscaled() -> None:
    hdu = fits.PrimaryHDU((RAMP * 0.5 + 7).astype(np.float32))
    hdu.scale("int16", bscale=0.5, bzero=7.0)
    assert np.allclose(read_frame(fits_bytes(hdu)).pixels, RAMP * 0.5 + 7)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_packed_files_are_unpacked(pack: object, tmp_path: Path) -> None:
    file = tmp_path / "a.fits.packed"
    file.write_bytes(pack(fits_bytes(fits.PrimaryHDU(RAMP))))  # type: ignore[operator]
    assert np.array_equal(read_frame(file).pixels, RAMP)


def test_tile_compressed_fits_with_the_date_in_the_first_header() -> None:
    first = fits.PrimaryHDU()
    first.header["DATE-OBS"], first.header["EXPTIME"] = "2026-11-20T01:02:03.5", 10.0
    frame = read_frame(fits_bytes(first, fits.CompImageHDU(RAMP, compression_type="RICE_1")))
    assert np.array_equal(frame.pixels, RAMP)
    assert frame.mid_exposure_utc == datetime(2026, 11, 20, 1, 2, 8, 500_000, tzinfo=UTC)


def test_the_image_is_picked_among_extensions() -> None:
    mask = fits.ImageHDU(np.zeros((80, 80), np.uint8), name="MASK")
    science = fits.ImageHDU(RAMP, name="SCI")
    table = fits.BinTableHDU.from_columns([fits.Column("a", "J", array=np.arange(3))])
    assert np.array_equal(read_frame(fits_bytes(fits.PrimaryHDU(), table, mask, science)).pixels, RAMP)


def test_color_planes_are_averaged() -> None:
    cube = np.stack([RAMP, RAMP + 30, RAMP + 60])
    assert np.allclose(read_frame(fits_bytes(fits.PrimaryHDU(cube))).pixels, RAMP + 30)


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "BMP"])
def test_gray_pictures_start_with_their_top_row(kind: str) -> None:
    gray = (RAMP % 251).astype(np.uint8)
    assert np.array_equal(read_frame(picture_bytes(Image.fromarray(gray), kind)).pixels, gray)


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_sixteen_bit_pictures_keep_all_bits(kind: str) -> None:
    deep = (RAMP.astype(np.uint16) * 50).astype(np.uint16)
    assert np.array_equal(read_frame(picture_bytes(Image.fromarray(deep), kind)).pixels, deep)


def test_color_pictures_become_brightness() -> None:
    color = np.stack([RAMP % 90, RAMP % 90 + 30, RAMP % 90 + 60], axis=2).astype(np.uint8)
    assert np.allclose(read_frame(picture_bytes(Image.fromarray(color), "PNG")).pixels, RAMP % 90 + 30)


def test_a_mosaic_is_smoothed_without_moving_its_stars() -> None:
    rng = np.random.default_rng(2)
    rows, columns = np.mgrid[:200, :200]
    star = 9000.0 * np.exp(-((columns - 90.3) ** 2 + (rows - 110.7) ** 2) / (2 * 2.0**2))
    image = 500.0 + star + rng.normal(0, 5, star.shape)
    image[0::2, 0::2] *= 0.6
    image[1::2, 1::2] *= 0.8
    hdu = fits.PrimaryHDU(np.rint(image).astype(np.uint16))
    hdu.header["BAYERPAT"] = "RGGB"
    pixels = read_frame(fits_bytes(hdu)).pixels.astype(float)
    phases = [np.median(pixels[j::2, i::2]) for j in (0, 1) for i in (0, 1)]
    assert np.ptp(phases) < 1.0
    light = np.clip(pixels - np.median(pixels), 0, None) * (np.hypot(columns - 90, rows - 111) < 8)
    assert (light * columns).sum() / light.sum() == pytest.approx(90.3, abs=0.05)
    assert (light * rows).sum() / light.sum() == pytest.approx(110.7, abs=0.05)


def test_a_stale_bayer_card_on_an_even_frame_changes_nothing() -> None:
    data = np.random.default_rng(0).normal(500, 20, (120, 120)).astype(np.uint16)
    hdu = fits.PrimaryHDU(data)
    hdu.header["BAYERPAT"] = "RGGB"
    assert np.array_equal(read_frame(fits_bytes(hdu)).pixels, data)


def test_unparsable_cards_are_passed_over() -> None:
    raw = fits_bytes(fits.PrimaryHDU(RAMP, header=fits.Header([("ODD", "fine")])))
    raw = raw.replace(b"ODD     = 'fine    '", b"ODD     = 'fi\xe9ne   ,")
    assert np.array_equal(read_frame(raw).pixels, RAMP)


def test_the_saturation_card_is_read() -> None:
    hdu = fits.PrimaryHDU(RAMP)
    hdu.header["SATURATE"] = 900
    assert read_frame(fits_bytes(hdu)).saturation_adu == 900.0


TABLE = fits.BinTableHDU.from_columns([fits.Column("a", "J", array=np.arange(3))])
WHOLE = fits_bytes(fits.PrimaryHDU(np.zeros((200, 200), np.int16) + RAMP[0, 1]))
NOISE = np.random.default_rng(1).integers(0, 255, (200, 200), dtype=np.uint8)
PNG = picture_bytes(Image.fromarray(NOISE), "PNG")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"hello, this is text", "not an image"),
        (WHOLE[: len(WHOLE) // 2], "cut short"),
        (gzip.compress(WHOLE, mtime=0)[:40], "damaged or cut short"),
        (PNG[: len(PNG) // 2], "damaged or cut short"),
        (fits_bytes(fits.PrimaryHDU(), TABLE), "no image"),
        (fits_bytes(fits.PrimaryHDU()), "no image"),
        (fits_bytes(fits.PrimaryHDU(np.zeros((4, 4), np.int16))), "only 4 × 4"),
        (fits_bytes(fits.PrimaryHDU(np.zeros(4000, np.int16))), "no image"),
        (
            WHOLE.replace(b"NAXIS1  =                  200", b"NAXIS1  =             99999999"),
            "99999999|cut short",
        ),
        (b"SIMPLE  =                    T" + b" " * 100, "can't be read|no image"),
    ],
)
def test_what_is_no_image_is_refused_with_advice(content: bytes, words: str) -> None:
    with pytest.raises(BadFrame, match=words) as caught:
        read_frame(content, name="upload.bin")
    assert caught.value.advice
    assert caught.value.device == "upload.bin"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadFrame, match=r"gone\.fits"):
        read_frame(tmp_path / "gone.fits")
