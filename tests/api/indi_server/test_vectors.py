"""INDI's server side as bytes: what is written is read back, what is heard doesn't depend on cuts."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from api.indi_server.parser import Asked, Broken, Hearing, Nonsense
from api.indi_server.vectors import (
    Vector,
    definition,
    deletion,
    number,
    saying,
    setting,
    speakable,
    switches,
)
from drivers.indi.codec import messages
from drivers.indi.codec.messages import Changed, Defined, Deleted, Ordered, Reader, Said, State

UTC_NOW = datetime(2026, 11, 22, 21, 30, 5, tzinfo=UTC)
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1, max_size=20).map(
    lambda text: f"x{text}"
)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e9, max_value=1e9)


def numbers(values: dict[str, float], state: State) -> Vector:
    members = tuple(number(name, name, value) for name, value in values.items())
    return Vector("PLACE", "A <place> & more", "Main", "Number", "rw", state, members)


@pytest.mark.long
@settings(deadline=None)
@given(NAMES, st.dictionaries(NAMES, NUMBERS, min_size=1, max_size=4), st.sampled_from(State), st.text())
def test_what_is_written_is_read_as_it_was(
    device: str, values: dict[str, float], state: State, words: str
) -> None:
    vector = numbers(values, state)
    wire = definition(device, vector, UTC_NOW) + setting(device, vector, UTC_NOW, words)
    defined, changed = Reader().feed(wire)
    assert isinstance(defined, Defined)
    assert isinstance(changed, Changed)
    assert (defined.device, defined.name, defined.state, defined.perm) == (device, "PLACE", state, "rw")
    assert defined.label == "A <place> & more"
    for told in (defined.values, changed.values):
        assert told.keys() == values.keys()
        for name, value in values.items():
            assert told[name] == pytest.approx(value, abs=1e-9, rel=1e-12)
    assert changed.message == speakable(words)
    # an XML library of somebody else's reads each message as well
    ElementTree.fromstring(f"<indi>{wire.decode()}</indi>")


def test_switches_texts_deletions_and_words() -> None:
    one = Vector("PARK", "Park", "Main", "Switch", "rw", State.OK, switches("A", A="a", B="b"), "AtMostOne")
    defined, deleted, said = Reader().feed(
        definition("east", one, UTC_NOW)
        + deletion("east", "PARK", UTC_NOW)
        + saying("east", "5° <up>", UTC_NOW)
    )
    assert isinstance(defined, Defined)
    assert (defined.rule, defined.values) == ("AtMostOne", {"A": True, "B": False})
    assert isinstance(deleted, Deleted)
    assert isinstance(said, Said)
    assert said.message == "5° <up>"
    assert b'timestamp="2026-11-22T21:30:05"' in deletion("east", "PARK", UTC_NOW)


@settings(deadline=None)
@given(st.text(max_size=1000))
def test_words_fit_old_clients(words: str) -> None:
    kept = speakable(words)
    assert len(kept.encode()) <= 240
    assert "\n" not in kept


@settings(deadline=None)
@given(st.lists(st.integers(1, 40), max_size=60))
def test_what_is_heard_does_not_depend_on_the_cuts(cuts: list[int]) -> None:
    wire = (
        b"<?xml version='1.0'?>\n"
        + messages.get_properties()
        + messages.get_properties("east", "PARK")
        + messages.enable_blob("east", "Never")
        + messages.new_numbers("east", "EQUATORIAL_EOD_COORD", {"RA": 1.5, "DEC": -0.5})
        + messages.new_switches("east", "ON_COORD_SET", {"SYNC": True})
        + b'<newNumberVector device="east" name="N"><oneNumber name="RA">much</oneNumber></newNumberVector>'
        + b'<setNumberVector device="other" name="N"><oneNumber name="RA">1</oneNumber></setNumberVector>'
    )
    whole = Hearing().feed(wire)
    assert [type(one) for one in whole] == [Asked, Asked, Ordered, Ordered, Nonsense]
    assert whole[1] == Asked("east", "PARK", by_a_server=True)
    pieces, at, hearing = [], 0, Hearing()
    for cut in [*cuts, len(wire)]:
        pieces += hearing.feed(wire[at : at + cut])
        at += cut
    assert pieces == whole


@pytest.mark.parametrize(
    "junk",
    [
        b"GET / HTTP/1.1\r\nHost: east\r\n\r\n<html>",
        b"<newNumberVector device='east'<",
        b"</getProperties>",
        b'<newTextVector device="east" name="T"><oneText name="a">' + b"x" * 70_000,
    ],
)
def test_what_is_no_indi_is_broken(junk: bytes) -> None:
    heard = Hearing().feed(junk)
    assert [type(one) for one in heard] == [Broken]


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_no_bytes_do_harm(junk: bytes) -> None:
    for one in Hearing().feed(junk):
        assert isinstance(one, Asked | Ordered | Nonsense | Broken) or one


def test_a_number_that_is_none_stays_one_to_the_reader() -> None:
    """The codec lets ``nan`` through, since drivers say so: whoever orders with it is refused later."""
    wire = b'<newNumberVector device="e" name="N"><oneNumber name="RA">nan</oneNumber></newNumberVector>'
    (heard,) = Hearing().feed(wire)
    assert isinstance(heard, Ordered)
    value = heard.values["RA"]
    assert isinstance(value, float)
    assert math.isnan(value)
