"""Fakes and words against recorded dialogues of real INDI drivers, the judges of what both share."""

from __future__ import annotations

import json
import re
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import pytest

from drivers.lx200.codec import base, site_and_time
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialects import make_fake
from drivers.wire.command import Command
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site

# what varies with sky and clock is compared by form: each digit a 9, each sign a +
_DIGIT = re.compile(rb"\d")


def form(reply: bytes) -> bytes:
    return _DIGIT.sub(b"9", reply).replace(b"-", b"+")


def dialogue(path: Path) -> list[tuple[bytes, bytes]]:
    """Each command with all that was answered to it."""
    pairs: list[tuple[bytes, bytes]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if entry["dir"] == "driver->mount":
            pairs.append((bytes.fromhex(entry["hex"]), b""))
        elif entry["dir"] == "mount->driver":
            command, reply = pairs[-1]
            pairs[-1] = (command, reply + bytes.fromhex(entry["hex"]))
    return pairs


@pytest.mark.shared
@pytest.mark.parametrize("name", ["lx200classic", "lx200basic", "lx200generic"])
def test_everything_a_real_driver_said_is_understood(shared: Path, name: str) -> None:
    fake = FakeLx200(Mechanics(Site(49.6, 36.9), Air(), PointingErrors()), lowest_altitude_deg=-91.0)
    pairs = dialogue(shared / "protocols" / "transcripts" / f"{name}.jsonl")
    assert len(pairs) > 30
    for command, recorded in pairs:
        answer = fake.feed(command)
        if command == b":D#":
            assert answer in (b"#", b"\x7f#")
        else:
            assert form(answer) == form(recorded), command
    assert fake.unknown == []
    assert [command for command, _ in pairs] == fake.heard


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "dialect"), [("lx200classic", "classic"), ("lx200basic", "basic"), ("lx200generic", "lx200gps")]
)
def test_the_dialects_own_fakes_know_it_too(shared: Path, name: str, dialect: str) -> None:
    fake = make_fake(dialect, Mechanics(Site(49.6, 36.9), Air(), PointingErrors()))
    for command, recorded in dialogue(shared / "protocols" / "transcripts" / f"{name}.jsonl"):
        answer = fake.feed(command)
        # a place below the horizon is refused, bars and sync texts are each model's own
        if command[1:3] not in (b"MS", b"D#", b"CM"):
            assert form(answer) == form(recorded), command
    assert fake.unknown == []


def our_command(sent: bytes) -> Command[Any] | None:
    """Our own command of the same beginning."""
    ours: list[tuple[bytes, Command[Any]]] = [
        (b"\x06", base.ALIGNMENT),
        (b":GR#", base.GET_RA),
        (b":GD#", base.GET_DEC),
        (b":D#", base.SLEWING),
        (b":MS#", base.SLEW),
        (b":CM#", base.SYNC),
        (b":Sr", base.set_ra(0.0)),
        (b":Sd", base.set_dec(0.0)),
        (b":GL#", site_and_time.GET_TIME),
        (b":GC#", site_and_time.GET_DATE),
        (b":GG#", site_and_time.GET_OFFSET),
        (b":Gt#", site_and_time.GET_LATITUDE),
        (b":Gg#", site_and_time.GET_LONGITUDE),
        (b":SC", site_and_time.set_date(date(2026, 11, 21))),
        *((order.sent[:3], order) for order in site_and_time.Writing().site(Site(0.0, 0.0))),
        *((order.sent[:3], order) for order in site_and_time.Writing().clock(datetime.now(UTC))[:2]),
    ]
    return next((command for beginning, command in ours if sent.startswith(beginning)), None)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["lx200classic", "lx200basic", "lx200generic"])
def test_every_recorded_answer_is_understood(shared: Path, name: str) -> None:
    understood = set()
    for sent, recorded in dialogue(shared / "protocols" / "transcripts" / f"{name}.jsonl"):
        command = our_command(sent)
        if command is None or not recorded:
            continue
        read = command.read(recorded, False)
        assert read is not None, sent
        assert read.length == len(recorded)
        understood.add(command.meaning)
    assert {"right ascension", "declination", "slew to target", "sync to target"} <= understood


@pytest.mark.shared
def test_a_rainbow_is_none_of_our_dialects(shared: Path) -> None:
    """Its driver begins with `:AV#`, which no LX200 knows: silence, as was recorded."""
    pairs = dialogue(shared / "protocols" / "transcripts" / "rainbow.jsonl")
    assert pairs == [(b":AV#", b"")]
    fake = FakeLx200(Mechanics(Site(49.6, 36.9), Air(), PointingErrors()))
    assert fake.feed(b":AV#") == b""
    assert fake.unknown == [b":AV#"]
