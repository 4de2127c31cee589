"""Alpaca's parameters, envelopes, paths and numbers, without a wire."""

from __future__ import annotations

import contextlib
import json
import math
from urllib.parse import quote_plus, urlencode

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.alpaca.answering import MEMBERS
from api.alpaca.codec import (
    NOTHING,
    BadParameter,
    DevicePath,
    ManagementPath,
    SetupPath,
    Transactions,
    decimal,
    envelope,
    from_form,
    from_query,
    instant,
    read_path,
    required,
    truth,
    turned,
    unsigned,
    whole,
)
from api.alpaca.errors import AlpacaError, Number, error_of, failure_of
from api.alpaca.member import never
from api.problems import STATUS_OF_SLUG, problem, problem_of
from mountnav.errors import DeviceRefused, LimitKind, OutsideLimits, Refusal

_NAMES = st.text(st.characters(codec="ascii", categories=["Lu", "Ll"]), min_size=1, max_size=20)


@pytest.mark.long
@given(st.dictionaries(_NAMES, st.text(max_size=30).filter(lambda text: "\ud800" not in text), max_size=8))
def test_a_form_comes_through_as_it_was_sent(fields: dict[str, str]) -> None:
    assert from_form(urlencode(fields).encode()) == fields


@pytest.mark.long
@given(_NAMES, st.text(st.characters(codec="utf-8"), max_size=20), st.randoms())
def test_names_in_a_query_count_in_any_case_and_in_a_form_in_one(name: str, value: str, random) -> None:
    other = "".join(random.choice((letter.upper(), letter.lower())) for letter in name)
    text = f"{other}={quote_plus(value)}".encode()
    assert required(from_query(text), name, any_case=True) == value
    if other == name:
        assert required(from_form(text), name, any_case=False) == value
    else:
        with pytest.raises(BadParameter):
            required(from_form(text), name, any_case=False)


@given(st.binary(max_size=200))
def test_no_bytes_bring_the_reader_down(body: bytes) -> None:
    for reader in (from_query, from_form):
        with contextlib.suppress(BadParameter):
            reader(body)


def test_the_first_of_several_counts() -> None:
    # a client that repeats a key for each of several parameters of an action
    assert from_form(b"Parameters=a&Parameters=b") == {"Parameters": "a"}
    assert from_query(b"RA=1&ra=2") == {"ra": "1"}


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_number_is_read_as_written(value: float) -> None:
    assert decimal("RightAscension", repr(value)) == value


@pytest.mark.parametrize(
    "text",
    [
        "",
        " ",
        "nan",
        "NaN",
        "inf",
        "-Infinity",
        "1e999",
        "1,5",
        "1 000",
        "0x10",
        "1_0",
        "12h",
        "٣",
        "1.2.3",
        "+",
        ".",
    ],
)
def test_what_is_no_finite_number_is_refused(text: str) -> None:
    with pytest.raises(BadParameter, match="RightAscension"):
        decimal("RightAscension", text)


@given(st.integers(-(2**31), 2**31 - 1))
def test_whole_numbers_of_32_bits(value: int) -> None:
    assert whole("Axis", str(value)) == value


@pytest.mark.parametrize(
    "text", ["", "1.0", "1e2", "2147483648", "-2147483649", "true", "1_0", "99999999999", "٣"]
)
def test_what_is_no_whole_number_is_refused(text: str) -> None:
    with pytest.raises(BadParameter, match="Axis"):
        whole("Axis", text)


@pytest.mark.parametrize(
    ("text", "value"), [("true", True), ("True", True), ("FALSE", False), ("false", False), ("tRuE", True)]
)
def test_truth_in_any_case(text: str, value: bool) -> None:
    assert truth("Connected", text) is value


@pytest.mark.parametrize("text", ["", "1", "0", "yes", "on", "truee", " true"])
def test_nothing_else_is_true_or_false(text: str) -> None:
    with pytest.raises(BadParameter):
        truth("Connected", text)


@given(st.integers(0, 2**32 - 1))
def test_ids_are_echoed(value: int) -> None:
    assert unsigned(str(value)) == value


@pytest.mark.parametrize(
    "text", [None, "", "     ", "-1", "-12345", "NASDAQ", "4294967296", "1.0", "+5", "1e3"]
)
def test_what_is_no_id_counts_as_none(text: str | None) -> None:
    assert unsigned(text) == 0


@pytest.mark.parametrize(
    "text", ["2026-11-22T09:00:00.1234567Z", "2026-11-22T09:00:00", "2026-11-22T11:00:00+02:00"]
)
def test_instants_as_clients_write_them(text: str) -> None:
    found = instant("UTCDate", text)
    assert (found.hour, found.utcoffset().total_seconds()) == (9, 0)  # type: ignore[union-attr]


@pytest.mark.parametrize("text", ["", "yesterday", "2026-13-01T00:00:00Z", "0001-01-01T00:00:00+23:00"])
def test_what_is_no_instant_is_refused(text: str) -> None:
    with pytest.raises(BadParameter):
        instant("UTCDate", text)


@given(st.floats(-1e9, 1e9), st.sampled_from([24.0, 360.0]))
def test_an_angle_never_comes_out_as_a_whole_turn(angle: float, turn: float) -> None:
    found = turned(angle, turn)
    assert 0.0 <= found < turn
    assert math.remainder(found - angle, turn) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("angle", [-1e-20, -5e-324, 360.0, -360.0, 720.0, math.nextafter(360.0, 0.0)])
def test_angles_at_the_seam(angle: float) -> None:
    assert 0.0 <= turned(angle, 360.0) < 360.0
    assert math.copysign(1.0, turned(angle, 360.0)) == 1.0


_JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**31), 2**31)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3),
)


@given(st.integers(0, 2**32 - 1), st.integers(1, 2**32 - 1), _JSON)
def test_an_envelope_has_exactly_its_keys(client: int, server: int, value: object) -> None:
    found = json.loads(envelope(client, server, value))
    assert found == {
        "Value": value,
        "ClientTransactionID": client,
        "ServerTransactionID": server,
        "ErrorNumber": 0,
        "ErrorMessage": "",
    }
    without = json.loads(envelope(client, server))
    assert set(without) == set(found) - {"Value"}


@pytest.mark.parametrize("value", [math.nan, math.inf, [1.0, math.nan]])
def test_no_envelope_holds_what_json_cant(value: object) -> None:
    with pytest.raises(ValueError):
        envelope(1, 1, value)


def test_an_error_has_a_number_and_words() -> None:
    found = json.loads(envelope(5, 6, NOTHING, AlpacaError(0x40B, "")))
    assert found["ErrorNumber"] == 0x40B
    assert found["ErrorMessage"]


def test_transactions_begin_at_one_and_never_reach_zero_again() -> None:
    counted = Transactions()
    assert [counted.next() for _ in range(3)] == [1, 2, 3]
    late = Transactions(2**32 - 2)
    assert [late.next() for _ in range(3)] == [2**32 - 1, 1, 2]


@pytest.mark.parametrize(
    ("path", "asked"),
    [
        ("/api/v1/telescope/0/tracking", DevicePath(0, "tracking")),
        ("/api/v1/telescope/4294967295/slewing", DevicePath(4294967295, "slewing")),
        ("/management/apiversions", ManagementPath("apiversions")),
        ("/management/v1/description", ManagementPath("description")),
        ("/management/v1/configureddevices", ManagementPath("configureddevices")),
        ("/setup", SetupPath(None)),
        ("/setup/", SetupPath(None)),
        ("/setup/v1/telescope/1/setup", SetupPath(1)),
        ("/api/v1/telescope/0/Tracking", None),
        ("/API/v1/telescope/0/tracking", None),
        ("/api/V1/telescope/0/tracking", None),
        ("/api/v2/telescope/0/tracking", None),
        ("/api/v1/Telescope/0/tracking", None),
        ("/api/v1/telescope/-1/tracking", None),
        ("/api/v1/telescope/A/tracking", None),
        ("/api/v1/telescope/4294967296/tracking", None),
        ("/api/v1/telescope/0/tracking/", None),
        ("/api/v1/telescope//tracking", None),
        ("/api/v1/telescope/0", None),
        ("/api/v1/camera/0/connected", None),
        ("/api/v1/telescope/٠/tracking", None),
        ("/management/v1/", None),
        ("/setup/v1/telescope/0/Setup", None),
    ],
)
def test_paths(path: str, asked: object) -> None:
    assert read_path(path) == asked


def test_each_slug_has_a_number_that_the_standard_allows() -> None:
    for slug in STATUS_OF_SLUG:
        found = problem(slug, 400, "words")
        assert error_of(found).words
        number = error_of(found).number
        assert number in set(Number) or 0x500 <= number <= 0xFFF
        failed = failure_of(found).number
        assert 0x500 <= failed <= 0xFFF or failed == Number.CANCELLED


@pytest.mark.parametrize(
    ("reason", "number"),
    [
        (Refusal.PARKED, 0x408),
        (Refusal.UNSUPPORTED, 0x400),
        (Refusal.UNTRUSTED, 0x40B),
        (Refusal.OTHER, 0x504),
    ],
)
def test_a_mounts_refusals(reason: Refusal, number: int) -> None:
    assert error_of(problem_of(DeviceRefused("no", device="east", reason=reason))).number == number


@pytest.mark.parametrize(("limit", "number"), [(LimitKind.DECLINATION, 0x401), (LimitKind.HORIZON, 0x40B)])
def test_limits_that_no_waiting_moves_make_a_value_invalid(limit: LimitKind, number: int) -> None:
    assert error_of(problem_of(OutsideLimits("no", limit=limit))).number == number


_ITELESCOPE_V4 = """
action commandblind commandbool commandstring connect connected connecting description devicestate disconnect
driverinfo driverversion interfaceversion name supportedactions
alignmentmode altitude aperturearea aperturediameter athome atpark azimuth canfindhome canpark canpulseguide
cansetdeclinationrate cansetguiderates cansetpark cansetpierside cansetrightascensionrate cansettracking
canslew canslewaltaz canslewaltazasync canslewasync cansync cansyncaltaz canunpark declination declinationrate
doesrefraction equatorialsystem focallength guideratedeclination guideraterightascension ispulseguiding
rightascension rightascensionrate sideofpier siderealtime siteelevation sitelatitude sitelongitude slewing
slewsettletime targetdeclination targetrightascension tracking trackingrate trackingrates utcdate
abortslew axisrates canmoveaxis destinationsideofpier findhome moveaxis park pulseguide setpark slewtoaltaz
slewtoaltazasync slewtocoordinates slewtocoordinatesasync slewtotarget slewtotargetasync synctoaltaz
synctocoordinates synctotarget unpark
"""


def test_every_member_of_the_interface_is_there_and_none_besides() -> None:
    assert {name for _, name in MEMBERS} == set(_ITELESCOPE_V4.split())
    writable = {name for verb, name in MEMBERS if verb == "PUT"}
    readable = {name for verb, name in MEMBERS if verb == "GET"}
    assert writable & readable == {
        "connected",
        "declinationrate",
        "doesrefraction",
        "guideratedeclination",
        "guideraterightascension",
        "rightascensionrate",
        "sideofpier",
        "siteelevation",
        "sitelatitude",
        "sitelongitude",
        "slewsettletime",
        "targetdeclination",
        "targetrightascension",
        "tracking",
        "trackingrate",
        "utcdate",
    }


def test_whatever_this_server_never_does_it_says_why() -> None:
    silent = [name for (_, name), member in MEMBERS.items() if member.able is never and not member.why_not]
    assert not silent
