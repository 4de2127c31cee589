"""The fake against the recorded dialogue of the real INDI driver, the judge of what driver and fake share."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from drivers.ioptron.codec.values import MountState, pointing_from_text, status_from_text
from drivers.ioptron.fake import FakeIoptron
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from mountnav.sky.sphere import separation_arcsec

_UNDER_WAY = {MountState.SLEWING, MountState.GUIDING}


@pytest.mark.shared
def test_everything_the_real_driver_said_is_answered_as_recorded(shared: Path) -> None:
    lines = (
        (shared / "protocols" / "transcripts" / "ioptronv3.jsonl").read_text(encoding="utf-8").splitlines()
    )
    entries = [json.loads(line) for line in lines]
    # so that the time which the driver sets at 16.6918 s is right, and setting it moves nothing
    start = datetime(2026, 11, 21, 7, 11, 31, 308_200, tzinfo=UTC)
    now_s = 0.0

    def clock() -> datetime:
        return start + timedelta(seconds=now_s)

    place = pointing_from_text(b"+3204000010623251611")
    mechanics = Mechanics(
        Site(49.6, 36.9),
        Air(),
        PointingErrors(),
        slew_rate_deg_s=200.0,
        acceleration_deg_s2=2000.0,
        clock=clock,
        start=Apparent(place.ra_deg, place.dec_deg, start),
    )
    fake = FakeIoptron(mechanics, altitude_limit_deg=-89, clock=clock, monotonic=lambda: now_s)
    # how far a motion has come is the mount's own affair; where an abort ends is, too, and all after it
    asked, answer, places_are_free = b"", b"", False
    exact: dict[bytes, int] = {}
    for entry in entries:
        now_s = entry["t"]
        if entry["dir"] == "driver->mount":
            asked = bytes.fromhex(entry["hex"])
            answer = fake.feed(asked)
            places_are_free = places_are_free or asked == b":Q#"
        if entry["dir"] != "mount->driver":
            continue
        recorded = bytes.fromhex(entry["hex"])
        assert len(answer) == len(recorded), asked
        if asked == b":GLS#":
            under_way = bool({_state(answer), _state(recorded)} & _UNDER_WAY)
        if asked == b":GUT#":
            assert answer[:5] == recorded[:5]
            assert abs(int(answer[5:18]) - int(recorded[5:18])) < 1000
        elif asked == b":GEP#":
            if under_way or places_are_free:
                continue
            assert separation_arcsec(_place(answer), _place(recorded)) < 0.05
        elif asked == b":GLS#":
            if under_way:
                continue
            # the recorded mount parked where it stood, ours at the pole, which is its zero position
            if _state(answer) is MountState.HOME and _state(recorded) is MountState.STOPPED:
                answer = answer[:18] + b"0" + answer[19:]
            # it took rate and time from the driver, and went on telling the old rate and source
            assert _without(answer, 19, 21) == _without(recorded, 19, 21), now_s
        else:
            assert answer == recorded, asked
        exact[asked] = exact.get(asked, 0) + 1
    assert fake.unknown == []
    assert exact[b":GEP#"] > 15
    assert exact[b":GLS#"] > 30
    assert len(exact) > 25


def _without(reply: bytes, *places: int) -> bytes:
    return bytes(byte for place, byte in enumerate(reply) if place not in places)


def _state(reply: bytes) -> MountState:
    return status_from_text(reply[:-1]).state


def _place(reply: bytes) -> Apparent:
    pointing = pointing_from_text(reply[:-1])
    return Apparent(pointing.ra_deg, pointing.dec_deg, datetime(2026, 11, 21, tzinfo=UTC))
