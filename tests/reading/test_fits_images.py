"""FITS in every form: pixels as astropy reads them, cards as astropy reads them, the right extension."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import threading
import warnings

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.reading import read_frame
from mountnav.reading.fits_headers import CARD_LENGTH, read_cards
from tests.growth import LINEAR, growth
from tests.reading.fits_files import fits_bytes

RNG = np.random.default_rng(3)
SHAPE = (40, 50)
FULL = {
    "uint8": RNG.integers(0, 256, SHAPE),
    "int16": RNG.integers(-(2**15), 2**15, SHAPE),
    "uint16": RNG.integers(0, 2**16, SHAPE),
    "int32": RNG.integers(-(2**31), 2**31, SHAPE),
    "uint32": RNG.integers(0, 2**32, SHAPE),
    "int64": RNG.integers(-(2**63), 2**63, SHAPE),
    "uint64": RNG.integers(0, 2**64, SHAPE, dtype=np.uint64),
    "int8": RNG.integers(-128, 128, SHAPE),
    "float32": RNG.normal(1000, 30, SHAPE),
    "float64": RNG.normal(1000, 30, SHAPE),
}


@pytest.fixture(autouse=True)
def _the_same_pixels_in_any_order() -> None:
    RNG.bit_generator.state = np.random.default_rng(3).bit_generator.state


@pytest.mark.parametrize("kind", FULL)
def test_every_type_over_its_full_range(kind: str) -> None:
    data = FULL[kind].astype(kind)
    frame = read_frame(fits_bytes(fits.PrimaryHDU(data)), raw=True)
    assert np.array_equal(frame.pixels, data)
    assert frame.pixels.dtype == np.dtype(kind)
    assert frame.pixels.dtype.isnative


@pytest.mark.parametrize("bitpix", [8, 16, 32, 64, -32, -64])
@pytest.mark.parametrize(("scale", "zero"), [(0.25, 100.0), (1.0, 1000.0), (-2.0, 7.0), (1.0, 32768.0)])
def test_scaled_values_are_those_of_astropy(bitpix: int, scale: float, zero: float) -> None:
    kind = {8: "uint8", 16: "int16", 32: "int32", 64: "int64", -32: "float32", -64: "float64"}[bitpix]
    stored = RNG.integers(0, 120, SHAPE).astype(kind)
    raw = fits_bytes(fits.PrimaryHDU(stored, header=fits.Header([("OBJECT", "a"), ("TELESCOP", "b")])))
    raw = raw.replace(b"OBJECT  = 'a       '", f"BSCALE  = {scale:>20}"[:20].encode().ljust(20))
    raw = raw.replace(b"TELESCOP= 'b       '", f"BZERO   = {zero:>10}".encode().ljust(20))
    raw = raw.replace(f"BSCALE  = {scale:>20}"[:20].encode(), f"BSCALE  = {scale:>10}".encode())
    expected = fits.open(io.BytesIO(raw))[0].data
    assert expected.astype(float).mean() == pytest.approx(stored.astype(float).mean() * scale + zero)
    pixels = read_frame(raw, raw=True).pixels
    assert np.allclose(pixels, expected, rtol=1e-6)
    assert pixels.dtype.itemsize <= max(4, np.dtype(kind).itemsize)


@pytest.mark.parametrize("kind", ["uint8", "int16", "int32", "uint16"])
def test_blank_pixels_are_missing(kind: str) -> None:
    data = RNG.integers(1, 100, SHAPE).astype(kind)
    stored = 7 if kind != "uint16" else 7 - 32768
    data[3, 4] = data[10, 11] = 7
    hdu = fits.PrimaryHDU(data)
    hdu.header["BLANK"] = stored
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # astropy dislikes BLANK with BZERO
        raw = fits_bytes(hdu)
    pixels = read_frame(raw, raw=True).pixels
    assert np.array_equal(np.isnan(pixels), data == 7)
    assert np.array_equal(pixels[data != 7], data[data != 7])


@pytest.mark.long
@pytest.mark.parametrize("method", ["RICE_1", "GZIP_1", "GZIP_2", "HCOMPRESS_1", "PLIO_1"])
@pytest.mark.parametrize("kind", ["uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"])
def test_tile_compressed_images_are_those_of_astropy(method: str, kind: str) -> None:
    if method == "PLIO_1" and (kind.startswith(("uint16", "uint32", "float"))):
        pytest.skip("PLIO holds whole numbers below 2^24 only")
    data = RNG.integers(10, 250, SHAPE).astype(kind)
    if kind.startswith("float"):
        data += RNG.normal(0, 3, SHAPE).astype(kind)
        data[5, 6] = np.nan
    elif kind.startswith("uint") and kind != "uint8":
        data += np.array(2 ** (8 * data.itemsize - 1), dtype=kind)
    raw = fits_bytes(fits.PrimaryHDU(), fits.CompImageHDU(data, compression_type=method))
    expected = fits.open(io.BytesIO(raw))[1].data
    frame = read_frame(raw, raw=True)
    assert np.array_equal(frame.pixels, expected, equal_nan=kind.startswith("float"))
    assert frame.pixels.dtype == np.dtype(kind)
    if not kind.startswith("float"):
        assert np.array_equal(frame.pixels, data)
    assert frame.header["NAXIS1"] == SHAPE[1]
    assert not any(key.startswith(("TFORM", "ZCMPTYPE", "ZTILE")) for key in frame.header)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, bytes])
def test_wrappings_around_a_tile_compressed_image(pack: object) -> None:
    data = RNG.integers(0, 60000, SHAPE).astype(np.uint16)
    raw = fits_bytes(fits.PrimaryHDU(), fits.CompImageHDU(data))
    assert np.array_equal(read_frame(pack(raw), raw=True).pixels, data)  # type: ignore[operator]


def extensions() -> bytes:
    data = RNG.integers(0, 100, SHAPE).astype(np.int16)
    table = fits.BinTableHDU.from_columns([fits.Column("a", "J", array=np.arange(3))], name="STARS")
    primary = fits.PrimaryHDU()
    primary.header["EXPTIME"] = 12.5
    return fits_bytes(
        primary,
        fits.ImageHDU(np.zeros((90, 90), np.uint8), name="BPM"),
        fits.ImageHDU(data, name="SCI"),
        fits.CompImageHDU(data + 1000, name="CHIP2"),
        table,
        fits.ImageHDU(np.ones((80, 80), np.float32), name="sci_weight"),
        fits.ImageHDU(np.ones((80, 80), np.float32), name="ERR"),
    )


@pytest.mark.parametrize(
    ("hdu", "level"),
    [
        (None, 0),
        (2, 0),
        ("sci", 0),
        ("SCI", 0),
        (3, 1000),
        ("Chip2", 1000),
        ("3", 1000),
        (1, None),
        ("ERR", None),
    ],
)
def test_an_extension_is_chosen_or_named(hdu: int | str | None, level: int | None) -> None:
    frame = read_frame(extensions(), hdu=hdu, raw=True)
    assert frame.exposure_s == 12.5
    if level is not None:
        assert frame.pixels.shape == SHAPE
        assert level <= frame.pixels.min() <= frame.pixels.max() < level + 100
    else:
        assert frame.pixels.shape in ((90, 90), (80, 80))
        assert np.ptp(frame.pixels) == 0


@pytest.mark.parametrize(
    ("hdu", "words"), [(0, "no image"), ("stars", "no image"), (9, "no extension 9"), ("x", "no extension")]
)
def test_a_wrong_choice_names_what_there_is(hdu: int | str, words: str) -> None:
    with pytest.raises(BadFrame, match=words) as caught:
        read_frame(extensions(), hdu=hdu)
    assert "2 SCI" in str(caught.value.advice)


@pytest.mark.parametrize(
    ("shape", "axis"),
    [
        ((3, 40, 50), 0),
        ((40, 50, 3), 2),
        ((1, 3, 40, 50), 1),
        ((4, 40, 50), 0),
        ((1, 40, 50), 0),
        ((40, 50, 1), 2),
    ],
)
def test_color_planes_on_either_axis(shape: tuple[int, ...], axis: int) -> None:
    cube = RNG.integers(0, 60000, shape).astype(np.uint16)
    planes = np.moveaxis(cube, axis, 0).reshape(-1, 40, 50)[:3]
    pixels = read_frame(fits_bytes(fits.PrimaryHDU(cube)), raw=True).pixels
    assert np.allclose(pixels, planes.mean(axis=0), rtol=1e-6)


def test_of_a_cube_of_exposures_the_first_is_taken() -> None:
    cube = RNG.integers(0, 60000, (9, 40, 50)).astype(np.uint16)
    assert np.array_equal(read_frame(fits_bytes(fits.PrimaryHDU(cube)), raw=True).pixels, cube[0])
    assert np.array_equal(read_frame(fits_bytes(fits.PrimaryHDU(cube[None])), raw=True).pixels, cube[0])


def test_missing_borders_stay_missing_and_infinities_become_so() -> None:
    data = RNG.normal(500, 5, SHAPE).astype(np.float32)
    data[:, :4] = np.nan
    data[7, 8], data[9, 10] = np.inf, -np.inf
    pixels = read_frame(fits_bytes(fits.PrimaryHDU(data))).pixels
    assert np.array_equal(np.isnan(pixels), ~np.isfinite(data))
    assert np.array_equal(pixels[np.isfinite(data)], data[np.isfinite(data)])
    with pytest.raises(BadFrame, match="no pixel"):
        read_frame(fits_bytes(fits.PrimaryHDU(np.full(SHAPE, np.nan, np.float32))))


@pytest.mark.parametrize("absurd", [3e38, -3e38, 2e15])
def test_pixels_that_no_camera_gives_are_missing(absurd: float) -> None:
    data = RNG.normal(500, 5, SHAPE).astype(np.float32)
    data[7, 8:] = absurd
    pixels = read_frame(fits_bytes(fits.PrimaryHDU(data))).pixels
    assert np.array_equal(np.isnan(pixels), data == np.float32(absurd))
    with pytest.raises(BadFrame, match="no pixel"):
        read_frame(fits_bytes(fits.PrimaryHDU(np.full(SHAPE, absurd, np.float32))))


def test_notes_after_the_last_extension_are_passed_over() -> None:
    data = RNG.integers(0, 100, SHAPE).astype(np.int16)
    raw = fits_bytes(fits.PrimaryHDU(data))
    assert np.array_equal(read_frame(raw + b"notes of the night" * 99).pixels, data)
    unpadded = raw[: 2880 + data.nbytes]
    assert np.array_equal(read_frame(unpadded).pixels, data)
    with pytest.raises(BadFrame, match="cut short"):
        read_frame(unpadded[:-1])


@pytest.mark.parametrize("pixels", [FULL["uint16"].astype("uint16"), FULL["float32"].astype("float32")])
@pytest.mark.parametrize("tiled", [False, True])
def test_wherever_a_file_is_cut_it_is_refused(pixels: np.ndarray, tiled: bool) -> None:
    hdus = [fits.PrimaryHDU(), fits.CompImageHDU(pixels)] if tiled else [fits.PrimaryHDU(pixels)]
    raw = fits_bytes(*hdus)
    end = len(raw) - 2880
    for cut in np.random.default_rng(1).integers(1, end, 60):
        with pytest.raises(BadFrame) as caught:
            read_frame(raw[: int(cut)])
        assert caught.value.advice


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_flipped_bytes_give_a_frame_or_a_bad_frame(data: st.DataObject) -> None:
    raw = bytearray(FLIPPED[data.draw(st.integers(0, len(FLIPPED) - 1))])
    for _ in range(data.draw(st.integers(1, 6))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(BadFrame):  # all else is a defect
        assert read_frame(bytes(raw)).pixels.ndim == 2


FLIPPED = [
    fits_bytes(fits.PrimaryHDU(FULL["uint16"].astype(np.uint16))),
    fits_bytes(fits.PrimaryHDU(), fits.CompImageHDU(FULL["uint16"].astype(np.uint16))),
    extensions(),
]

TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=200)
KEYS = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-", min_size=1, max_size=8).filter(
    lambda key: (
        key
        not in ("END", "COMMENT", "HISTORY", "CONTINUE", "HIERARCH", "SIMPLE", "BITPIX", "NAXIS", "EXTEND")
    )
)
VALUES = st.one_of(
    TEXT, st.booleans(), st.integers(-(10**18), 10**18), st.floats(allow_nan=False, allow_infinity=False)
)


@pytest.mark.long
@given(st.dictionaries(KEYS, VALUES, max_size=12))
def test_cards_are_read_as_astropy_writes_them(cards: dict[str, str | int | float | bool]) -> None:
    header = fits.Header()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for key, value in cards.items():
            header[key] = value
        raw = header.tostring().encode("ascii")
    read = read_cards(raw, 0)
    assert read is not None
    assert read.length == len(raw)
    for key, value in fits.Header.fromstring(raw).items():
        # astropy itself reads "'/" back as "'"
        assert read.values[key] == (header[key].rstrip() if isinstance(value, str) else value)
        assert type(read.values[key]) is type(value)


@pytest.mark.parametrize(
    ("card", "value", "comment"),
    [
        ("A       = 'it''s / so'        / a comment / with a slash", "it's / so", "a comment / with a slash"),
        ("A       =              1.5D+03 / Fortran", 1500.0, "Fortran"),
        ("A       =                  -.5", -0.5, None),
        ("A       =                    T / yes", True, "yes"),
        ("A       = '        '           / empty", "", "empty"),
        ("A       = / no value", None, None),
        ("A       = 'no end", None, None),
        ("A       = (1.0, 2.0)", None, None),
        ("A         'no equals sign'", None, None),
        ("A       =" + "9" * 71, None, None),
        ("HIERARCH a long key = 12 / why not", 12, "why not"),
    ],
)
def test_single_cards(card: str, value: object, comment: str | None) -> None:
    raw = (card.ljust(80) + "END".ljust(80)).encode("latin-1")
    read = read_cards(raw, 0)
    assert read is not None
    key = "a long key" if card.startswith("HIERARCH") else "A"
    assert read.values.get(key) == value
    assert read.comments.get(key) == comment


@pytest.mark.long
def test_reading_in_threads_leaves_the_warning_filters_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    entered: list[object] = []
    monkeypatch.setattr(warnings.catch_warnings, "__enter__", entered.append)
    odd = fits_bytes(fits.PrimaryHDU(FULL["uint16"].astype(np.uint16), header=fits.Header([("ODD", "fine")])))
    odd = odd.replace(b"ODD     = 'fine    '", b"ODD     = 'fi\xe9ne   ,")
    tiled = fits_bytes(fits.PrimaryHDU(), fits.CompImageHDU(FULL["uint16"].astype(np.uint16)))
    before = list(warnings.filters)
    faults: list[BaseException] = []

    def read() -> None:
        try:
            for _ in range(20):
                assert np.array_equal(read_frame(odd).pixels, read_frame(tiled).pixels)
        except BaseException as fault:
            faults.append(fault)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults
    assert not entered  # catch_warnings swaps the filters of the whole process
    assert warnings.filters == before


def _header(cards: list[str]) -> bytes:
    simple = "SIMPLE  =                    T"
    return "".join(card.ljust(CARD_LENGTH) for card in (simple, *cards, "END")).encode()


@pytest.mark.long
@pytest.mark.parametrize(
    ("first", "then"),
    [
        ("LONG    = 'a&'", "CONTINUE  'more of it, and more&'"),
        ("LONG    = 'a&'", "CONTINUE  '&' / more of its comment"),
        ("A       = 1", "HIERARCH KEY NUMBER {} = 1 / its comment"),
        ("A       = 1", "A       = '" + "''" * 30 + " {}"),
        ("A       = 1", "COMMENT {}"),
    ],
)
def test_a_header_is_read_in_proportion_to_its_length(first: str, then: str) -> None:
    def header(count: int) -> bytes:
        return _header([first, *(then.format(number) for number in range(count))])

    assert growth(header, lambda content: read_cards(content, 0), 6000) < LINEAR


def test_a_string_over_several_cards_ends_where_something_else_comes() -> None:
    cards = ["A       = 'x&' / one", "CONTINUE  'y&' / two", "COMMENT", "CONTINUE  'z&'"]
    found = read_cards(_header([*cards, "B       = 'q&' / c", "A = ?"]), 0)
    assert found is not None
    assert found.values == {"SIMPLE": True, "A": "xyz&", "B": "q&"}
    assert found.comments == {"A": "one two", "B": "c"}
