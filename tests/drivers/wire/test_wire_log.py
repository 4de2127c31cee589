"""The ring of messages: numbers that go on, lines of JSON, listeners."""

from __future__ import annotations

import json

from drivers.wire.wire_log import WireEntry, WireLog


def test_old_messages_are_dropped_and_numbers_go_on() -> None:
    log = WireLog(kept=2, monotonic=iter([0.0, 1.0, 2.0, 3.0]).__next__)
    for data in (b":GR#", b":GD#", b":Q#"):
        log.note("driver->mount", data)
    assert log.count == 3
    assert [(entry.number, entry.t_s, entry.data) for entry in log.entries()] == [
        (2, 2.0, b":GD#"),
        (3, 3.0, b":Q#"),
    ]
    assert [entry.number for entry in log.entries(after=2)] == [3]


def test_messages_and_events_as_lines() -> None:
    log = WireLog(monotonic=iter([0.0, 1.23456, 2.0]).__next__)
    log.note("mount->driver", b"\xb0#", "the place")
    log.note("event", meaning="lost")
    header, message, event = (json.loads(line) for line in log.lines({"mount": "east"}))
    assert header == {"t": 0, "dir": "header", "mount": "east"}
    assert message == {
        "t": 1.2346,
        "dir": "mount->driver",
        "bytes": "\xb0#",
        "hex": "b023",
        "meaning": "the place",
        "n": 1,
    }
    assert event == {"t": 2.0, "dir": "event", "meaning": "lost", "n": 2}


def test_listeners_hear_of_each_message() -> None:
    log, heard = WireLog(kept=1), list[WireEntry]()
    log.listen(heard.append)
    log.note("driver->mount", b"1")
    log.note("mount->driver", b"2")
    assert [(entry.number, entry.data) for entry in heard] == [(1, b"1"), (2, b"2")]
