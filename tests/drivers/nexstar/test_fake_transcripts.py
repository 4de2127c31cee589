"""The fake hand control against recorded dialogues of the real INDI driver."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.nexstar.fake import FakeNexstar
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site
from tests.drivers.transcripts import dialogue

_HEX = re.compile(rb"[0-9A-F]")
# what varies with the sky is compared by form, what varies with the clock by length and end
_PLACES, _CLOCK = (b"e",), (b"i", b"h")
# a goto takes as long as the mechanics need, which were not the recorded ones
_BUSY = (b"L",)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["celestron_gps", "celestron_gps.tcp"])
def test_everything_the_real_driver_said_is_understood(shared: Path, name: str) -> None:
    now_s = 0.0
    fake = FakeNexstar(
        Mechanics(Site(49.6, 36.9), Air(), PointingErrors()),
        lowest_altitude_deg=-91.0,
        monotonic=lambda: now_s,
    )
    pairs = dialogue(shared / "protocols" / "transcripts" / f"{name}.jsonl")
    assert len(pairs) > 100
    focuser = [command for _, command, reply in pairs if not reply]
    for t_s, command, recorded in pairs:
        now_s = t_s
        answer = fake.feed(command)
        if command in _PLACES:
            assert _HEX.sub(b"0", answer) == _HEX.sub(b"0", recorded)
        elif command in _CLOCK:
            assert (len(answer), answer[-1:]) == (len(recorded), recorded[-1:])
            assert answer[6:8] == recorded[6:8]
        elif command in _BUSY:
            assert answer in (b"0#", b"1#")
        else:
            assert answer == recorded, command
    # the one message without an answer was to a board that isn't there
    assert fake.unknown == focuser
    assert [command for _, command, _ in pairs] == fake.heard


@pytest.mark.shared
def test_an_order_leaves_the_mechanics_where_the_dialogue_says(shared: Path) -> None:
    fake = FakeNexstar(
        Mechanics(Site(49.6, 36.9), Air(), PointingErrors()), lowest_altitude_deg=-91.0, coarse=False
    )
    pairs = dialogue(shared / "protocols" / "transcripts" / "celestron_gps.jsonl")
    (sync,) = [command for _, command, _ in pairs if command[:1] == b"s"]
    assert fake.feed(sync) == b"#"
    # what was synced to is read back, but for the moment between
    assert fake.feed(b"e")[:6] == sync[1:7]
