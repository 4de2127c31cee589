"""What a stranger can send over INDI: the same messages however it is cut, and work by its length alone."""

from __future__ import annotations

import asyncio
import gc
import socket
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.indi.client import IndiClient
from drivers.indi.codec import messages
from drivers.indi.codec.messages import Changed, Ordered, Reader
from drivers.indi.codec.xml_stream import (
    MOST_ELEMENTS,
    MOST_PLAIN_BYTES,
    MOST_TAG_BYTES,
    PART_WORK,
    Element,
    ElementStream,
    Malformed,
)
from drivers.wire.wire_log import WireLog

STOP = (
    b"<newSwitchVector device='east' name='TELESCOPE_ABORT_MOTION'>"
    b"<oneSwitch name='ABORT'>On</oneSwitch></newSwitchVector>"
)
ATTACKS = {
    "angles in an open quote": b'<newNumberVector a="' + b">" * 15_500,
    "quotes": b"<newNumberVector a=" + b"'\"" * 8000,
    "blanks": b"<newNumberVector" + b" " * 16_000,
    "blanks after a value": b"<newNumberVector a='1'" + b" " * 15_000 + b"b>",
    "a name without end": b"<" + b"n" * 20_000,
    "attributes": b"<newNumberVector " + b"a='' " * 3000 + b"/>",
    "openings": b"<" * 20_000,
    "almost comments": b"<!-" * 6000,
    "a comment without end": b"<!--" + b"-" * 40_000,
    "a declaration without end": b"<?" + b"?" * 40_000,
    "almost messages": b"<newNumberVecto" * 1500,
    "messages cut by messages": b"<newNumberVector a='b'>" * 800,
    "small elements": b"<a/>" * 5000,
    "small elements in one": b"<newTextVector>" + b"<a/>" * 5000 + b"</newTextVector>",
    "deep": b"<a>" * 6000,
    "ampersands": b"<newTextVector a='" + b"&#65;" * 3000 + b"'/>",
    "endings": b"</a>" * 5000,
    "text": b"<newTextVector>" + b"text" * 5000,
}


def heard(stream: bytes, lengths: Iterator[int]) -> list[Any]:
    reader, events, at = Reader(), [], 0
    while at < len(stream):
        length = next(lengths)
        events += reader.feed(stream[at : at + length])
        at += length
    return events


def every(length: int) -> Iterator[int]:
    while True:
        yield length


@pytest.mark.long
@pytest.mark.parametrize("name", ATTACKS)
def test_attacks_mean_the_same_however_they_are_cut_and_a_stop_behind_them_counts(name: str) -> None:
    stream = ATTACKS[name] + STOP + STOP
    whole = heard(stream, every(len(stream)))
    assert heard(stream, every(1)) == whole
    assert heard(stream, every(997)) == whole
    # a comment or a tag that was left open takes what follows, up to its bound
    assert isinstance(heard(stream + b" " * MOST_TAG_BYTES + b"'/>-->" + STOP * 2, every(4096))[-1], Ordered)


pieces = st.sampled_from(
    [
        *(b"<", b">", b"/", b"'", b'"', b"<!--", b"-->", b"<?", b"?>", b" a='b'", b"&lt;", b"text", STOP),
        *(b"<newTextVector", b"<oneText name='a'>", b"</oneText>", b"</newTextVector>", b"<getProperties/>"),
    ]
)


@pytest.mark.long
@settings(max_examples=200)
@given(st.lists(pieces, max_size=40).map(b"".join), st.lists(st.integers(1, 9), min_size=1, max_size=30))
def test_whatever_is_put_together_means_the_same_however_it_is_cut(stream: bytes, lengths: list[int]) -> None:
    def endless() -> Iterator[int]:
        while True:
            yield from lengths

    assert heard(stream, endless()) == heard(stream, every(len(stream) or 1))


def steps(stream: bytes, length: int) -> tuple[int, int]:
    """What it counts itself, and how often a function of any kind is called."""
    reader, calls = ElementStream(), 0

    def called(*_: object) -> None:
        nonlocal calls
        calls += 1

    sys.setprofile(called)
    try:
        for at in range(0, len(stream), length):
            reader.feed(stream[at : at + length])
    finally:
        sys.setprofile(None)
    return reader.work, calls


@pytest.mark.parametrize("length", [pytest.param(1, marks=pytest.mark.long), 16, 4096])
@pytest.mark.parametrize("name", ATTACKS)
def test_the_work_grows_as_the_bytes_do(name: str, length: int) -> None:
    stream = ATTACKS[name]
    feeds = -(-len(stream) // length)
    work, calls = steps(stream, length)
    assert work < 80 * (len(stream) + feeds)
    assert calls < 60 * (len(stream) / 3 + feeds)
    # what is scanned, without what a step costs however short: some readings of each byte, no more
    half, _ = steps(stream[: len(stream) // 2], length)
    assert work < 2.6 * half + 2.0 * PART_WORK


@pytest.mark.long
@pytest.mark.parametrize("name", ATTACKS)
def test_a_part_is_short_whatever_comes(name: str) -> None:
    reader = ElementStream()
    before = reader.work
    for _ in reader.parts(ATTACKS[name] * 4):
        # the last step of a part may be a whole tag, read and matched
        assert reader.work - before <= PART_WORK + 3 * MOST_TAG_BYTES
        before = reader.work


def test_a_message_is_bounded_and_the_next_one_counts() -> None:
    many = b"<newTextVector device='a' name='b'>%s</newTextVector>"
    for inside in (
        b"<oneText name='c'/>" * (MOST_ELEMENTS + 1),
        b"<oneText name='c'>%s</oneText>" % (b"x" * (MOST_PLAIN_BYTES + 1)),
    ):
        broken, stop = Reader().feed(many % inside + STOP)
        assert isinstance(broken, Malformed)
        assert "too long" in broken.why
        assert isinstance(stop, Ordered)
    (fits,) = Reader().feed(many % (b"<oneText name='c'/>" * (MOST_ELEMENTS - 1)))
    assert isinstance(fits, Ordered)
    assert len(fits.raw) < 20_000
    # files are what is long
    file = (
        b"<setBLOBVector device='a' name='b'><oneBLOB name='c' size='9' format='.f'>%s</oneBLOB>"
        b"</setBLOBVector>"
    )
    (came,) = Reader().feed(file % (b"QUJD" * MOST_PLAIN_BYTES))
    assert isinstance(came, Changed)


def test_a_file_that_comes_in_single_bytes_takes_no_more_room() -> None:
    reader = ElementStream()
    stream = b"<setBLOBVector><oneBLOB>" + b"QUJD" * 30_000 + b"</oneBLOB></setBLOBVector>"
    (element,) = [one for at in range(len(stream)) for one in reader.feed(stream[at : at + 1])]
    assert isinstance(element, Element)
    assert len(element.children[0].pieces) < 5
    assert element.children[0].text == b"QUJD" * 30_000


HUGE = b"9" * 4301
BLOB = (
    b"<%sBLOBVector device='east' name='CCD1'><oneBLOB name='a' format='.f' size='%s'>QQ==</oneBLOB>"
    b"</%sBLOBVector>"
)


@pytest.mark.parametrize("verb", [b"new", b"set"])
@pytest.mark.parametrize("size", [HUGE, b"\xd9\xa3", b"\xc2\xb2", b"1e3", b"-1", b"", b" "])
def test_a_size_that_is_none_takes_nothing_with_it(verb: bytes, size: bytes) -> None:
    events = Reader().feed(STOP + BLOB % (verb, size, verb) + STOP)
    assert [type(one) for one in events] == [Ordered, Malformed, Ordered]
    assert isinstance(events[1], Malformed)
    assert len(events[1].why) < 120


@pytest.mark.parametrize("text", ["9" * 4301, "1" * 500 + ".5", "1:" * 300, "\u0661", "1e400", "0" * 401])
def test_numbers_of_any_length_are_read_or_refused(text: str) -> None:
    number = f"<oneNumber name='a'>{text}</oneNumber>"
    message = f"<newNumberVector device='east' name='A'>{number}</newNumberVector>"
    events = Reader().feed(STOP + message.encode() + STOP)
    assert (type(events[0]), type(events[2])) == (Ordered, Ordered)
    (element,) = ElementStream().feed(message.encode())
    assert isinstance(element, Element)
    assert isinstance(events[1], Malformed) or events[1] == messages.event_of(element)


async def longest_turn_s(work: asyncio.Task[None]) -> float:
    """The longest time the loop was away while something was done, in processor time."""
    longest, then = 0.0, time.thread_time()
    while not work.done():
        await asyncio.sleep(0)
        now = time.thread_time()
        longest, then = max(longest, now - then), now
    await work
    return longest


@pytest.fixture
def no_garbage_sought() -> Iterator[None]:
    """A search through all that the other tests have left takes as long as what is measured here."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.long
@pytest.mark.usefixtures("no_garbage_sought")
@pytest.mark.parametrize("name", ["angles in an open quote", "small elements", "small elements in one"])
async def test_a_server_that_attacks_keeps_the_loop_from_nothing(name: str) -> None:
    """The longest turn is a fraction of what reading it all at once takes."""
    stream = ATTACKS[name] * (500_000 // len(ATTACKS[name]))
    began = time.thread_time()
    ElementStream().feed(stream)
    at_once_s = time.thread_time() - began

    async def attack(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(stream)
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(attack, "127.0.0.1", 0, family=socket.AF_INET)
    async with server:
        client = IndiClient("127.0.0.1", server.sockets[0].getsockname()[1], log=WireLog(kept=10))
        await client.open()

        async def until_lost() -> None:
            await client.lost()

        longest_s = await longest_turn_s(asyncio.create_task(until_lost()))
        await client.close()
    assert longest_s < at_once_s / 4.0
