"""Requests of the nova API as data: hints and their units, and everything that makes no sense."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.nova.codec import (
    MOST_JSON_BYTES,
    NovaError,
    calibration,
    hint_of,
    picture_kind,
    read_asked,
    read_request,
    stars_text,
)
from mountnav.reading.star_lists import read_star_list
from mountnav.sky.coordinates import Icrs

WIDTH_PX = 4000


def bounds(width_px: int | None = WIDTH_PX, **asked: Any) -> tuple[float | None, float | None, str]:
    hint, lost = hint_of(read_asked(asked), width_px)
    if hint is None:
        return None, None, lost
    return hint.scale_low_arcsec_px, hint.scale_high_arcsec_px, lost


def test_scales_by_all_their_units() -> None:
    ul: dict[str, Any] = {"scale_type": "ul"}
    assert bounds(scale_units="arcsecperpix", scale_lower=1, scale_upper="2.5", **ul) == (1.0, 2.5, "")
    # 4000 pixels of 0.9 to 1.8 arcsec
    assert bounds(scale_units="degwidth", scale_lower=1, scale_upper=2, **ul) == pytest.approx((0.9, 1.8, ""))
    assert bounds(scale_units="arcminwidth", scale_lower=60, scale_upper=120) == pytest.approx((0.9, 1.8, ""))
    # the default unit of this protocol
    assert bounds(scale_lower=1, scale_upper=2) == pytest.approx((0.9, 1.8, ""))
    # 36 mm of film behind 50 mm: 39.6 degrees
    low, high, _ = bounds(scale_units="focalmm", scale_lower=50, scale_upper=100)
    assert high == pytest.approx(2 * math.degrees(math.atan(18 / 50)) * 3600 / WIDTH_PX)
    assert low == pytest.approx(2 * math.degrees(math.atan(18 / 100)) * 3600 / WIDTH_PX)


def test_an_estimate_has_its_error_in_percent() -> None:
    low, high, _ = bounds(scale_units="arcsecperpix", scale_type="ev", scale_est=2.0, scale_err=10)
    assert (low, high) == pytest.approx((1.8, 2.2))
    assert bounds(scale_units="arcsecperpix", scale_est=2.0, scale_err=100) == pytest.approx((None, 4.0, ""))
    assert bounds(scale_type="ev", scale_est=2.0) == (None, None, "")


def test_open_bounds_bound_nothing() -> None:
    assert bounds(scale_units="arcsecperpix", scale_lower=1.0) == (1.0, None, "")
    assert bounds(scale_units="arcsecperpix", scale_upper=3.0) == (None, 3.0, "")
    # AstroImageJ's lower bound is an estimate less its error, which may be below 0
    assert bounds(scale_units="arcsecperpix", scale_lower=-0.5, scale_upper=3.0) == (None, 3.0, "")
    assert bounds() == (None, None, "")
    # the widest that nova's own form offers: 0.1 to 180 degrees
    assert bounds(scale_units="degwidth", scale_lower=0.1, scale_upper=180) == pytest.approx(
        (0.09, 162.0, "")
    )


def test_a_scale_by_the_width_of_an_unknown_frame_is_told_and_left_out() -> None:
    low, high, lost = bounds(None, scale_units="degwidth", scale_lower=1, scale_upper=2)
    assert (low, high) == (None, None)
    assert "degwidth" in lost
    assert bounds(None, scale_units="arcsecperpix", scale_lower=1)[0] == 1.0


def test_a_place_and_its_radius() -> None:
    hint, _ = hint_of(read_asked({"center_ra": 360.0, "center_dec": "-30.5", "radius": 2}), None)
    assert hint is not None
    assert (hint.center, hint.radius_deg) == (Icrs(0.0, -30.5), 2.0)
    bare, _ = hint_of(read_asked({"center_ra": 10, "center_dec": 20}), None)
    assert bare is not None
    assert bare.radius_deg == 5.0


@pytest.mark.parametrize(
    "asked",
    [
        {"center_ra": 10},
        {"center_ra": 361, "center_dec": 0},
        {"center_ra": 10, "center_dec": -91},
        {"center_ra": "ten", "center_dec": 0},
        {"center_ra": True, "center_dec": 0},
        {"center_ra": [1], "center_dec": 0},
        {"center_ra": "nan", "center_dec": 0},
        {"radius": "inf"},
        {"radius": -1},
        {"scale_units": "furlongs"},
        {"scale_units": ["degwidth"]},
        {"scale_type": "xx"},
        {"scale_lower": 2, "scale_upper": 1},
        {"scale_lower": 10**400},
        {"image_width": 0},
        {"image_width": 1.5},
        {"image_width": 10**9},
        {"parity": 3},
        {"tweak_order": -1},
    ],
)
def test_values_that_make_no_sense_are_refused_by_name(asked: dict[str, Any]) -> None:
    with pytest.raises(NovaError) as refused:
        read_asked(asked)
    assert refused.value.status == 200
    assert any(
        name in refused.value.words for name in ("center", "radius", "scale", "image", "parity", "tweak")
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "1",
        "{",
        '{"a": NaN}',
        '{"a": Infinity}',
        "[" * 100_000,
        '{"a": 1' + "0" * 5000 + "}",
    ],
)
def test_what_is_no_json_object_is_refused(text: str) -> None:
    with pytest.raises(NovaError, match="JSON"):
        read_request(text)


def test_json_beyond_all_bounds_is_refused() -> None:
    with pytest.raises(NovaError) as refused:
        read_request(b" " * (MOST_JSON_BYTES + 1))
    assert refused.value.status == 413
    with pytest.raises(NovaError, match="keys"):
        read_request(json.dumps({f"k{number}": 0 for number in range(10_000)}))


@pytest.mark.long
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), lambda inner: st.lists(inner)))
def test_any_value_is_read_or_refused(value: Any) -> None:
    names = ("center_ra", "center_dec", "radius", "scale_lower", "scale_upper", "scale_est", "scale_err")
    for name in (*names, "scale_units", "scale_type", "image_width", "parity", "tweak_order", "invert"):
        try:
            hint, _ = hint_of(read_asked({name: value}), WIDTH_PX)
        except NovaError:
            continue
        assert hint is None or hint.scale_low_arcsec_px != math.inf


def test_lists_of_x_and_y_come_back_as_they_were() -> None:
    x, y = [1.0, 250.25, 3], [4.5, 100, 7.125]
    found = read_star_list(
        stars_text(x, y), "x and y", read_asked({"image_width": 300, "image_height": 200}).stars
    )
    assert found.x_px.tolist() == [0.0, 249.25, 2.0]
    assert found.y_px.tolist() == [3.5, 99.0, 6.125]
    assert (found.width_px, found.height_px) == (300, 200)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([], []),
        ([1.0], [1.0, 2.0]),
        (None, None),
        ("12", "12"),
        ([True], [1]),
        (["1"], [2]),
        ([1e300], [1]),
        ([[1]], [2]),
    ],
)
def test_lists_that_are_none_are_refused(x: object, y: object) -> None:
    with pytest.raises(NovaError):
        stars_text(x, y)


def test_what_a_file_is_by_its_first_bytes() -> None:
    assert picture_kind(b"SIMPLE  =   ") == "fits"
    assert picture_kind(b"\x89PNG\r\n\x1a\n....") == "picture"
    assert picture_kind(b"\xff\xd8\xff\xe0") == "picture"
    assert picture_kind(b"") == picture_kind(b"1.0 2.0") == picture_kind(b"\x1f\x8b") == "other"


def _cards(cd: tuple[float, float, float, float]) -> dict[str, Any]:
    names = ("CD1_1", "CD1_2", "CD2_1", "CD2_2")
    scale = 2.0 / 3600.0
    return {
        "CTYPE1": "RA---TAN",
        "CTYPE2": "DEC--TAN",
        "CRPIX1": 500.5,
        "CRPIX2": 400.5,
        "CRVAL1": 120.0,
        "CRVAL2": -20.0,
        "IMAGEW": 1000,
        "IMAGEH": 800,
        **{name: scale * value for name, value in zip(names, cd, strict=True)},
    }


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 90.0, 135.0, 180.0, -135.0, -90.0, -45.0])
@pytest.mark.parametrize("parity", [-1, 1])
def test_orientation_and_parity_by_the_formula_of_wcsinfo(angle_deg: float, parity: int) -> None:
    """Retold: T = p·cd11 + cd22, A = p·cd21 - cd12, orientation -atan2(A, T); 180 less that for pictures."""
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    cd = (parity * cos, -sin, parity * sin, cos)
    told, turned = (calibration(_cards(cd), picture=picture) for picture in (False, True))
    wanted = -math.degrees(math.atan2(2 * sin, 2 * cos))
    assert math.remainder(told["orientation"] - wanted, 360.0) == pytest.approx(0.0, abs=1e-9)
    assert math.remainder(turned["orientation"] - (180.0 - wanted), 360.0) == pytest.approx(0.0, abs=1e-9)
    assert 0.0 <= turned["orientation"] < 360.0
    assert told["parity"] == turned["parity"] == float(parity)
    assert told["pixscale"] == pytest.approx(2.0)
    assert (told["width_arcsec"], told["height_arcsec"]) == pytest.approx((2000.0, 1600.0))
    assert told["radius"] == pytest.approx(math.hypot(1000, 800) / 3600.0, rel=1e-4)
