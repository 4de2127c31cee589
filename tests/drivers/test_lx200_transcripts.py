"""The fake against recorded dialogues of real INDI drivers, the judges of what driver and fake share."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from drivers.lx200.fake import FakeLx200
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site

# what varies with sky and clock is compared by form: each digit a 9, each sign a +
_DIGIT = re.compile(rb"\d")
# commands of Autostar, which the generic INDI driver also sends, and which a classic doesn't know
_BEYOND_CLASSIC = {b":hP#"}


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
    assert set(fake.unknown) <= _BEYOND_CLASSIC
    assert [command for command, _ in pairs] == fake.heard
