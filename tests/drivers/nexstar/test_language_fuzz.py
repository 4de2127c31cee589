"""Bad luck on a NexStar cable: any bytes, lost, late, cut and flipped, also payloads that hold a 0x23."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.nexstar.codec import base, site_and_time
from drivers.nexstar.codec.dialect import Handset, Version
from drivers.nexstar.codec.passthrough import Axis
from drivers.nexstar.codec.replies import ECHOES, pair_to_text
from drivers.nexstar.codec.site_and_time import WireSite
from drivers.nexstar.fake import FakeNexstar
from drivers.wire.command import Command, Unreadable
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site

AVX = Handset(Version(5, 31), 0x11, 20)
COMMANDS: tuple[Command[Any], ...] = (
    base.GET_PLACE,
    base.GET_PLACE_SHORT,
    base.GET_HORIZON,
    base.SLEWING,
    base.ALIGNED,
    base.PIER_SIDE,
    base.VERSION,
    base.VARIANT,
    base.MODEL,
    base.SYNSCAN_MODEL,
    base.GET_SITE,
    base.GET_TIME,
    base.GET_FINE_TIME,
    base.get_tracking(AVX),
    base.guide_rate(Axis.RA),
    base.guiding(Axis.RA),
    base.echo(b"g"),
    base.slew(1.0, 2.0),
)
NOISE = st.lists(
    st.sampled_from([b"#", b"0", b"A", b",", b"g#", b"h#", b"\x01", b"\x23", b"\xff"]), max_size=12
)


def understood(command: Command[Any], heard: bytes) -> object:
    """What a reader makes of bytes that come one by one; None for nothing yet, or nonsense."""
    for length in range(len(heard) + 1):
        try:
            read = command.read(heard[:length], False)
        except Unreadable:
            return None
        if read is not None:
            assert 0 < read.length <= length
            return read.value
    return None


@given(st.sampled_from(COMMANDS), NOISE)
def test_any_bytes_are_read_in_bounds(command: Command[Any], noise: list[bytes]) -> None:
    understood(command, b"".join(noise))


@given(st.floats(0.0, 360.0, exclude_max=True), st.floats(-90.0, 90.0), st.integers(0, 16), st.integers(0, 7))
def test_a_flipped_place_is_a_legal_place_or_none(ra_deg: float, dec_deg: float, at: int, bit: int) -> None:
    whole = pair_to_text(ra_deg, dec_deg, coarse=True) + b"#"
    flipped = whole[:at] + bytes([whole[at] ^ (1 << bit)]) + whole[at + 1 :]
    try:
        read = base.GET_PLACE.read(flipped, False)
    except Unreadable:
        return
    # what can't be told from a place: another digit; never one beyond the pole
    assert read is None or abs(read.value.second_deg) <= 90.0
    assert read is None or chr(flipped[at]) in "0123456789ABCDEF"


@given(st.integers(-90 * 3600, 90 * 3600), st.integers(-180 * 3600, 180 * 3600), st.integers(0, 8))
def test_a_packed_site_may_hold_the_byte_of_the_end(lat_arcsec: int, lon_arcsec: int, cut: int) -> None:
    site = WireSite(lat_arcsec / 3600.0, lon_arcsec / 3600.0)
    packed = site_and_time.site_to_bytes(site)
    whole = base.GET_SITE.read(packed + b"#", False)
    assert whole is not None
    assert whole.value == site
    # cut anywhere, also behind a 0x23 within: it waits for the rest
    assert base.GET_SITE.read(packed[:cut], False) is None


@pytest.mark.parametrize(
    "packed",
    [
        # 35 degrees, 35 minutes, 35 seconds, each the byte of the end
        bytes([35, 35, 35, 0, 35, 35, 35, 1]),
        bytes([15, 35, 35, 4, 6, 35, 0, 0]),
    ],
)
def test_packed_answers_full_of_ends_are_whole_only_at_their_end(packed: bytes) -> None:
    command: Command[Any] = base.GET_TIME if packed[0] == 15 else base.GET_SITE
    for cut in range(len(packed) + 1):
        assert command.read(packed[:cut], False) is None
    assert command.read(packed + b"#", False) is not None


@given(st.sampled_from(sorted(ECHOES)), st.lists(st.sampled_from([b"#", b"x#", b"y#"]), max_size=6))
def test_an_echo_ends_all_that_was_owed(letter: int, owed: list[bytes]) -> None:
    fresh = bytes([letter])
    before = b"".join(one for one in owed if one[:1] != fresh)
    read = base.echo(fresh).read(before + fresh + b"#", False)
    assert read is not None
    assert read.length == len(before) + 2
    # without it nothing is in step
    assert base.echo(fresh).read(before, False) is None


@given(st.lists(st.binary(max_size=24), max_size=8))
def test_no_bytes_break_the_fake_and_it_answers_again(noise: list[bytes]) -> None:
    fake = FakeNexstar(Mechanics(Site(49.6, 36.9), Air(), PointingErrors()), monotonic=lambda: 0.0)
    for one in noise:
        fake.feed(one)
    # the longest command that may be waiting for its rest swallows so much; then it is in step again
    fake.feed(b"!" * 18)
    answer = fake.feed(b"Kg")
    assert answer.endswith(b"g#")
