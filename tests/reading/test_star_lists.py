"""Lists of stars as other programs write them, and as nobody should."""

from __future__ import annotations

import io
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.frames import StarList
from mountnav.reading import ListFormat, read_source
from mountnav.reading.star_lists import (
    MOST_LIST_BYTES,
    MOST_ROWS,
    is_star_list,
    read_star_list,
    star_list_of,
)

X = np.array([10.25, 200.5, 30.75, 101.0])
Y = np.array([5.5, 61.25, 70.0, 12.0])
FLUX = np.array([50.0, 400.0, 300.0, 20.0])
BRIGHTEST_FIRST = np.argsort(-FLUX)


def table_of(columns: list[fits.Column], cards: dict[str, object] | None = None) -> bytes:
    """A FITS file with one table."""
    hdu = fits.BinTableHDU.from_columns(columns)
    hdu.header.update(cards or {})
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(file)
    return file.getvalue()


def xyls(x: np.ndarray = X, y: np.ndarray = Y, flux: np.ndarray = FLUX, **cards: object) -> bytes:
    """As Siril writes them."""
    columns = [
        fits.Column(name=name, format="E", array=values)
        for name, values in (("X", x), ("Y", y), ("FLUX", flux), ("BACKGROUND", np.zeros(x.size)))
    ]
    return table_of(columns, {"IMAGEW": 240, "IMAGEH": 80, **cards})


def read(content: bytes | str, wanted: ListFormat | None = None) -> StarList:
    """Read what must be recognized."""
    content = content.encode() if isinstance(content, str) else content
    assert is_star_list(content)
    return read_star_list(content, "list", wanted)


def assert_the_four(found: StarList) -> None:
    """The four stars, the brightest first, counted from 0."""
    np.testing.assert_allclose(found.x_px, X[BRIGHTEST_FIRST] - 1.0)
    np.testing.assert_allclose(found.y_px, Y[BRIGHTEST_FIRST] - 1.0)
    assert np.all(np.diff(found.flux) < 0.0)


def test_sirils_table() -> None:
    found = read(xyls())
    assert_the_four(found)
    assert (found.width_px, found.height_px) == (240, 80)
    np.testing.assert_allclose(found.flux, FLUX[BRIGHTEST_FIRST])


def test_stellarsolvers_table_is_sorted_by_magnitudes() -> None:
    columns = [
        fits.Column(name=name, format=form, array=values)
        for name, form, values in (
            ("NUMBER", "J", np.arange(4)),
            ("MAG_AUTO", "E", -2.5 * np.log10(FLUX)),
            ("X_IMAGE", "E", X),
            ("Y_IMAGE", "E", Y),
        )
    ]
    wanted = ListFormat("X_IMAGE", "Y_IMAGE", "MAG_AUTO", True, width_px=300, height_px=100)
    found = read(table_of(columns), wanted)
    assert_the_four(found)
    assert (found.width_px, found.height_px) == (300, 100)
    assert_the_four(read(table_of(columns)))  # a magnitude is known by its name


def test_sextractors_second_table_and_columns_of_any_kind() -> None:
    header = fits.BinTableHDU.from_columns(
        [fits.Column(name="Field Header Card", format="160A", array=["a"])]
    )
    objects = fits.BinTableHDU.from_columns(
        [
            fits.Column(name="VIGNET", format="9E", array=np.zeros((4, 9))),
            fits.Column(name="FLAGS", format="11X", array=np.zeros((4, 11), bool)),
            fits.Column(name="XWIN_IMAGE", format="D", array=X),
            fits.Column(name="YWIN_IMAGE", format="I", array=(4.0 * Y).astype(np.int16)),
            fits.Column(name="SHAPE", format="PE()", array=np.array([np.zeros(2)] * 4, dtype=object)),
            fits.Column(name="FLUX_AUTO", format="K", array=FLUX.astype(int)),
        ]
    )
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), header, objects]).writeto(file)
    content = file.getvalue()
    at = content.index(b"TFORM4") + 80  # astropy doesn't write scaled columns of whole numbers
    scaled = content[:at] + b"TSCAL4  =                 0.25".ljust(80) + content[at:]
    end = scaled.index(b"END" + b" " * 77, at)
    scaled = scaled[: end + 80] + scaled[end + 160 :]
    assert_the_four(read(scaled))


@pytest.mark.long
@given(
    st.lists(
        st.tuples(
            st.floats(-1e4, 9e4, width=32),
            st.floats(-1e4, 9e4, width=32),
            st.floats(-(2.0**100), 2.0**100, width=32),
        ),
        max_size=40,
    )
)
def test_the_reader_agrees_with_astropy(stars: list[tuple[float, float, float]]) -> None:
    x, y, flux = (np.array([star[at] for star in stars], dtype=np.float32) for at in range(3))
    content = xyls(x, y, flux)
    found = read_star_list(content, "list", ListFormat(width_px=100, height_px=100))
    with fits.open(io.BytesIO(content)) as opened:
        data = opened[1].data
        order = np.argsort(-data["FLUX"].astype(float), kind="stable")
        np.testing.assert_array_equal(found.x_px, data["X"].astype(float)[order] - 1.0)
        np.testing.assert_array_equal(found.flux, data["FLUX"].astype(float)[order])


TEXTS = {
    "AstroImageJ": "\n".join(
        f"{x}\t{y}" for x, y in zip(X[BRIGHTEST_FIRST], Y[BRIGHTEST_FIRST], strict=True)
    ),
    "CSV with names": "id,x,y,flux\n"
    + "\n".join(f"HD{n},{x},{y},{f}" for n, (x, y, f) in enumerate(zip(X, Y, FLUX, strict=True))),
    "CSV quoted, with windows lines": '"X";"Y";"FLUX"\r\n'
    + "\r\n".join(f'"{x}";"{y}";"{f}"' for x, y, f in zip(X, Y, FLUX, strict=True)),
    "SExtractor": "#   1 NUMBER   Running object number\n#   2 FLUX_AUTO   Flux   [count]\n"
    "#   3 X_IMAGE   Object position along x and y\n#   4 Y_IMAGE   Object position   [pixel]\n"
    + "\n".join(f" {n} {f} {x} {y}" for n, (x, y, f) in enumerate(zip(X, Y, FLUX, strict=True))),
    "comments that speak of x and y": "# where x and y are\n# x y flux\n"
    + "\n".join(f"{x} {y} {f}" for x, y, f in zip(X, Y, FLUX, strict=True))
    + "\n# x, y\n",
    "three columns, a byte order mark": "\ufeff"
    + "\n\n".join(f"{x}, {y}, {f}," for x, y, f in zip(X, Y, FLUX, strict=True)),
    "masked": "x,y,flux,mag\n" + "\n".join(f"{x},{y},{f},--" for x, y, f in zip(X, Y, FLUX, strict=True)),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_texts(kind: str) -> None:
    found = read(TEXTS[kind])
    np.testing.assert_allclose(found.x_px, X[BRIGHTEST_FIRST] - 1.0)
    np.testing.assert_allclose(found.y_px, Y[BRIGHTEST_FIRST] - 1.0)
    assert (found.width_px, found.height_px) == (201, 70)  # what holds all stars


def test_astropys_ecsv() -> None:
    file = io.StringIO()
    Table({"x": X, "y": Y, "flux": FLUX}).write(file, format="ascii.ecsv")
    assert_the_four(read(file.getvalue()))


def test_sequences() -> None:
    assert_the_four(star_list_of(X.tolist(), Y.tolist(), FLUX.tolist()))
    assert_the_four(star_list_of(X, Y, -FLUX, wanted=ListFormat(ascending=True)))
    assert np.isnan(star_list_of([1, 2], [3, 4.5]).flux).all()
    np.testing.assert_array_equal(star_list_of([1, 2], [3, 4.5]).x_px, [0.0, 1.0])


@pytest.mark.parametrize(
    "broken", [([1.0], [1.0, 2.0]), (["1"], [1.0]), ([[1.0]], [1.0]), ({"a": 1}, [1.0]), ("12", [1.0, 2.0]),
               ([10**400], [1.0]), ([True], [1.0]), ([1.0] * (MOST_ROWS + 1), [1.0]), (None, [1.0])]
)  # fmt: skip
def test_what_are_no_sequences_of_numbers(broken: tuple[object, object]) -> None:
    with pytest.raises(BadFrame):
        star_list_of(*broken)  # type: ignore[arg-type]


def test_y_may_count_from_the_last_row_and_pixels_from_zero() -> None:
    wanted = ListFormat(first_px=0, y="up", width_px=240, height_px=80)
    found = read(xyls(), wanted)
    np.testing.assert_allclose(found.x_px, X[BRIGHTEST_FIRST])
    np.testing.assert_allclose(found.y_px, 79.0 - Y[BRIGHTEST_FIRST])


def test_what_is_no_position_is_left_out() -> None:
    x, y = np.array([np.nan, 5.0, np.inf, 7.0, 1e30]), np.array([1.0, -np.inf, 2.0, 3.0, 1.0])
    found = read(xyls(x, y, np.array([1.0, 2.0, 3.0, np.nan, np.inf])))
    assert found.x_px.tolist() == [6.0]
    assert np.isnan(found.flux).all()


def test_the_place_is_taken_from_the_header() -> None:
    found = read(xyls(OBJCTRA="05 35 17", OBJCTDEC="-05 23 28"))
    assert found.hint.center is not None
    assert found.hint.center.ra_deg == pytest.approx(83.82, abs=0.01)


def test_an_image_with_a_table_is_an_image() -> None:
    file = io.BytesIO()
    table = fits.open(io.BytesIO(xyls()))[1]
    fits.HDUList([fits.PrimaryHDU(np.zeros((40, 40), np.int16)), table]).writeto(file)
    assert not is_star_list(file.getvalue())


@pytest.mark.parametrize(
    "content", [b"", b"\x89PNG\r\n\x1a\n" + bytes(20), b"hello, world\n1 2\n", b"12 apples\n"]
)
def test_what_is_no_list(content: bytes) -> None:
    assert not is_star_list(content)


def _with_card(content: bytes, name: str, value: str) -> bytes:
    at = content.index(f"{name:<8}=".encode(), 2880)
    return content[:at] + f"{name:<8}= {value:>20}".ljust(80).encode() + content[at + 80 :]


HOSTILE_CARDS = [
    ("NAXIS2", "1000000000"), ("NAXIS2", "-4"), ("NAXIS1", "99999999999999"), ("NAXIS1", "1"),
    ("TFIELDS", "99999"), ("TFIELDS", "0"), ("TFORM1", "'999999999E'"), ("TFORM1", "'1QE(999999999)'"),
    ("TFORM1", "'E9'"), ("TFORM1", "'?'"), ("TFORM2", "'0E'"), ("TTYPE1", "'Z'"), ("PCOUNT", "99999999999"),
    ("XTENSION", "'TABLE'"), ("IMAGEW", "99999999999999"), ("IMAGEH", "-5"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), HOSTILE_CARDS)
def test_hostile_tables_are_refused_in_one_line_or_read_as_they_are(name: str, value: str) -> None:
    content = _with_card(xyls(), name, value)
    tracemalloc.start()
    found, told = None, ""
    try:
        found = read_star_list(content, "list")
    except BadFrame as fault:
        told = str(fault)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000
    assert "\n" not in told
    assert len(told) < 300
    assert found is None or found.x_px.size <= 4


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"1 " * 1_000_000, "columns"),
        (b"x,y\n" + b"1," * 1_000_000, "columns"),
        (b"\n" * 300_000, "no stars"),
        (b"1 2\n3 pears\n", "no number"),
        (b"1 2\n3\n", "no number"),
        (b"x y\n", "no stars"),
        (b"1 2\n\xff\xfe\n", "not a text"),
        (b"a,b,c\n1,2,3\n", "no number"),
        (b"1 2\n" * (MOST_LIST_BYTES // 4 + 1), "MB"),
    ],
    ids=["a million columns", "a million commas", "line ends", "words", "one number", "only names",
         "no text", "other names", "length"],
)  # fmt: skip
def test_hostile_texts_are_refused_in_one_line_and_take_little_memory(content: bytes, words: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(BadFrame, match=words) as told:
            read_star_list(content, "list")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "\n" not in str(told.value)
    assert peak < 40_000_000 + 3 * len(content)


@pytest.mark.long
def test_a_list_of_too_many_rows_is_refused() -> None:
    with pytest.raises(BadFrame, match="stars"):
        read_star_list(b"1 2\n" * (MOST_ROWS + 1), "list")


def test_a_named_column_that_is_not_there() -> None:
    with pytest.raises(BadFrame, match=r"MAG_AUTO.*flux"):
        read_star_list(xyls(), "list", ListFormat(sort_column="MAG_AUTO"))
    with pytest.raises(BadFrame, match="no columns of x and y"):
        read_star_list(xyls(), "list", ListFormat(x_column="NX"))


def test_the_whole_way_in_tells_lists_from_images_by_content(tmp_path: Path) -> None:
    path = tmp_path / "stars.fits"
    path.write_bytes(xyls())
    found = read_source(path)
    assert isinstance(found, StarList)
    assert found.source == "stars.fits"
    assert_the_four(found)
    path.write_bytes(b"neither one nor the other")
    with pytest.raises(BadFrame):
        read_source(path)
