"""LX200 from the mount's side, as bytes: commands are cut out of noise, replies fit our driver's readers."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from api.planetarium import lx200_codec
from drivers.lx200.codec.angles import dec_from_text
from drivers.lx200.codec.base import SYNC, slew_answer
from drivers.lx200.codec.site_and_time import hours_to_utc_from_text, set_date

COMMANDS = st.sampled_from(
    [b":GR#", b":GD#", b":Sr12:34:56#", b":Sd+12\xdf34:56#", b":MS#", b":Q#", b"\x06", b":Sd -05*06#", b":U#"]
)
NOISE = st.binary(max_size=5).map(lambda raw: raw.replace(b":", b"").replace(b"\x06", b""))


def all_cut(pieces: list[bytes]) -> list[bytes]:
    found, buffer = [], b""
    for piece in pieces:
        buffer += piece
        while True:
            command, buffer = lx200_codec.cut(buffer)
            if command is None:
                break
            found.append(command)
    return found


@settings(deadline=None)
@given(st.lists(st.tuples(NOISE, COMMANDS), max_size=8), st.lists(st.integers(1, 20), max_size=40))
def test_commands_are_cut_out_of_noise_and_pieces(said: list[tuple[bytes, bytes]], cuts: list[int]) -> None:
    wire = b"".join(noise + command for noise, command in said)
    pieces, at = [], 0
    for cut in [*cuts, len(wire) + 1]:
        pieces.append(wire[at : at + cut])
        at += cut
    assert all_cut(pieces) == [command for _, command in said]


def test_what_stellarium_mobile_asks_first() -> None:
    """``Ka`` is NexStar's echo, ``##`` clears the line, then ACK."""
    assert all_cut([b"Ka", b"##", b"#\x06"]) == [b"\x06"]


@settings(deadline=None)
@given(st.binary(max_size=400))
def test_no_bytes_do_harm(junk: bytes) -> None:
    for command in all_cut([junk]):
        assert command == b"\x06" or (command[:1] == b":" and command[-1:] == b"#")
        assert len(command) <= lx200_codec.LONGEST_COMMAND


def test_a_command_that_never_ends_is_given_up() -> None:
    command, rest = lx200_codec.cut(b":S" + b"x" * 500 + b":GR#")
    assert (command, rest) == (b":GR#", b"")


@settings(deadline=None)
@given(st.text(max_size=300))
def test_words_fit_a_reply(said: str) -> None:
    words = lx200_codec.words(said)
    assert b"#" not in words
    assert words.isascii()
    read = slew_answer(b"2" + words + b"#", True)
    assert read is not None
    assert read.value.refusal
    assert read.length == len(words) + 2


@pytest.mark.parametrize("sign", [b"*", b"\xdf", b"\xb0", b":", b"\xc2\xb0"])
def test_degree_signs_of_all_kinds(sign: bytes) -> None:
    assert dec_from_text(lx200_codec.plain_angle(b" -05" + sign + b"30:00")).deg == pytest.approx(-5.5)


@settings(deadline=None)
@given(st.floats(0.0, 360.0, exclude_max=True), st.booleans())
def test_azimuths(azimuth_deg: float, short: bool) -> None:
    text = lx200_codec.azimuth_text(azimuth_deg, short=short).decode()
    parts = [float(one) for one in text.replace("'", "*").split("*")]
    read_deg = sum(part / 60.0**power for power, part in enumerate(parts))
    step_deg = 1.0 / 60.0 if short else 1.0 / 3600.0
    assert abs((read_deg - azimuth_deg + 180.0) % 360.0 - 180.0) <= 0.51 * step_deg
    assert len(text) == (6 if short else 9)


def test_altitudes_are_written_as_meade_has_it() -> None:
    assert lx200_codec.altitude_text(-0.5, short=False) == b"-00*30'00"
    assert lx200_codec.altitude_text(45.26, short=True) == b"+45*16"


@settings(deadline=None)
@given(st.integers(-48, 56).map(lambda quarters: quarters / 4.0))
def test_zones(hours_to_utc: float) -> None:
    read = hours_to_utc_from_text(lx200_codec.zone_text(hours_to_utc))
    assert read == pytest.approx(hours_to_utc, abs=0.051)


def test_our_driver_reads_our_replies() -> None:
    synced = SYNC.read(lx200_codec.MATCHED, True)
    assert synced is not None
    assert synced.value.refusal is None
    day = set_date(datetime(2026, 11, 22, tzinfo=UTC).date()).read(lx200_codec.UPDATING, True)
    assert day is not None
    assert (day.value, day.length) == (True, len(lx200_codec.UPDATING))


def test_times_of_day_in_a_zone_or_any() -> None:
    utc = datetime(2026, 11, 22, 23, 59, 50, tzinfo=UTC)
    ours = timedelta(hours=1, minutes=0, seconds=5)
    assert lx200_codec.is_that_time(ours, utc, -1.0)
    assert lx200_codec.is_that_time(ours, utc, None)
    assert not lx200_codec.is_that_time(ours, utc, -2.0)
    assert not lx200_codec.is_that_time(ours + timedelta(minutes=5), utc, None)
