"""The fake motor controller against the dialogue that the real INDI driver had with a recording one."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from drivers.skywatcher import codec
from drivers.skywatcher.axes import Gearing
from drivers.skywatcher.codec import Axis, Board
from drivers.skywatcher.fake import FakeBoard, FakeSkywatcher
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from tests.drivers.skywatcher.quick_fakes import german
from tests.drivers.transcripts import dialogue

_START = datetime(2026, 11, 21, 7, 11, 30, tzinfo=UTC)
# what it told of itself there
_GEAR = Gearing(9_024_000, 1_500_000, 16)
_BOARD = FakeBoard(
    Board(2, 4, 0), dict.fromkeys(Axis, _GEAR), "000000", goto_deg_s=40.0, acceleration_deg_s2=200.0
)


@pytest.mark.shared
def test_everything_the_real_driver_said_is_understood(shared: Path) -> None:
    now_s = 0.0
    mechanics = german(slew_rate_deg_s=40.0, clock=lambda: _START + timedelta(seconds=now_s))
    fake = FakeSkywatcher(mechanics, board=_BOARD, monotonic=lambda: now_s)
    pairs = dialogue(shared / "protocols" / "transcripts" / "eqmod.jsonl")
    assert len(pairs) > 250
    places = 0
    for t_s, command, recorded in pairs:
        now_s = t_s
        answer = fake.feed(command)
        if command[1:2] == b"j":
            # it stood still until the first order to move: byte for byte; then by form
            places += 1
            assert len(answer) == len(recorded)
            if t_s < 18.0:
                assert answer == recorded
        elif command[1:2] == b"f":
            # motion depends on how fast gotos are: the flag of a power-up and the form must agree
            assert len(answer) == len(recorded)
            assert answer[3:] == recorded[3:]
        elif recorded[:1] == b"=":
            assert answer == recorded, command
    assert places > 50
    assert fake.unknown == []
    assert fake.heard == [command for _, command, _ in pairs]


@pytest.mark.shared
def test_our_words_are_the_real_drivers(shared: Path) -> None:
    said = {command for _, command, _ in dialogue(shared / "protocols" / "transcripts" / "eqmod.jsonl")}
    ours = [
        codec.board(),
        *(make(axis) for make in (codec.counts_per_turn, codec.timer_hz, codec.fast_ratio) for axis in Axis),
        *(make(axis) for make in (codec.status, codec.position, codec.energize) for axis in Axis),
        *(make(axis) for make in (codec.start, codec.slow_down) for axis in Axis),
        codec.features(Axis.HOUR_ANGLE),
        # it puts the pole a quarter of a turn on, and tracks
        codec.set_position(Axis.DECLINATION, 0x800000 + _GEAR.counts // 4),
        codec.motion(Axis.HOUR_ANGLE, goto=False, fast=False, backward=False),
        codec.motion(Axis.HOUR_ANGLE, goto=True, fast=True, backward=True),
        codec.motion(Axis.DECLINATION, goto=True, fast=True, backward=False),
        codec.period(Axis.HOUR_ANGLE, _GEAR.period(SIDEREAL_DEG_S)),
        codec.goto_by(Axis.HOUR_ANGLE, 1_880_059),
        codec.brake_by(Axis.HOUR_ANGLE, 3200),
    ]
    assert {command.sent for command in ours} <= said
