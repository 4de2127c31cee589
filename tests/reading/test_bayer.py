"""Raw Bayer mosaics: found with and without a card, never where there is none, smoothed without a shift."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mountnav.reading import demosaiced, frame_from_array, read_frame
from mountnav.reading.bayer import is_mosaic, without_mosaic
from tests.reading.fits_files import fits_bytes

PATTERNS = {
    "RGGB": (0.7, 1.0, 1.0, 0.5),
    "BGGR": (0.5, 1.0, 1.0, 0.7),
    "GRBG": (1.0, 0.7, 0.5, 1.0),
    "GBRG": (1.0, 0.5, 0.7, 1.0),
}


def sky(
    shape: tuple[int, int], colors: tuple[float, float, float, float], seed: int = 0, level: float = 800.0
) -> NDArray[np.float64]:
    """Sky with a gradient and stars behind the filters of a mosaic, with photon noise (in ADU, gain 1)."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    light = level * (1.0 + 0.3 * columns / shape[1] - 0.2 * rows / shape[0])
    for _ in range(shape[0] * shape[1] // 2000):
        x, y, flux = rng.uniform(0, shape[1]), rng.uniform(0, shape[0]), rng.exponential(2000.0)
        light = light + flux * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 1.3**2))
    for phase, factor in enumerate(colors):
        light[phase // 2 :: 2, phase % 2 :: 2] *= factor
    noisy: NDArray[np.float64] = rng.poisson(light) + rng.normal(0, 5, shape)
    return noisy


def whole(light: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.clip(np.rint(light), 0, 65535).astype(np.uint16)


@pytest.mark.long
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("card", [True, False])
@pytest.mark.parametrize("shape", [(100, 120), (301, 299)])
def test_a_mosaic_is_found_with_and_without_its_card(
    pattern: str, card: bool, shape: tuple[int, int]
) -> None:
    header: dict[str, str | int | float | bool] = {"BAYERPAT": pattern, "XBAYROFF": 1} if card else {}
    assert is_mosaic(whole(sky(shape, PATTERNS[pattern])), header)


def test_a_calibrated_mosaic_is_found_by_its_card_only() -> None:
    light = sky((200, 200), PATTERNS["RGGB"]).astype(np.float32)
    light[:, :10] = np.nan
    assert is_mosaic(light, {"BAYERPAT": "RGGB"})
    assert not is_mosaic(light, {})


@pytest.mark.long
@pytest.mark.parametrize("card", [True, False])
@pytest.mark.parametrize(
    "factors",
    [
        (1.0, 1.0, 1.0, 1.0),
        (1.0, 0.9, 1.0, 0.9),  # columns read by two amplifiers
        (1.0, 1.0, 0.9, 0.9),  # interlaced rows
        (1.0, 0.9, 0.9, 0.8),  # both
    ],
)
def test_other_patterns_are_no_mosaic(factors: tuple[float, float, float, float], card: bool) -> None:
    header: dict[str, str | int | float | bool] = {"BAYERPAT": "RGGB"} if card else {}
    frame = whole(sky((300, 300), factors))
    both = factors == (1.0, 0.9, 0.9, 0.8)
    # a product of rows and columns has two alike on a diagonal, as a mosaic has: smoothing it does no harm
    assert is_mosaic(frame, header) == both


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    level=st.floats(0.5, 20_000.0),
    slope=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    kind=st.sampled_from(["uint8", "uint16", "int32"]),
    size=st.integers(48, 300),
)
def test_no_monochrome_frame_is_taken_for_a_mosaic(
    seed: int, level: float, slope: tuple[float, float], kind: str, size: int
) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:size, :size] / size
    light = level * (1.0 + slope[0] * columns + slope[1] * rows)
    frame = np.clip(rng.poisson(light), 0, 255 if kind == "uint8" else 60_000).astype(kind)
    assert not is_mosaic(frame, {})


@pytest.mark.long
def test_no_real_frame_but_the_mosaics_is_taken_for_one(shared: Path) -> None:
    folder = shared / "data" / "frames"
    known = {"panoptes+POCS/unsolved.fits.gz", "panoptes+POCS/solved.fits.fz", "panoptes+POCS/tiny.fits.gz"}
    known.add("oresat+oresat-star-tracker-software/bayered.bmp")
    files = [one["file"] for one in json.loads((folder / "manifest.json").read_text())["frames"]]
    found = {name for name in files if read_frame(folder / name, raw=True).mosaic}
    assert found == known


@pytest.mark.parametrize("name", ["A01", "C00", "D00"])
def test_no_rendered_frame_is_taken_for_a_mosaic(shared: Path, name: str) -> None:
    assert not read_frame(shared / "data" / "rendered" / f"{name}.fits.fz", raw=True).mosaic


def test_raw_reading_leaves_a_mosaic_alone_and_demosaicing_twice_is_as_once() -> None:
    data = whole(sky((200, 220), PATTERNS["GRBG"]))
    hdu = fits.PrimaryHDU(data)
    hdu.header["BAYERPAT"] = "GRBG"
    raw = read_frame(fits_bytes(hdu), raw=True)
    assert raw.mosaic
    assert np.array_equal(raw.pixels, data)
    once = demosaiced(raw)
    assert not once.mosaic
    assert demosaiced(once) is once
    assert np.array_equal(once.pixels, read_frame(fits_bytes(hdu)).pixels)
    # masters make floats of the pixels: what the frame is stays known
    calibrated = replace(raw, pixels=raw.pixels.astype(np.float32) - 100.0)
    assert np.allclose(demosaiced(calibrated).pixels, once.pixels.astype(np.float32) - 100.0, atol=1e-2)


def test_a_plain_frame_is_returned_as_it_is() -> None:
    frame = read_frame(fits_bytes(fits.PrimaryHDU(whole(sky((60, 60), (1, 1, 1, 1))))), raw=True)
    assert not frame.mosaic
    assert demosaiced(frame) is frame


@given(
    x=st.floats(30, 50),
    y=st.floats(30, 50),
    colors=st.tuples(*[st.floats(0.2, 1.0)] * 3),
    pattern=st.sampled_from(list(PATTERNS)),
)
def test_smoothing_moves_no_star_of_any_color(
    x: float, y: float, colors: tuple[float, float, float], pattern: str
) -> None:
    red, green, blue = colors
    factor = {"R": red, "G": green, "B": blue}
    rows, columns = np.mgrid[:80, :80]
    star = 1e4 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 2.0**2))
    for phase, letter in enumerate(pattern):
        star[phase // 2 :: 2, phase % 2 :: 2] *= factor[letter]
    smooth = without_mosaic(star).astype(float)
    assert (smooth * columns).sum() / smooth.sum() == pytest.approx(x, abs=0.02)
    assert (smooth * rows).sum() / smooth.sum() == pytest.approx(y, abs=0.02)


def test_an_even_sky_behind_any_filters_comes_out_even() -> None:
    light = np.ones((60, 60), np.float32)
    for phase, factor in enumerate((0.3, 1.0, 0.9, 0.5)):
        light[phase // 2 :: 2, phase % 2 :: 2] *= factor
    assert np.allclose(without_mosaic(light), (0.3 + 1.0 + 0.9 + 0.5) / 4.0, rtol=1e-6)


def test_an_array_becomes_a_frame_as_a_file_does() -> None:
    data = whole(sky((100, 120), PATTERNS["RGGB"]))
    cards: dict[str, str | int | float | bool] = {
        "BAYERPAT": "RGGB",
        "EXPTIME": 30.0,
        "DATE-OBS": "2026-11-20T00:00:00",
        "RA": 83.8,
        "DEC": -5.4,
    }
    hdu = fits.PrimaryHDU(data, header=fits.Header(cards))
    file, array = read_frame(fits_bytes(hdu)), frame_from_array(data, cards)
    assert np.array_equal(file.pixels, array.pixels)
    assert file.hint == array.hint
    assert (file.mid_exposure_utc, file.exposure_s) == (array.mid_exposure_utc, array.exposure_s)
    assert frame_from_array(data, cards, raw=True).mosaic


def test_an_array_is_not_changed_and_its_mask_is_kept() -> None:
    data = np.random.default_rng(0).normal(100, 5, (40, 50)).astype(np.float32)
    data[3, 4] = np.inf
    before = data.copy()
    frame = frame_from_array(data)
    assert np.isnan(frame.pixels[3, 4])
    assert np.array_equal(data, before)
    clean = np.where(np.isfinite(data), data, 100.0).astype(np.float32)
    assert np.shares_memory(frame_from_array(clean).pixels, clean)
    for kind in ("uint16", "float32", "float64", ">f4"):
        masked = np.ma.masked_less(clean.astype(kind), 95)
        pixels = frame_from_array(masked).pixels
        assert np.array_equal(np.isnan(pixels), masked.mask)
        assert np.array_equal(pixels[~masked.mask], masked.data[~masked.mask])
        assert not np.isnan(masked.data).any()
