"""Alpaca's envelopes and images: what is read is what was said, and nothing else is ever read."""

from __future__ import annotations

import json
import struct
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from drivers.alpaca.codec import base, state
from drivers.alpaca.codec.base import Malformed, read_answer, reason_of
from drivers.alpaca.codec.exposure import Exposure, Told, read_image
from mountnav.errors import Refusal
from mountnav.sky.coordinates import Apparent, Icrs

CODES = {"i2": 1, "i4": 2, "f8": 3, "f4": 4, "u8": 5, "u1": 6, "i8": 7, "u2": 8, "u4": 9}
BINARY = "application/imagebytes"
NOON = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)


def image_bytes(
    image: np.ndarray[Any, Any], *, start: int = 44, transaction: int = 7, error: int = 0
) -> bytes:
    code = CODES[image.dtype.str[1:]]
    head = struct.pack(
        "<iiIIiiiiiii", 1, error, transaction, 9, start, 2, code, image.ndim, *(*image.shape, 0)[:3]
    )
    return head + bytes(start - 44) + image.astype(image.dtype.newbyteorder("<")).tobytes()


images = st.sampled_from(sorted(CODES)).flatmap(
    lambda code: arrays.arrays(
        np.dtype(f"<{code}"),
        arrays.array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9),
        elements={"allow_nan": False} if code.startswith("f") else None,
    )
)


@pytest.mark.long
@given(images, st.integers(44, 100))
@settings(max_examples=60, deadline=None)
def test_image_bytes_have_y_fastest_wherever_the_data_begin(image: np.ndarray[Any, Any], start: int) -> None:
    told = read_image(image_bytes(image, start=start), BINARY, 7)
    assert told.answer.error_number == 0
    assert told.pixels is not None
    assert told.pixels.dtype == image.dtype
    assert np.array_equal(told.pixels, image.T)
    if image.ndim == 3:
        x, y, plane = (side - 1 for side in image.shape)
        assert told.pixels[plane, y, x] == image[x, y, plane]


@given(images, st.data())
@settings(max_examples=60, deadline=None)
def test_image_bytes_cut_or_spoiled_are_never_another_image(
    image: np.ndarray[Any, Any], data: st.DataObject
) -> None:
    whole = image_bytes(image)
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(Malformed):
        read_image(whole[:cut], BINARY, 7)
    with pytest.raises(Malformed):
        read_image(whole + b"\x00", BINARY, 7)
    with pytest.raises(Malformed, match="for question 7"):
        read_image(whole, BINARY, 8)


@given(st.binary(max_size=200))
def test_any_bytes_are_an_image_or_malformed(body: bytes) -> None:
    for kind in (BINARY, "application/json"):
        try:
            read_image(body, kind, 1)
        except Malformed:
            continue


@given(images)
@settings(max_examples=40, deadline=None)
def test_json_says_the_same_image(image: np.ndarray[Any, Any]) -> None:
    if image.dtype == np.uint64 or (image.dtype.kind == "f" and not np.isfinite(image).all()):
        image = (np.nan_to_num(image) % 1000).astype(np.int32)
    body = json.dumps(
        {"Rank": image.ndim, "Value": image.tolist(), "ClientTransactionID": 7, "ErrorNumber": 0}
    )
    told = read_image(body.encode(), "application/json; charset=utf-8", 7)
    assert told.pixels is not None
    assert np.array_equal(told.pixels, image.T)


@pytest.mark.parametrize(
    "value", [[], [[]], [1, 2], [[1, 2], [3]], [["a"]], [[True]], {"a": 1}, None, [[[[1]]]]]
)
def test_json_that_is_no_image_is_none(value: object) -> None:
    with pytest.raises(Malformed):
        read_image(json.dumps({"Value": value, "ErrorNumber": 0}).encode(), "application/json", 7)


def test_an_error_in_place_of_an_image_is_told() -> None:
    body = struct.pack("<iiIIiiiiiii", 1, 0x402, 7, 9, 44, 0, 0, 0, 0, 0, 0) + "kein Bild, schön".encode()
    told = read_image(body, BINARY, 7)
    assert (told.pixels, told.answer.error_number) == (None, 0x402)
    assert told.answer.error_message == "kein Bild, schön"


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"ClientTransactionID": 8, "Value": 1, "ErrorNumber": 0}, "to question 8"),
        ({"ClientTransactionID": "7", "Value": 1, "ErrorNumber": 0}, "to question '7'"),
        ({"Value": 1, "ErrorNumber": "0x400"}, "an error number that is not an error"),
        ({"Value": 1, "ErrorNumber": 0, "ErrorMessage": 5}, "an error number that is not an error"),
        ({"detail": "Not Found"}, "no Alpaca answer"),
        ([], "no Alpaca answer"),
        (float("nan"), "NaN is not a number"),
    ],
)
def test_envelopes_that_are_none(said: object, why: str) -> None:
    with pytest.raises(Malformed, match=why):
        read_answer(json.dumps(said).encode(), "application/json", 7)


@pytest.mark.parametrize("echoed", [0, 7, None])
def test_servers_that_keep_no_ids_are_understood(echoed: int | None) -> None:
    said = {"ClientTransactionID": echoed, "Value": 1.5, "ErrorNumber": 0, "ErrorMessage": ""}
    assert read_answer(json.dumps(said).encode(), "application/json", 7).value == 1.5


@pytest.mark.parametrize(
    ("said", "number"), [(0x400, 0x400), (0x80040400, 0x400), (0x80040400 - (1 << 32), 0x400), (0x501, 0x501)]
)
def test_errors_of_com_are_errors_of_alpaca(said: int, number: int) -> None:
    body = json.dumps({"ErrorNumber": said, "ErrorMessage": "x"}).encode()
    assert read_answer(body, "application/json", 7).error_number == number


@given(st.floats(0.0, 360.0, exclude_max=True), st.floats(-90.0, 90.0))
def test_places_are_said_within_their_bounds_and_read_back(ra_deg: float, dec_deg: float) -> None:
    said = state.said_place(Icrs(ra_deg, dec_deg))
    form = base.form(said, 1, 2)
    assert 0.0 <= float(form["RightAscension"]) < 24.0
    assert "e" not in form["RightAscension"] + form["Declination"]
    back = state.place(float(form["RightAscension"]), float(form["Declination"]), "icrs", NOON)
    assert abs((back.ra_deg - ra_deg + 180.0) % 360.0 - 180.0) < 1e-8
    assert abs(back.dec_deg - dec_deg) < 1e-8


@pytest.mark.parametrize(
    ("ra", "dec"),
    [(24.1, 0.0), (-0.1, 0.0), (1.0, 90.5), (True, 0.0), ("1", 0.0), (1.0, None), (1.0, 10**400)],
)
def test_numbers_that_are_no_place(ra: object, dec: object) -> None:
    with pytest.raises(Malformed):
        state.place(ra, dec, "apparent", NOON)


def test_a_right_ascension_of_24_hours_is_0() -> None:
    assert state.place(24.0, 1.0, "apparent", NOON) == Apparent(0.0, 1.0, NOON)


@pytest.mark.parametrize(
    ("said", "read"),
    [
        ("2026-11-22T12:00:00.1234567Z", NOON.replace(microsecond=123456)),
        ("2026-11-22T12:00:00", NOON),
        ("2026-11-22T13:00:00+01:00", NOON),
        ("2026-11-22T12:00:00.5Z", NOON.replace(microsecond=500000)),
    ],
)
def test_instants_are_read_however_they_are_said(said: str, read: datetime) -> None:
    assert base.instant(said) == read
    assert base.instant(base.said_instant(read)) == read
    assert base.said_instant(read.astimezone(timezone(timedelta(hours=5)))).endswith("0Z")


@pytest.mark.parametrize(
    ("number", "words", "reason"),
    [
        (0x400, "", Refusal.UNSUPPORTED),
        (0x401, "RightAscension out of bounds", Refusal.LIMIT),
        (0x401, "The target is below the horizon", Refusal.BELOW_HORIZON),
        (0x408, "", Refusal.PARKED),
        (0x40B, "Telescope is not tracking", Refusal.NOT_TRACKING),
        (0x40B, "Slew already in progress", Refusal.BUSY),
        (0x40B, "Wrong state", Refusal.OTHER),
        (0x500, "Meridian limit reached", Refusal.LIMIT),
    ],
)
def test_refusals_are_told_apart(number: int, words: str, reason: Refusal) -> None:
    assert reason_of(number, words) is reason


@pytest.mark.parametrize(
    ("start_s", "middle_s", "whose"),
    [
        (0.4, 1.4, "the camera's clock"),
        (-0.8, 0.2, "the camera's clock"),
        (None, 1.25, "our clock"),
        (90.0, 1.25, "our clock"),
    ],
)
def test_the_middle_of_an_exposure(start_s: float | None, middle_s: float, whose: str) -> None:
    exposure = Exposure(2.0, NOON, NOON + timedelta(seconds=0.5))
    told = Told(None if start_s is None else NOON + timedelta(seconds=start_s), 2.0)
    middle, by = exposure.middle(told, NOON + timedelta(seconds=4.0), 1.0)
    assert (middle - NOON).total_seconds() == pytest.approx(middle_s)
    assert by.startswith(whose)


@pytest.mark.parametrize(
    ("start_s", "lasted_s", "agree", "another"),
    [
        (0.3, 2.0, True, False),
        # a camera that tells whole seconds, and still tells of the last one
        (-20.0, 2.0, True, True),
        # its clock was never seen to agree with ours
        (-20.0, 2.0, False, False),
        # an hour is a zone, and no exposure of before
        (-3600.0, 2.0, True, False),
        # the nearest that it has, or somebody else's
        (0.3, 2.5, True, False),
        (-20.0, 2.5, False, True),
        (0.3, 9.0, True, True),
        (None, 2.5, True, True),
    ],
)
def test_whose_image_it_is(start_s: float | None, lasted_s: float, agree: bool, another: bool) -> None:
    exposure = Exposure(2.0, NOON, NOON + timedelta(seconds=0.5), Told(NOON - timedelta(seconds=20), 2.0))
    told = Told(None if start_s is None else NOON + timedelta(seconds=start_s), lasted_s)
    came = NOON + timedelta(seconds=4.0)
    assert exposure.is_of_another(told, came, 1.0, clocks_agree=agree) is another


@pytest.mark.parametrize(
    "said",
    [
        "0001-01-01T00:00:00+23:59",
        "9999-12-31T23:59:59-23:59",
        "0001-01-01T00:00:00",
        "9999-12-31T23:59:59Z",
        "1899-12-31T23:59:59Z",
        "2026-13-01T00:00:00",
        "",
        "9" * 5000,
    ],
)
def test_instants_beyond_the_calendar_are_none(said: str) -> None:
    with pytest.raises(base.Malformed) as fault:
        base.instant(said)
    assert len(str(fault.value)) < 200


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(10**300, 10**310)
    | st.just(10**4000)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(["0001-01-01T00:00:00+23:59", "x" * 5000, "2026-11-22T12:00:00Z"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@pytest.mark.long
@given(json_values)
def test_whatever_a_server_sends_is_a_value_or_malformed(value: object) -> None:
    readers = (
        base.number,
        base.integer,
        base.truth,
        base.text,
        base.instant,
        base.named_values,
        state.pier_side,
        lambda one: state.place(one, one, "apparent", NOON),
    )
    for read in readers:
        words = ""
        try:
            read(value)
        except base.Malformed as fault:
            words = str(fault)
        assert len(words) < 400


@pytest.mark.parametrize("body", [b'{"Value": ' + b"[" * 100_000, b'{"Value": ' + b"9" * 5000 + b"}"])
def test_answers_that_python_refuses_to_read_are_malformed(body: bytes) -> None:
    with pytest.raises(base.Malformed):
        base.read_answer(body, "application/json", 1)
