"""What a fake remembers: the newest, by numbers that count from the beginning."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.wire_fake import Remembered


@given(st.lists(st.binary(max_size=2)), st.integers(0, 30), st.integers(0, 30))
def test_it_is_a_list_while_nothing_is_forgotten(things: list[bytes], first: int, last: int) -> None:
    kept = Remembered(things)
    assert kept == things
    assert len(kept) == len(things)
    assert kept[first:last] == things[first:last]
    assert kept[first:] == things[first:]
    assert kept[-1:] == things[-1:]
    assert kept.count(b"") == things.count(b"")
    assert (b"\x00" in kept) is (b"\x00" in things)
    assert kept != [*things, b""]


@given(st.integers(0, 40), st.integers(1, 10))
def test_what_is_left_keeps_its_number(count: int, most: int) -> None:
    kept = Remembered(range(count), most=most)
    forgotten = max(0, count - most)
    assert len(kept) == count
    assert list(kept) == list(range(forgotten, count))
    for number in range(count):
        if number < forgotten:
            with pytest.raises(IndexError, match="forgotten"):
                kept[number]
            with pytest.raises(IndexError, match="forgotten"):
                kept[number:]
        else:
            assert kept[number] == number
            assert kept[number - count] == number
            assert kept[number:] == list(range(number, count))
    assert kept[count:] == []
    with pytest.raises(IndexError):
        kept[count]


def test_after_clearing_it_counts_anew() -> None:
    kept = Remembered([1, 2, 3], most=2)
    kept.clear()
    kept.append(4)
    assert kept == [4]
    assert repr(kept) == "[4]"


def test_less_may_be_kept_from_now_on_and_numbers_stay() -> None:
    kept = Remembered(range(10))
    kept.keep(3)
    assert (len(kept), list(kept), kept[9]) == (10, [7, 8, 9], 9)
    kept.append(10)
    assert (len(kept), list(kept)) == (11, [8, 9, 10])
    with pytest.raises(IndexError):
        kept[7]
