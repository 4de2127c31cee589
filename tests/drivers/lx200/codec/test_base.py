"""The LX200 words: round trips, every reply whole, cut at each byte, and with a tail."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.lx200.codec import angles, base
from drivers.lx200.codec.base import Answer, Letter
from drivers.wire.command import Command, Unreadable
from mountnav.errors import Refusal

RA = st.floats(0.0, 360.0, exclude_max=True)
DEC = st.floats(-90.0, 90.0)


@given(RA)
def test_right_ascension_there_and_back(ra_deg: float) -> None:
    for short in (False, True):
        back = angles.ra_from_text(angles.ra_to_text(ra_deg, short=short))
        assert back.step_arcsec == (90.0 if short else 15.0)
        off_deg = (back.deg - ra_deg + 180.0) % 360.0 - 180.0
        assert abs(off_deg) * 3600.0 <= back.step_arcsec / 2.0 + 1e-6


@given(DEC)
def test_declination_there_and_back(dec_deg: float) -> None:
    for short in (False, True):
        back = angles.dec_from_text(angles.dec_to_text(dec_deg, short=short))
        assert back.step_arcsec == (60.0 if short else 1.0)
        assert abs(back.deg - dec_deg) * 3600.0 <= back.step_arcsec / 2.0 + 1e-6


@given(st.floats(-180.0, 180.0, exclude_min=True))
def test_longitude_there_and_back(longitude_deg: float) -> None:
    back = angles.longitude_from_text(angles.longitude_to_text(longitude_deg))
    assert abs((back - longitude_deg + 180.0) % 360.0 - 180.0) <= 0.5 / 60.0 + 1e-9


@pytest.mark.parametrize(
    ("deg", "long", "short"),
    [
        (359.9999, b"00:00:00", b"00:00.0"),
        (15.0 * (1 + 59 / 60 + 59.6 / 3600), b"02:00:00", b"02:00.0"),
        (15.0 * (12 + 43 / 60 + 18 / 3600), b"12:43:18", b"12:43.3"),
        (-0.001, b"00:00:00", b"00:00.0"),
    ],
)
def test_right_ascension_carries(deg: float, long: bytes, short: bytes) -> None:
    assert angles.ra_to_text(deg) == long
    assert angles.ra_to_text(deg, short=True) == short


@pytest.mark.parametrize(
    ("deg", "long", "short"),
    [
        (-0.5, b"-00*30:00", b"-00*30"),
        (-0.0001, b"+00*00:00", b"+00*00"),
        (42.0 + 59 / 60 + 59.9 / 3600, b"+43*00:00", b"+43*00"),
        (90.0, b"+90*00:00", b"+90*00"),
        (-89.99999, b"-90*00:00", b"-90*00"),
    ],
)
def test_declination_carries(deg: float, long: bytes, short: bytes) -> None:
    assert angles.dec_to_text(deg) == long
    assert angles.dec_to_text(deg, short=True) == short


@pytest.mark.parametrize(
    ("text", "deg"),
    [
        (b"-00*30", -0.5),
        (b"-00*30:36", -0.51),
        (b"+42\xdf30", 42.5),
        (b"+42\xb030:36", 42.51),
        (b"+42:30:36", 42.51),
        (b"+42*30'36", 42.51),
        (b"+42*30:36.00", 42.51),
        (b"-90*00:00", -90.0),
    ],
)
def test_all_forms_of_a_declination(text: bytes, deg: float) -> None:
    assert angles.dec_from_text(text).deg == pytest.approx(deg, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "deg", "step_arcsec"),
    [
        (b"12:40:40", 190.16666667, 15.0),
        (b"12:40.5", 190.125, 90.0),
        (b"12:40:40.5", 190.16875, 1.5),
        (b"12:40:40.50", 190.16875, 0.15),
    ],
)
def test_all_forms_of_a_right_ascension(text: bytes, deg: float, step_arcsec: float) -> None:
    angle = angles.ra_from_text(text)
    assert angle.deg == pytest.approx(deg, abs=1e-8)
    assert angle.step_arcsec == pytest.approx(step_arcsec)


@pytest.mark.parametrize("text", [b"-36*54", b"323:06:0.00", b"-036*54:00", b"323*06"])
def test_longitudes_that_real_drivers_send(text: bytes) -> None:
    assert angles.longitude_from_text(text) == pytest.approx(36.9)


@pytest.mark.parametrize(
    "text", [b"24:00:00", b"12:60:00", b"12:00:60", b"2:00:00", b"12:00:00\n", b"", b"+12:00:00"]
)
def test_no_right_ascension(text: bytes) -> None:
    with pytest.raises(Unreadable):
        angles.ra_from_text(text)


@pytest.mark.parametrize(
    "text", [b"12:34:56", b"+90*00:01", b"+12*60", b"+12*30:60", b"+12*30 ", b"", b"+1*30"]
)
def test_no_declination(text: bytes) -> None:
    with pytest.raises(Unreadable):
        angles.dec_from_text(text)


REPLIES: list[tuple[Command[Any], bytes, object]] = [
    (base.GET_RA, b"19:40:22#", angles.ra_from_text(b"19:40:22")),
    (base.GET_RA, b"19:40.3#", angles.ra_from_text(b"19:40.3")),
    (base.GET_DEC, b"+88*06:21#", angles.dec_from_text(b"+88*06:21")),
    (base.GET_DEC, b"-00\xdf30#", angles.dec_from_text(b"-00*30")),
    (base.SLEWING, b"\x7f#", True),
    (base.SLEWING, b"#", False),
    (base.SLEWING, b" " * 32 + b"#", False),
    (base.SLEWING, b"\x7f" * 5 + b" " * 27 + b"#", True),
    (base.SLEW, b"0", Answer()),
    (base.SLEW, b"1Object below horizon.#", Answer("Object below horizon.", Refusal.BELOW_HORIZON)),
    (base.SLEW, b"2Object below higher.#", Answer("Object below higher.", Refusal.LIMIT)),
    (base.SYNC, b"Coordinates     matched.        #", Answer()),
    (base.SYNC, b" M31 EX GAL MAG 3.5 SZ178.0'#", Answer()),
    (base.SYNC, b"N/A#", Answer()),
    (base.SYNC, b"E4#", Answer("code E4")),
    (base.ALIGNMENT, b"P", Letter("P")),
    (base.ALIGNMENT, b"A", Letter("A")),
    (base.ALIGNMENT, b"G#", Letter("G", True)),
    (base.set_ra(190.0), b"1", True),
    (base.set_dec(42.0), b"0", False),
    (base.PRODUCT, b"On-Step#", "On-Step"),
]


@pytest.mark.parametrize(("command", "reply", "value"), REPLIES)
def test_replies_whole_cut_and_with_a_tail(command: Command[Any], reply: bytes, value: object) -> None:
    whole = command.read(reply, False)
    assert whole is not None
    assert (whole.value, whole.length) == (value, len(reply))
    least = 1 if command is base.ALIGNMENT else len(reply)
    for cut in range(least):
        assert command.read(reply[:cut], False) is None
    tailed = command.read(reply + b"+12*30#", False)
    assert tailed is not None
    assert (tailed.value, tailed.length) == (value, len(reply))


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (base.GET_DEC, b"19:40:22#"),
        (base.GET_RA, b"+88*06:21#"),
        (base.SYNC, b"19:40:22#"),
        (base.SYNC, b"+88*06:21#"),
        (base.SLEWING, b"19:40:22#"),
        (base.SLEW, b"+88*06:21#"),
        (base.set_ra(0.0), b"+88*06:21#"),
        (base.ALIGNMENT, b"1"),
        (base.GET_RA, b"x" * 200),
    ],
)
def test_the_answer_of_another_question_is_none(command: Command[Any], reply: bytes) -> None:
    with pytest.raises(Unreadable):
        command.read(reply, False)


def test_a_bare_digit_is_a_refusal_only_when_no_more_comes() -> None:
    assert base.SLEW.read(b"6", False) is None
    read = base.SLEW.read(b"6", True)
    assert read is not None
    assert read.value == Answer("code 6")
    assert base.SLEW.read(b"1Object bel", True) is None


@given(st.binary(max_size=40))
def test_no_bytes_break_a_reader(noise: bytes) -> None:
    for command, _, _ in REPLIES:
        try:
            read = command.read(noise, False)
        except Unreadable:
            continue
        assert read is None or 0 < read.length <= len(noise)
