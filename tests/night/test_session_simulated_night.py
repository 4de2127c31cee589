"""A night alone, in virtual time: fifty minutes with everything in them; longer ones are long tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.journal_story import untold
from benchmarks.simulated_night import SCRIPT, Night, growth_mb, night, world_of
from mountnav.simulation.sky_script import Cloud, Incident, SkyScript

EVENING = SkyScript(
    seed=11,
    satellite_every=10,
    false_share=0.01,
    clouds=(Cloud(21.0, 31.5),),
    incidents=(Incident(16.0, "reboot", 6.0), Incident(70.2, "unplug", 60.0)),
)
SHORT = replace(
    EVENING, clouds=(Cloud(11.0, 16.5),), incidents=(*EVENING.incidents[:1], Incident(40.2, "unplug", 60.0))
)


def told(found: Night) -> list[str]:
    return [f"{one.name}: {one.said}" for one in found.targets if not one.centered]


@pytest.mark.parametrize(
    ("hours", "script", "centered"),
    [(50 / 60, SHORT, 3), pytest.param(1.5, EVENING, 6, marks=pytest.mark.long)],
    ids=["fifty minutes", "an hour and a half"],
)
def test_a_while_of_everything(tmp_path: Path, hours: float, script: SkyScript, centered: int) -> None:
    file = tmp_path / "journal.sqlite"
    found = night(hours, script, file)
    assert found.faults == [], told(found)
    assert sum(target.centered for target in found.targets) >= centered
    # the rules of the story can fail: a mount that got more than was written, targets that nobody ordered
    world = world_of(script)
    assert untold(file, world, found.targets, ["sync"] * 1000) != []
    stranger = found.targets[0]
    stranger.name = "nobody's target"
    assert any("nobody's target" in one for one in untold(file, world, found.targets, []))


@pytest.mark.first
@pytest.mark.long
def test_four_hours(tmp_path: Path) -> None:
    found = night(4.0, SkyScript.from_toml(SCRIPT), tmp_path / "journal.sqlite")
    assert found.faults == [], told(found)
    assert growth_mb(found) < 3.0
    assert found.flips > 0
    assert found.frames > 160
