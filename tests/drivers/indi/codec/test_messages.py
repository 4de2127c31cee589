"""INDI's stream, cut anywhere, broken anywhere: the same events, and nothing that was not said."""

from __future__ import annotations

import base64
import time
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.indi.codec import exposure, messages
from drivers.indi.codec.messages import (
    Blob,
    Changed,
    Defined,
    Deleted,
    Other,
    PingAnswered,
    Pinged,
    Reader,
    Said,
    State,
)
from drivers.indi.codec.xml_stream import Element, ElementStream, Malformed

# as indi_simulator_telescope and indi_simulator_ccd 1.9.9 sent them
DEFINED = b"""<defSwitchVector device="CCD Simulator" name="CONNECTION" label="Connection" \
group="Main Control" state="Idle" perm="rw" rule="OneOfMany" timeout="60" timestamp="2026-11-22T02:15:58">
    <defSwitch name="CONNECT" label="Connect">
Off
    </defSwitch>
    <defSwitch name="DISCONNECT" label="Disconnect">
On
    </defSwitch>
</defSwitchVector>
"""
CHANGED = b"""<setNumberVector device="Telescope Simulator" name="EQUATORIAL_EOD_COORD" state="Busy" \
timeout="60" timestamp="2026-11-22T02:39:45">
    <oneNumber name="RA">
2.7219084432949878227
    </oneNumber>
    <oneNumber name="DEC">
82.487165999999987775
    </oneNumber>
</setNumberVector>
"""
SAID = (
    b'<message device="Telescope Simulator" timestamp="2026-11-22T02:39:49" '
    b'message="[INFO] Telescope slew is complete. Tracking..."/>\n'
)
DELETED = b'<delProperty device="Telescope Simulator" timestamp="2026-11-22T02:39:49" name="TIME_UTC"/>\n'
FILE = b"""<setBLOBVector device="CCD Simulator" name="CCD1" state="Ok" timeout="60">
    <oneBLOB name="CCD1" size="5" enclen="8" len="5" format=".fits">
c3RhcnM=
    </oneBLOB>
</setBLOBVector>
"""
EMPTY = (
    b'<defBLOBVector device="CCD Simulator" name="CCD1" state="Idle" perm="ro">'
    b'<defBLOB name="CCD1"/></defBLOBVector>'
)
STREAM = b"<?xml version='1.0'?>\n" + DEFINED + CHANGED + b"<!-- <a> -- -->" + SAID + DELETED + FILE + EMPTY


def heard(stream: bytes, cuts: list[int]) -> list[Any]:
    reader, events, at = Reader(), [], 0
    for cut in [*sorted(cuts), len(stream)]:
        events += reader.feed(stream[at:cut])
        at = max(at, cut)
    return events


def test_what_the_real_simulators_say_is_understood() -> None:
    defined, changed, said, deleted, file, empty = Reader().feed(STREAM)
    assert isinstance(defined, Defined)
    assert (defined.device, defined.name, defined.kind) == ("CCD Simulator", "CONNECTION", "Switch")
    assert (defined.state, defined.perm, defined.rule) == (State.IDLE, "rw", "OneOfMany")
    assert defined.values == {"CONNECT": False, "DISCONNECT": True}
    assert isinstance(changed, Changed)
    assert changed.state is State.BUSY
    assert changed.values == {"RA": 2.7219084432949878227, "DEC": 82.487165999999987775}
    assert isinstance(said, Said)
    assert said.message == "[INFO] Telescope slew is complete. Tracking..."
    assert isinstance(deleted, Deleted)
    assert (deleted.device, deleted.name) == ("Telescope Simulator", "TIME_UTC")
    assert isinstance(file, Changed)
    blob = file.values["CCD1"]
    assert isinstance(blob, Blob)
    assert exposure.content(blob) == b"stars"
    assert isinstance(empty, Defined)
    assert changed.raw == CHANGED.strip()


@pytest.mark.long
@given(st.lists(st.integers(0, len(STREAM)), max_size=40))
def test_it_does_not_matter_where_the_stream_is_cut(cuts: list[int]) -> None:
    assert heard(STREAM, cuts) == heard(STREAM, [])


def test_each_byte_alone_says_the_same() -> None:
    assert heard(STREAM, list(range(len(STREAM)))) == heard(STREAM, [])


@pytest.mark.parametrize("lost", range(1, len(CHANGED), 3))
def test_a_message_that_was_cut_is_told_and_the_next_one_stands(lost: int) -> None:
    events = Reader().feed(CHANGED[:-lost] + SAID + DELETED)
    assert events[-1] == Reader().feed(DELETED)[0]
    whole = CHANGED[:-lost].rstrip().endswith(b"</setNumberVector>")
    assert [type(one) for one in events[:-1]] == ([Changed, Said] if whole else [Malformed, Said])


def damaged() -> st.SearchStrategy[bytes]:
    def broken(damage: tuple[int, int, bytes]) -> bytes:
        start, length, instead = damage
        return STREAM[:start] + instead + STREAM[start + length :]

    junk = st.one_of(
        st.binary(max_size=20), st.sampled_from([b"<", b">", b"'", b'"', b"<!--", b"<?", b"&", b"</"])
    )
    return st.tuples(st.integers(0, len(STREAM)), st.integers(0, 30), junk).map(broken)


@given(damaged(), st.lists(st.integers(0, len(STREAM)), max_size=8))
def test_broken_streams_mean_the_same_however_they_are_cut(stream: bytes, cuts: list[int]) -> None:
    assert heard(stream, [min(cut, len(stream)) for cut in cuts]) == heard(stream, [])


@given(damaged())
def test_after_something_broken_the_next_messages_stand(stream: bytes) -> None:
    # a comment that was opened by the damage ends here
    events = heard(stream + b"--> ?>" + SAID + SAID + CHANGED, [])
    assert events[-1] == Reader().feed(CHANGED)[0]


@given(st.binary(max_size=400))
def test_junk_raises_nothing(junk: bytes) -> None:
    for event in Reader().feed(junk):
        assert isinstance(event, Malformed | Other)


names = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1, max_size=12)
texts = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=30)


@pytest.mark.long
@given(st.dictionaries(names, texts, min_size=1, max_size=4), names, names, st.booleans())
def test_a_real_xml_reader_reads_the_same(
    values: dict[str, str], device: str, message: str, declared: bool
) -> None:
    inside = "".join(
        f"<oneText name={quoteattr(key)}>{escape(text)}</oneText>" for key, text in values.items()
    )
    start = f"<setTextVector device={quoteattr(device)} name='A' message={quoteattr(message)}>"
    xml = f"{start}{inside}</setTextVector>"
    (event,) = Reader().feed(("<?xml version='1.0'?>" * declared + xml).encode())
    oracle = ElementTree.fromstring(xml)
    assert isinstance(event, Changed)
    assert event.device == oracle.get("device")
    assert event.message == oracle.get("message")
    assert event.values == {one.get("name"): (one.text or "").strip() for one in oracle}


@given(
    st.dictionaries(
        names,
        st.floats(-1e9, 1e9, allow_nan=False).map(lambda value: round(value, 9)),
        min_size=1,
        max_size=4,
    ),
    names,
)
def test_orders_come_back_as_they_were_given(numbers: dict[str, float], device: str) -> None:
    (element,) = ElementStream().feed(messages.new_numbers(device, "A", numbers))
    assert isinstance(element, Element)
    assert element.attributes["device"] == device
    told = {child.attributes["name"]: float(child.text) for child in element.children}
    assert told == pytest.approx(numbers, abs=1e-9, rel=1e-12)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_no_order_holds_what_is_no_number(value: float) -> None:
    with pytest.raises(ValueError, match="EQUATORIAL"):
        messages.new_numbers("A", "EQUATORIAL_EOD_COORD", {"RA": value})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("8:01:26.04", 8 + 1 / 60 + 26.04 / 3600),
        ("-0:30", -0.5),
        ("-10:07:48", -10.13),
        ("8 1 26", 8 + 1 / 60 + 26 / 3600),
        ("12.5", 12.5),
        ("1e3", 1000.0),
        ("-90", -90.0),
    ],
)
def test_numbers_are_read_in_all_their_forms(text: str, value: float) -> None:
    assert messages.number(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "abc", "1:60:0", "1:2:3:4", "1_000", "0x10", "8:01:26.04x", "--1"])
def test_what_is_no_number_is_none(text: str) -> None:
    message = CHANGED.replace(b"2.7219084432949878227", text.encode())
    (event,) = Reader().feed(message)
    assert isinstance(event, Malformed)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b'state="Busy"', b'state="busy"'),
        (b'device="Telescope Simulator"', b""),
        (b'name="RA"', b""),
        (b"oneNumber", b"oneText"),
    ],
)
def test_whole_messages_that_mean_nothing_are_told(before: bytes, after: bytes) -> None:
    (event,) = Reader().feed(CHANGED.replace(before, after))
    assert isinstance(event, Malformed)


def test_entities_beyond_those_of_xml_are_not_there() -> None:
    bomb = b'<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;">]>'
    events = Reader().feed(bomb + SAID.replace(b"[INFO]", b"&b;&#65;&#0;&amp;"))
    assert isinstance(events[0], Malformed)
    assert isinstance(events[-1], Said)
    assert events[-1].message.startswith("&b;A&#0;& Telescope")


def test_a_degree_sign_in_one_byte_is_no_end_of_the_world() -> None:
    (event,) = Reader().feed(SAID.replace(b"complete", b"at 5\xb0"))
    assert isinstance(event, Said)
    assert "at 5°" in event.message


def test_pings_are_understood() -> None:
    asked, answered = Reader().feed(messages.ping_request("a&b") + messages.ping_reply("a&b"))
    assert isinstance(asked, Pinged)
    assert isinstance(answered, PingAnswered)
    assert asked.uid == answered.uid == "a&b"


def test_a_message_longer_than_allowed_is_passed_over() -> None:
    reader = Reader(most_bytes=1000)
    events = reader.feed(FILE.replace(b"c3RhcnM=", b"A" * 5000) + SAID)
    assert [type(one) for one in events] == [Malformed, Said]


def test_a_large_file_costs_time_by_its_length() -> None:
    def spent_s(size: int) -> float:
        encoded = base64.b64encode(bytes(size))
        message = FILE.replace(b"c3RhcnM=", encoded)
        reader, began = Reader(), time.process_time()
        events = [
            one for at in range(0, len(message), 65536) for one in reader.feed(message[at : at + 65536])
        ]
        spent = time.process_time() - began
        (event,) = events
        assert isinstance(event, Changed)
        assert len(event.raw) < 1000
        blob = event.values["CCD1"]
        assert isinstance(blob, Blob)
        assert len(b"".join(blob.encoded).strip()) == len(encoded)
        return spent

    spent_s(1 << 20)
    # eight times the length: a square law would cost 64 times the time
    assert spent_s(1 << 25) < 32.0 * max(spent_s(1 << 22), 0.005)


def pieces_of(encoded: bytes) -> tuple[bytes, ...]:
    return tuple(encoded[at : at + 1001] for at in range(0, len(encoded), 1001))


PLAIN = b"SIMPLE  = " + bytes(5000)


@pytest.mark.parametrize(
    ("form", "packed", "size", "length"),
    [
        (".fits", PLAIN, len(PLAIN), None),
        (".fits", PLAIN, len(PLAIN), len(PLAIN)),
        (".fits.z", zlib.compress(PLAIN), len(PLAIN), None),
        # the driver's buffer is longer than the file in it
        (".fits.fz", PLAIN + bytes(3000), 99999, len(PLAIN)),
    ],
)
def test_files_are_unwrapped(form: str, packed: bytes, size: int, length: int | None) -> None:
    blob = Blob(form, size, length, (b"\n", *pieces_of(base64.encodebytes(packed))))
    assert exposure.content(blob) == PLAIN


@pytest.mark.parametrize(
    ("form", "packed", "size", "length"),
    [
        (".fits", PLAIN[:-1], len(PLAIN), None),
        (".fits", b"", 0, None),
        (".fits", PLAIN, len(PLAIN), len(PLAIN) + 1),
        (".fits.z", zlib.compress(PLAIN)[:-3], len(PLAIN), None),
        (".fits.z", zlib.compress(PLAIN), len(PLAIN) - 1, None),
        (".fits.z", zlib.compress(PLAIN), len(PLAIN) + 1, None),
        (".fits.z", PLAIN, len(PLAIN), None),
        (".fits.z", zlib.compress(bytes(10**6)), 10**12, None),
    ],
)
def test_files_that_are_not_what_they_say_are_refused(
    form: str, packed: bytes, size: int, length: int | None
) -> None:
    with pytest.raises(exposure.BrokenBlob):
        exposure.content(Blob(form, size, length, pieces_of(base64.b64encode(packed))))


def test_codec_files_touch_no_wire_and_no_clock() -> None:
    room = Path(messages.__file__).parent
    for path in sorted(room.glob("*.py")):
        text = path.read_text()
        assert not any(f"import {module}" in text for module in ("socket", "asyncio", "time\n", "serial"))
