"""A night alone, in virtual time: an hour and a half with everything in it; the whole one is a long test."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.journal_story import untold
from benchmarks.simulated_night import SCRIPT, Night, growth_mb, night, world_of
from mountnav.simulation.sky_script import Cloud, Incident, SkyScript

SHORT = SkyScript(
    seed=11,
    satellite_every=10,
    false_share=0.01,
    clouds=(Cloud(21.0, 31.5),),
    incidents=(Incident(16.0, "reboot", 6.0), Incident(70.2, "unplug", 60.0)),
)


def told(found: Night) -> list[str]:
    return [f"{one.name}: {one.said}" for one in found.targets if not one.centered]


def test_an_hour_and_a_half_of_everything(tmp_path: Path) -> None:
    file = tmp_path / "journal.sqlite"
    found = night(1.5, SHORT, file)
    assert found.faults == [], told(found)
    assert sum(target.centered for target in found.targets) >= 6
    # the rules of the story can fail: a mount that got more than was written, targets that nobody ordered
    world = world_of(SHORT)
    assert untold(file, world, found.targets, ["sync"] * 1000) != []
    stranger = found.targets[0]
    stranger.name = "nobody's target"
    assert any("nobody's target" in one for one in untold(file, world, found.targets, []))


@pytest.mark.first
@pytest.mark.long
def test_ten_hours(tmp_path: Path) -> None:
    found = night(10.0, SkyScript.from_toml(SCRIPT), tmp_path / "journal.sqlite")
    assert found.faults == [], told(found)
    assert growth_mb(found) < 3.0
    assert found.flips > 0
    assert found.frames > 400
