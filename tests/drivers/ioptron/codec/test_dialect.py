"""The iOptron words: round trips, every reply whole, cut at each byte, flipped, and with a tail."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ioptron.codec import greeting, v2, v3, values
from drivers.ioptron.codec.frames import Order, order_from_text
from drivers.ioptron.codec.greeting import GREETING
from drivers.ioptron.codec.values import MountClock, MountState, PierSide, Pointing, Status, TrackingRate
from drivers.wire.command import Command, Unreadable

RA = st.floats(0.0, 360.0, exclude_max=True)
DEC = st.floats(-90.0, 90.0)
HALF_STEP_DEG = 0.005 / 3600.0 + 1e-12
STATUSES = st.builds(
    Status,
    st.floats(-180.0, 180.0),
    DEC,
    st.integers(0, 2),
    st.sampled_from(MountState),
    st.sampled_from(TrackingRate),
    st.integers(1, 9),
    st.integers(1, 3),
    st.booleans(),
)
POINTINGS = st.builds(Pointing, RA, DEC, st.sampled_from(PierSide), st.booleans())
CLOCKS = st.builds(
    MountClock,
    st.integers(0, 10**12).map(lambda ms: datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(milliseconds=ms)),
    st.integers(-720, 840),
    st.booleans(),
)


@given(STATUSES)
def test_status_there_and_back(status: Status) -> None:
    text = values.status_to_text(status)
    assert len(text) == 23
    back = values.status_from_text(text)
    assert abs(back.longitude_deg - status.longitude_deg) <= HALF_STEP_DEG
    assert abs(back.latitude_deg - status.latitude_deg) <= HALF_STEP_DEG
    for field in ("gps", "state", "rate", "arrow_speed", "time_source", "northern"):
        assert getattr(back, field) == getattr(status, field)


@given(POINTINGS)
def test_pointing_there_and_back(pointing: Pointing) -> None:
    text = values.pointing_to_text(pointing)
    assert len(text) == 20
    back = values.pointing_from_text(text)
    assert abs((back.ra_deg - pointing.ra_deg + 180.0) % 360.0 - 180.0) <= HALF_STEP_DEG
    assert abs(back.dec_deg - pointing.dec_deg) <= HALF_STEP_DEG
    assert (back.pier, back.counterweight_up) == (pointing.pier, pointing.counterweight_up)


@given(CLOCKS)
def test_clock_there_and_back(clock: MountClock) -> None:
    assert values.clock_from_text(values.clock_to_text(clock)) == clock


@given(STATUSES)
def test_status_of_the_older_set_there_and_back(status: Status) -> None:
    text = v2.status_to_text(status)
    assert len(text) == 19
    back = v2.status_from_text(text)
    assert abs(back.longitude_deg - status.longitude_deg) <= 0.5 / 3600.0 + 1e-9
    assert abs(back.latitude_deg - status.latitude_deg) <= 0.5 / 3600.0 + 1e-9
    assert text[-6:] == v2.flags_to_text(status)
    for field in ("gps", "state", "rate", "arrow_speed", "time_source", "northern"):
        assert getattr(back, field) == getattr(status, field)


@given(POINTINGS)
def test_pointing_of_the_older_set_there_and_back(pointing: Pointing) -> None:
    text = v2.pointing_to_text(pointing)
    assert len(text) == 17
    back = v2.pointing_from_text(text)
    half_step_deg = 0.0075 / 3600.0 + 1e-12
    assert abs((back.ra_deg - pointing.ra_deg + 180.0) % 360.0 - 180.0) <= half_step_deg
    assert abs(back.dec_deg - pointing.dec_deg) <= HALF_STEP_DEG


@given(CLOCKS)
def test_clock_of_the_older_set_there_and_back(clock: MountClock) -> None:
    text = v2.clock_to_text(clock)
    assert len(text) == 17
    assert v2.clock_from_text(text) == replace(clock, utc=clock.utc.replace(microsecond=0))


def test_local_time_has_zone_and_summer_time_in_it() -> None:
    # the example of INDI's driver, with the digit that its author found on a real mount
    clock = v2.clock_from_text(b"+1801150331173000")
    assert clock.utc == datetime(2015, 3, 31, 13, 30, tzinfo=UTC)
    assert (clock.offset_min, clock.summer_time) == (180, True)


@given(st.floats(-90.0, 90.0), RA)
def test_horizontal_there_and_back(alt_deg: float, az_deg: float) -> None:
    back = values.horizontal_from_text(values.horizontal_to_text(values.Horizontal(alt_deg, az_deg)))
    assert abs(back.alt_deg - alt_deg) <= HALF_STEP_DEG
    assert abs((back.az_deg - az_deg + 180.0) % 360.0 - 180.0) <= HALF_STEP_DEG


def test_a_model_number_means_another_mount_in_another_set() -> None:
    assert greeting.model("0026", "v3").name == "CEM26"
    assert greeting.model("0026", "v2").name == "CEM25-EC"
    assert greeting.model("0043", "v3").searches_home
    assert not greeting.model("0028", "v3").searches_home
    assert not greeting.model("0046", "v2").equatorial
    assert greeting.model("0030", "v2").parks
    assert not greeting.model("0025", "v2").parks
    assert greeting.model("9999", "v3").equatorial


def test_recorded_words_mean_what_indi_made_of_them() -> None:
    # the site and the time are INDI's own messages in the transcript
    status = values.status_from_text(b"+1328400050256000210921")
    assert (status.longitude_deg, status.latitude_deg) == pytest.approx((36.9, 49.6))
    assert (status.state, status.rate) == (MountState.TRACKING, TrackingRate.SIDEREAL)
    clock = values.clock_from_text(b"+00000848517099444")
    assert clock.utc == datetime(2026, 11, 21, 7, 11, 39, 444_000, tzinfo=UTC)
    pointing = values.pointing_from_text(b"+1530450006846364611")
    assert (pointing.ra_deg / 15.0, pointing.dec_deg) == pytest.approx((12.67845, 42.5125), abs=1e-5)
    assert (pointing.pier, pointing.counterweight_up) == (PierSide.WEST, False)


@pytest.mark.parametrize(
    ("deg", "text"),
    [(359.999999, b"000000000"), (0.0, b"000000000"), (190.17675, b"068463630"), (-0.5, b"129420000")],
)
def test_right_ascension_wraps(deg: float, text: bytes) -> None:
    assert values.ra_to_text(deg) == text


@pytest.mark.parametrize(("deg", "text"), [(-1e-9, b"+00000000"), (-0.5, b"-00180000"), (90.0, b"+32400000")])
def test_declination_keeps_its_sign(deg: float, text: bytes) -> None:
    assert values.dec_to_text(deg) == text


REPLIES: list[tuple[Command[Any], bytes, object]] = [
    (v3.MODEL, b"0043", "0043"),
    (v3.FIRMWARE, b"210105xxxxxx#", "210105/xxxxxx"),
    (v3.MERIDIAN, b"115#", (True, 15)),
    (v3.ALTITUDE_LIMIT, b"-05#", -5),
    (v3.HORIZONTAL, b"+16200000032400000#", values.Horizontal(45.0, 90.0)),
    (v3.STATUS, b"+1328400050256000210921#", values.status_from_text(b"+1328400050256000210921")),
    (v3.STATUS, b"-1328400000256000060921#", values.status_from_text(b"-1328400000256000060921")),
    (v3.POINTING, b"-1530450006846364620#", values.pointing_from_text(b"-1530450006846364620")),
    (v3.CLOCK, b"-12010848517099444#", values.clock_from_text(b"-12010848517099444")),
    (v3.SLEW, b"1", True),
    (v3.SLEW, b"0", False),
    (v3.SYNC, b"1", True),
    (v3.PARK, b"1", True),
    (GREETING, b"+1328400050256000210921#", v3.V3),
    (GREETING, b"+132840502560210921#", v2.V2),
    (v2.STATUS, b"+132840502560210921#", v2.status_from_text(b"+132840502560210921")),
    (v2.POINTING, b"-1530450045642420#", v2.pointing_from_text(b"-1530450045642420")),
    (v2.CLOCK, b"-3001261121071139#", v2.clock_from_text(b"-3001261121071139")),
    (v2.SLEW, b"0", False),
    (v3.set_ra(190.0), b"1", True),
    (v3.set_dec(42.0), b"0", False),
]


@pytest.mark.parametrize(("command", "reply", "value"), REPLIES)
def test_replies_whole_cut_and_with_a_tail(command: Command[Any], reply: bytes, value: object) -> None:
    for tail in (b"", b"1", b"+"):
        whole = command.read(reply + tail, False)
        assert whole is not None
        # a one behind a signed text is the answer to a stop
        taken = tail if tail == b"1" and reply[:1] in (b"+", b"-") else b""
        assert (whole.value, whole.length) == (value, len(reply + taken))
    for cut in range(len(reply)):
        for final in (False, True):
            assert command.read(reply[:cut], final) is None


@pytest.mark.parametrize(("command", "reply", "value"), [row for row in REPLIES if b"#" in row[1]])
def test_a_lost_or_doubled_byte_is_no_reply(command: Command[Any], reply: bytes, value: object) -> None:
    for place in range(len(reply) - 1):
        for spoiled in (
            reply[:place] + reply[place + 1 :],
            reply[:place] + reply[place : place + 1] + reply[place:],
        ):
            if spoiled.lstrip(b"1") == reply or (command is v3.FIRMWARE and len(spoiled) == 17):
                continue
            with pytest.raises(Unreadable):
                command.read(spoiled, False)


@pytest.mark.parametrize(("command", "reply", "value"), REPLIES)
def test_a_flipped_bit_is_seen_or_leaves_a_digit_a_digit(
    command: Command[Any], reply: bytes, value: object
) -> None:
    """A flip that makes another digit, or sign, of a field in range is all that the wire can't tell."""
    for place in range(len(reply)):
        for bit in range(8):
            flipped = bytes([reply[place] ^ (1 << bit)])
            try:
                read = command.read(reply[:place] + flipped + reply[place + 1 :], True)
            except Unreadable:
                continue
            if read is not None:
                assert reply[place : place + 1].isdigit()
                assert flipped.isdigit()
                assert read.length == len(reply)


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (v3.STATUS, b"-1530450006846364620#"),
        (v3.POINTING, b"+1328400050256000210921#"),
        (v3.CLOCK, b"-1530450006846364620#"),
        (v3.POINTING, b"+00000848517099444#"),
        (v3.POINTING, b"0043"),
        (v3.POINTING, b"1111111111111+"),
        (v3.POINTING, b"+3240000112846364620#"),
        (v3.POINTING, b"+3240000012960000120#"),
        (v3.STATUS, b"+6480000150256000210921#"),
        (v3.CLOCK, b"+90000848517099444#"),
        (v3.SLEW, b"+1530450006846364620#"),
        (v3.set_ra(0.0), b"-"),
        (v3.MODEL, b"+153"),
        (v3.STATUS, b"x" * 200),
    ],
)
def test_the_answer_of_another_question_is_none(command: Command[Any], reply: bytes) -> None:
    with pytest.raises(Unreadable):
        command.read(reply, False)


def test_the_answers_of_stops_are_passed_over() -> None:
    reply = b"+1530450006846364620#"
    for stops in range(1, 5):
        assert v3.POINTING.read(b"1" * stops, False) is None
        read = v3.POINTING.read(b"1" * stops + reply, False)
        assert read is not None
        assert (read.value, read.length) == (values.pointing_from_text(reply[:-1]), stops + len(reply))
        read = v3.POINTING.read(b"1" + reply + b"1" * stops, False)
        assert read is not None
        assert read.length == 1 + len(reply) + stops
        # anything else behind it is not
        read = v3.POINTING.read(reply + b"1" * stops + b"+", False)
        assert read is not None
        assert read.length == len(reply)


@given(st.binary(max_size=40))
def test_no_bytes_break_a_reader(noise: bytes) -> None:
    for command, _, _ in REPLIES:
        try:
            read = command.read(noise, False)
        except Unreadable:
            continue
        assert read is None or 0 < read.length <= len(noise)


@given(st.binary(max_size=40))
def test_no_bytes_break_the_other_side(noise: bytes) -> None:
    for dialect in ("v3", "v2"):
        order = order_from_text(noise, dialect)
        assert order is None or noise == b":" + order.name.encode() + order.text + b"#"


ORDERS: list[tuple[Command[Any], bytes, Order]] = [
    # as real INDI drivers sent them
    (v3.set_dec(42.5125), b":Sd+15304500#", Order("Sd", b"+15304500")),
    (v3.set_longitude(36.9), b":SLO+13284000#", Order("SLO", b"+13284000")),
    (v3.set_latitude(49.6), b":SLA+17856000#", Order("SLA", b"+17856000")),
    (
        v3.set_time(datetime(2026, 11, 21, 7, 11, 48, tzinfo=UTC)),
        b":SUT0848517108000#",
        Order("SUT", b"0848517108000"),
    ),
    (v3.set_offset(120), b":SG+120#", Order("SG", b"+120")),
    (v3.set_park_azimuth(0.0), b":SPA000000000#", Order("SPA", b"000000000")),
    (v3.set_tracking(False), b":ST0#", Order("ST", b"0")),
    (v3.set_rate(TrackingRate.LUNAR), b":RT1#", Order("RT", b"1")),
    (v3.pulse("n", 500), b":ZE00500#", Order("ZE", b"00500")),
    (v3.pulse("w", 500), b":ZQ00500#", Order("ZQ", b"00500")),
    # from the command set alone
    (v3.set_park_altitude(49.6), b":SPH17856000#", Order("SPH", b"17856000")),
    (v3.set_summer_time(True), b":SDS1#", Order("SDS", b"1")),
    (v3.set_custom_rate(1.0), b":RR10000#", Order("RR", b"10000")),
    (v3.set_ra(190.17675), b":SRA068463630#", Order("SRA", b"068463630")),
    (v3.SLEW, b":MS1#", Order("MS1", b"")),
    (v3.SYNC, b":CM#", Order("CM", b"")),
    (v3.HOME, b":MH#", Order("MH", b"")),
    (v3.UNPARK, b":MP0#", Order("MP0", b"")),
    (v3.FIND_HOME, b":MSH#", Order("MSH", b"")),
    (v3.set_hemisphere(False), b":SHE0#", Order("SHE", b"0")),
]

V2_ORDERS: list[tuple[Command[Any], bytes, Order]] = [
    (v2.set_ra(190.17675), b":Sr45642420#", Order("Sr", b"45642420")),
    (v2.set_longitude(-36.9), b":Sg-132840#", Order("Sg", b"-132840")),
    (v2.set_latitude(49.6), b":St+178560#", Order("St", b"+178560")),
    (v2.set_date(datetime(2026, 11, 21)), b":SC261121#", Order("SC", b"261121")),
    (v2.set_local_time(datetime(2026, 11, 21, 7, 1, 2)), b":SL070102#", Order("SL", b"070102")),
    (v2.pulse("w", 500), b":Mw00500#", Order("Mw", b"00500")),
    (v2.SLEW, b":MS#", Order("MS", b"")),
    (v2.POINTING, b":GEC#", Order("GEC", b"")),
    (v2.CLOCK, b":GLT#", Order("GLT", b"")),
]


@pytest.mark.parametrize(("command", "sent", "order"), ORDERS)
def test_orders_are_written_and_understood(command: Command[Any], sent: bytes, order: Order) -> None:
    assert command.sent == sent
    assert order_from_text(sent) == order


@pytest.mark.parametrize(("command", "sent", "order"), V2_ORDERS)
def test_orders_of_the_older_set(command: Command[Any], sent: bytes, order: Order) -> None:
    assert command.sent == sent
    assert order_from_text(sent, "v2") == order
    assert order_from_text(sent, "v3") is None or sent[:2] == b":M"


def test_what_the_wire_cannot_tell_is_not_written() -> None:
    for wrong in (
        lambda: v2.set_longitude(180.5),
        lambda: v2.set_latitude(-91.0),
        lambda: v2.pulse("n", 32_768),
        lambda: v3.set_dec(90.1),
        lambda: v3.set_longitude(180.5),
        lambda: v3.set_latitude(-91.0),
        lambda: v3.set_park_altitude(-1.0),
        lambda: v3.set_custom_rate(2.0),
        lambda: v3.set_offset(900),
        lambda: v3.set_time(datetime(1999, 1, 1, tzinfo=UTC)),
        lambda: v3.pulse("n", 100_000),
    ):
        with pytest.raises(ValueError):
            wrong()
