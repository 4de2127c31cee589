"""Nights served through a serial line, INDI and Alpaca are played again: each decision as it was."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from api.cli.replay import shown
from api.replay.replaying import play
from mountnav.night.recording import read_recording
from tests.api.nights.recorded_nights import ServedNight, Way, served_night

pytestmark = pytest.mark.long


async def a_night(site: ServedNight) -> None:
    """What befalls a night: corrections, a tube that slips, a slew under an exposure, people, rain."""
    await site.said("start", why="a test")
    for _ in range(5):
        await site.written()
    # it slips: the first frame is doubted, the second one is alone
    site.knock(60.0)
    for _ in range(3):
        await site.written()
    # somebody slews while a frame is exposed, and again before the next
    slewing = asyncio.create_task(site.slewed(0.01))
    await site.written()
    await slewing
    await site.said("pause", why="a visitor")
    await site.written()
    await site.said("resume")
    busy = {"busy": True, "for_s": 600}
    assert (await site.client.post("/v1/telescopes/east/night/busy", json=busy)).status_code == 200
    await site.uploaded()
    rain = {"safe": False, "why": "rain"}
    assert (await site.client.post("/v1/telescopes/east/night/safety", json=rain)).status_code == 200
    await site.uploaded(hold=True)
    await site.said("stop", why="enough")


@pytest.mark.parametrize(
    ("way", "speed"),
    [("serial", None), ("serial", 20.0), ("indi", None), ("indiserver", None), ("alpaca", 10.0)],
)
async def test_a_served_night_is_decided_as_it_was(tmp_path: Path, way: Way, speed: float | None) -> None:
    async with served_night(tmp_path, way, speed=speed) as site:
        await a_night(site)
        path = await site.closed()
    recording = read_recording(path)
    for solve, wire in ((True, True), (False, False)):
        played = await asyncio.to_thread(play, recording, solve=solve, wire=wire)
        report = played.report
        assert report.same, shown(played, every=False)
        assert report.not_judged == 0
        assert report.frames == 12
        told = [row.recorded for row in report.rows]
        assert len(told) == 18
        assert sum("; done" in one for one in told) >= 2
        # ten lie in files; what was sent leaves none, and what follows it was followed from it
        assert report.solved_anew == (10 if solve else 0)
        if way == "serial" and wire:
            assert played.wire is not None
            assert played.wire.alike > 0.9 * played.wire.readings > 0
