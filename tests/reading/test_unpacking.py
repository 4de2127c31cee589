"""gzip and bzip2 in pieces give what the standard library gives of the whole."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.reading import unpacking
from mountnav.reading.unpacking import unpacked

PACKERS = [gzip.compress, bz2.compress]
PLAIN = b"".join(str(number * number).encode() for number in range(3000))


@pytest.fixture(params=[(1 << 20, 1 << 24), (100, 64), (7, 1)])
def _sizes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "_PIECE_BYTES", request.param[0])
    monkeypatch.setattr(unpacking, "_MOST_AT_ONCE", request.param[1])


@pytest.mark.usefixtures("_sizes")
@pytest.mark.parametrize("pack", PACKERS)
def test_one_member_and_several(pack: Callable[[bytes], bytes]) -> None:
    assert unpacked(pack(PLAIN), "x") == PLAIN
    assert unpacked(pack(PLAIN) + pack(b"more"), "x") == PLAIN + b"more"


@pytest.mark.usefixtures("_sizes")
def test_zeros_behind_are_padding() -> None:
    padded = gzip.compress(PLAIN) + bytes(600)
    assert unpacked(padded, "x") == PLAIN == gzip.decompress(padded)


@given(plain=st.binary(min_size=1, max_size=2000))
@pytest.mark.parametrize("pack", PACKERS)
def test_any_content_comes_back(pack: Callable[[bytes], bytes], plain: bytes) -> None:
    assert unpacked(pack(plain), "x") == plain


@pytest.mark.parametrize("pack", PACKERS)
def test_wherever_it_is_cut_it_is_refused(pack: Callable[[bytes], bytes]) -> None:
    packed = pack(PLAIN)
    for length in range(3, len(packed), 97):
        with pytest.raises(BadFrame, match="damaged or cut short"):
            unpacked(packed[:length], "x")


@pytest.mark.parametrize("pack", PACKERS)
def test_a_flipped_byte_is_refused(pack: Callable[[bytes], bytes]) -> None:
    packed = bytearray(pack(PLAIN))
    packed[len(packed) // 2] ^= 0xFF
    with pytest.raises(BadFrame, match="damaged or cut short"):
        unpacked(bytes(packed), "x")


def test_notes_behind_a_member_are_refused_as_the_library_does() -> None:
    with pytest.raises(BadFrame, match="damaged"):
        unpacked(gzip.compress(PLAIN) + b"my notes", "x")


@pytest.mark.parametrize("pack", PACKERS)
def test_an_empty_inside_and_a_bomb_are_refused(
    pack: Callable[[bytes], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(BadFrame, match="empty"):
        unpacked(pack(b""), "x")
    monkeypatch.setattr(unpacking, "MOST_BYTES", 100_000)
    monkeypatch.setattr(unpacking, "_MOST_AT_ONCE", 1000)
    with pytest.raises(BadFrame, match="absurd size"):
        unpacked(pack(bytes(200_000)), "x")


def test_what_is_not_packed_is_not_touched() -> None:
    content = b"SIMPLE  ="
    assert unpacked(content, "x") is content
