"""Typed coordinates: the table shared with JavaScript, and what any position written out comes to."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.sky.typed_coordinates import TypedName, read_dec_deg, read_position, read_ra_deg, read_target

TABLE = json.loads((Path(__file__).parent / "typed_coordinates.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("text", TABLE["positions"])
def test_positions_are_read_rightly(text: str) -> None:
    ra_deg, dec_deg, unit = TABLE["positions"][text]
    read = read_position(text)
    assert (read.ra_deg, read.dec_deg) == pytest.approx((ra_deg, dec_deg), abs=1e-6)
    assert read.ra_in_hours == (unit == "hours")


@pytest.mark.parametrize("text", TABLE["names"])
def test_names_are_no_positions(text: str) -> None:
    assert read_target(text) == TypedName(text)
    with pytest.raises(BadRequest, match="is not a position"):
        read_position(text)


@pytest.mark.parametrize("text", [*TABLE["refused"], *TABLE["empty"], "1" * 101])
def test_what_is_lone_ambiguous_or_out_of_range_is_refused_with_the_reason(text: str) -> None:
    with pytest.raises(BadRequest) as refused:
        read_target(text)
    assert TABLE["refused"].get(text, "") in refused.value.what


hours = st.tuples(st.integers(0, 23), st.integers(0, 59), st.integers(0, 5999))
degrees = st.tuples(st.sampled_from("+-"), st.integers(0, 89), st.integers(0, 59), st.integers(0, 599))
ra_forms = (
    "{:02d}h{:02d}m{:05.2f}s",
    "{:d}:{:02d}:{:05.2f}",
    "{:02d} {:02d} {:05.2f}",
    "{:d}h {:d}m {:.2f}s",
)
dec_forms = (
    "{}{:02d}°{:02d}′{:04.1f}″",
    "{}{:d}:{:02d}:{:04.1f}",
    "{}{:02d} {:02d} {:04.1f}",
    "{}{:d}d{:d}m{:.1f}s",
)


@given(
    hours, degrees, st.sampled_from(ra_forms), st.sampled_from(dec_forms), st.sampled_from([" ", ", ", ";"])
)
def test_a_position_written_out_comes_back(
    ra: tuple[int, int, int], dec: tuple[str, int, int, int], ra_form: str, dec_form: str, between: str
) -> None:
    ra_text = ra_form.format(ra[0], ra[1], ra[2] / 100)
    dec_text = dec_form.format(dec[0], dec[1], dec[2], dec[3] / 10)
    ra_deg = 15.0 * (ra[0] + ra[1] / 60 + ra[2] / 360_000)
    dec_deg = (-1.0 if dec[0] == "-" else 1.0) * (dec[1] + dec[2] / 60 + dec[3] / 36_000)
    read = read_position(ra_text + between + dec_text)
    assert (read.ra_deg, read.dec_deg) == pytest.approx((ra_deg, dec_deg), abs=1e-9)
    assert (read_ra_deg(ra_text), read_dec_deg(dec_text)) == pytest.approx((ra_deg, dec_deg), abs=1e-9)
    # each of them alone is never a position
    for lone in (ra_text, dec_text, dec_text[1:]):
        with pytest.raises(BadRequest):
            read_target(lone)


@given(st.text(alphabet="0123456789+-.,; :°'\"hmsd", min_size=1, max_size=24))
def test_whatever_is_typed_is_in_range_or_refused(text: str) -> None:
    try:
        read = read_target(text)
    except BadRequest:
        return
    if not isinstance(read, TypedName):
        assert 0.0 <= read.ra_deg < 360.0
        assert -90.0 <= read.dec_deg <= 90.0


@pytest.mark.parametrize(
    ("text", "deg"),
    [("12", 12.0), ("187.5", 187.5), ("12h30m", 187.5), ("12:30", 187.5), ("12 30 00", 187.5)],
)
def test_in_a_field_of_right_ascension_a_number_alone_is_degrees(text: str, deg: float) -> None:
    assert read_ra_deg(text) == deg


@pytest.mark.parametrize("text", ["360", "24h", "-1", "", "x", "12:60", "nan", "inf", "1e3"])
def test_no_right_ascension(text: str) -> None:
    with pytest.raises(BadRequest):
        read_ra_deg(text)
