"""A night over real HTTP: frames uploaded, sent by path, dropped into a folder; a fake mount on a pty."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from api.nights.safety_file import unsafe_by_file
from api.replay.replaying import play
from mountnav.clock import in_virtual_time
from mountnav.night.recording import read_recording
from mountnav.simulation.sky_clock import FastClock
from tests.api.nights.night_site import EVENING, NightSite, night_toml, served


@pytest.fixture(autouse=True)
def _evening() -> Iterator[None]:
    """The same evening in each run, a second in a second."""
    with in_virtual_time(FastClock(1.0, EVENING)):
        yield


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[NightSite]:
    folder, record, safety = tmp_path / "frames", tmp_path / "recordings", tmp_path / "safety.txt"
    (folder / "elsewhere").mkdir(parents=True)
    (folder / "old.fits").write_bytes(b"from before")
    safety.write_text("safe")
    async with served(night_toml(folder, record, safety), folder, record, safety) as opened:
        yield opened


async def sent(site: NightSite, **params: str | float) -> dict[str, Any]:
    answer = await site.client.post(
        "/v1/telescopes/east/frames",
        params={"wait": 60, **params},
        files={"file": ("m31.fits", await site.exposed())},
    )
    assert answer.status_code == 200, answer.text
    told: dict[str, Any] = answer.json()
    return told


@pytest.mark.long
async def test_a_night_of_uploads_syncs_once_and_replays_the_same(site: NightSite) -> None:
    assert (await site.said("start", why="a test by day"))["phase"] == "calibrating"
    answers = [await sent(site) for _ in range(5)]
    assert [one["decision"]["why"] for one in answers] == [
        *["the first frames are still compared"] * 3, "one frame alone", "off, and frames agree"
    ]  # fmt: skip
    assert all(one["fully"] for one in answers[:3])
    assert answers[4]["correction"].startswith("correction done"), answers[4]
    assert answers[3]["offset"]["total_arcsec"] == pytest.approx(160.0, abs=60.0)
    # from now on by shift; the mount believes what the frames show (LX200: 15″ steps)
    # no scheduler exposes within the same milliseconds
    await asyncio.sleep(0.5)
    after = await sent(site)
    assert after["decision"]["why"] in ("not off enough", "begun before the last correction had settled")
    assert after["offset"]["total_arcsec"] < 25.0
    night = await site.night()
    assert (night["frames"], night["placed"], night["corrections"]) == (6, 6, 1)
    assert night["calibration"]["scale_arcsec_px"] == pytest.approx(10.0, rel=0.005)
    assert night["drift"]["field"] == answers[0]["field"]
    # the same file once more
    content = await site.exposed()
    first = await site.client.post("/v1/telescopes/east/frames", content=content)
    assert first.status_code == 202
    assert first.headers["location"] == f"/v1/telescopes/east/frames/{first.json()['frame_id']}"
    again = await site.client.post("/v1/telescopes/east/frames", params={"wait": 60}, content=content)
    assert (again.status_code, again.json()["duplicate"]) == (200, True)
    one = await site.client.get(first.headers["location"], params={"wait": 60})
    assert one.json()["done"]
    listed = (await site.client.get("/v1/telescopes/east/frames")).json()
    assert listed[0]["frame_id"] == first.json()["frame_id"]
    # what was recorded decides the same once more: with the recorded wire under the real driver
    site.app.state.service.nights.of("east").parts.recording.close()
    (path,) = site.record.glob("*.jsonl")
    played = await asyncio.to_thread(play, read_recording(path), solve=True)
    others = [(row.recorded, row.replayed) for row in played.report.rows if not row.same]
    assert played.report.same, others
    assert played.report.frames == 7
    assert played.report.not_judged == 0
    assert played.wire is not None
    assert not played.wire.problem
    assert played.wire.unanswered == 0
    # uploads leave no file: their recorded solutions were taken
    assert len(played.report.missing) == 7


@pytest.mark.long
async def test_a_folder_and_paths_and_headers(site: NightSite) -> None:
    """Frames that lie in the folder come by themselves; by their path only from allowed folders."""
    frames = "/v1/telescopes/east/frames"
    # no night runs: taken in, not looked at
    (site.folder / "early.fits").write_bytes(b"no image, and no night")
    while not (listed := (await site.client.get(frames)).json()) or not listed[0]["done"]:
        await asyncio.sleep(0.05)
    assert listed[0]["decision"]["why"] == "no night is running"
    assert [Path(one["source"]).name for one in listed] == ["early.fits"]
    await site.said("start")
    path = site.folder / "elsewhere" / "frame1.fits"
    path.write_bytes(await site.exposed())
    answer = await site.client.post(frames, params={"wait": 60}, json={"path": str(path)})
    assert answer.status_code == 200, answer.text
    assert answer.json()["placed"]
    # the same file is found in the folder as well, and known
    night = await site.night()
    assert night["placed"] == 1
    secret = site.folder.parent / "secret.fits"
    secret.write_bytes(b"not for you")
    (site.folder / "link.fits").symlink_to(secret)
    for wrong in (secret, site.folder / "link.fits", site.folder / ".." / "secret.fits", Path("/etc/passwd")):
        refused = await site.client.post(frames, json={"path": str(wrong)})
        assert refused.status_code == 422, wrong
        assert "not in a folder that frames may be taken from" in refused.json()["detail"]
    missing = await site.client.post(frames, json={"path": str(site.folder / "none.fits")})
    assert missing.status_code == 404
    cards = {
        "DATE-OBS": "2026-11-21T20:00:00",
        "EXPTIME": 3600.0,
        "OBJCTRA": "05 00 00",
        "OBJCTDEC": "+20 00 00",
    }
    header = await site.client.post(frames, params={"wait": 60}, json={"header": cards, "source": "mosaic"})
    assert header.json()["mid_exposure_utc"].startswith("2026-11-21T20:30:00")
    assert header.json()["decision"] is None
    for body in (
        {},
        {"path": "a", "header": {}},
        {"path": 3},
        {"wrong": 1},
        {"path": "a", "target_ra_deg": 1.0},
    ):
        assert (await site.client.post(frames, json=body)).status_code == 422, body
    assert (await site.client.get(f"{frames}/nothing")).status_code == 404
    # played again, what lies in files is identified again
    site.app.state.service.nights.of("east").parts.recording.close()
    played = await asyncio.to_thread(play, read_recording(next(site.record.glob("*.jsonl"))), wire=False)
    assert played.report.same
    assert played.wire is None
    assert played.report.solved_anew == 1
    assert not played.report.missing


async def test_words_of_people_schedulers_and_sensors(site: NightSite) -> None:
    await site.said("start")
    assert (await site.said("pause", why="visitors"))["holds"] == ["paused by an operator"]
    assert (await site.said("resume"))["holds"] == []
    busy = await site.client.post("/v1/telescopes/east/night/busy", json={"busy": True, "for_s": 100})
    assert busy.json()["busy_until"] is not None
    busy = await site.client.post("/v1/telescopes/east/night/busy", json={"busy": False})
    assert busy.json()["busy_until"] is None
    wet = await site.client.post("/v1/telescopes/east/night/safety", json={"safe": False, "why": "rain"})
    assert (wet.json()["holds"], wet.json()["unsafe_why"]) == (["not safe"], "rain")
    dry = await site.client.post("/v1/telescopes/east/night/safety", json={"safe": True})
    assert dry.json()["holds"] == []
    calm = {"safe": True, "for_s": 600}
    told = (await site.client.post("/v1/telescopes/east/night/safety", json=calm)).json()
    assert told["safe_until"] is not None
    for nonsense in ({"safe": False, "for_s": 600}, {"safe": True, "for_s": 0}):
        refused = await site.client.post("/v1/telescopes/east/night/safety", json=nonsense)
        assert refused.status_code in (400, 422), refused.text
    assert (await site.client.get("/v1/telescopes/east/night")).json()["safe_until"] == told["safe_until"]
    stopped = await site.said("stop", why="snow")
    assert stopped["phase"] == "stopped"
    assert stopped["last"]["text"] == "snow"
    # the other telescope has no nights
    none = await site.client.get("/v1/telescopes/west/night")
    assert none.status_code == 404
    assert "night.enabled" in none.json()["advice"]


@pytest.mark.long
async def test_the_night_goes_on_after_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))
    folder, record, safety = tmp_path / "frames", tmp_path / "recordings", tmp_path / "safety.txt"
    folder.mkdir()
    safety.write_text("safe")
    toml = night_toml(folder, record, safety)
    content = b""
    async with served(toml, folder, record, safety) as first:
        await first.said("start")
        content = await first.exposed()
        await first.client.post("/v1/telescopes/east/frames", params={"wait": 60}, content=content)
        before = await first.night()
        assert before["placed"] == 1
    async with served(toml, folder, record, safety) as second:
        after = await second.night()
        assert (after["night_id"], after["phase"]) == (before["night_id"], "calibrating")
        assert after["placed"] == 1
        again = await second.client.post("/v1/telescopes/east/frames", content=content)
        assert again.json()["duplicate"]
    (path,) = record.glob("*.jsonl")
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["kind"] for line in lines].count("header") == 2
    played = await asyncio.to_thread(play, read_recording(path), solve=False)
    assert played.report.same
    assert played.report.not_judged == 0
    assert "go on: the service was restarted" in [row.replayed for row in played.report.rows]


@pytest.mark.long
async def test_rain_parks_a_telescope_that_somebody_slews(tmp_path: Path) -> None:
    folder, record, safety = tmp_path / "frames", tmp_path / "recordings", tmp_path / "safety.txt"
    (folder / "elsewhere").mkdir(parents=True)
    safety.write_text("safe")
    changes = {"read_mount_every_s = 0.1": 'read_mount_every_s = 0.1\nwhen_unsafe = "park"'}
    toml = night_toml(folder, record, safety, **changes).replace(
        "slew_rate_deg_s = 45.0", "slew_rate_deg_s = 3.0"
    )
    async with served(toml, folder, record, safety) as site:
        east, client = "/v1/telescopes/east", site.client
        await site.said("start", why="a test by day")
        # somebody's lease is no shelter from rain
        lease = (await client.post(f"{east}/lease", json={"ttl_s": 600})).json()["lease"]
        icrs = (await client.get(east)).json()["icrs"]
        place = {"ra_deg": (icrs["ra_deg"] + 20.0) % 360.0, "dec_deg": icrs["dec_deg"]}
        slew = await client.post(f"{east}/slew", json=place, headers={"Mountnav-Lease": lease})
        assert slew.status_code == 202, slew.text
        mechanics = site.app.state.service.observatory.telescope("east").mechanics
        while not mechanics.slewing():
            await asyncio.sleep(0.01)
        wet = await client.post(f"{east}/night/safety", json={"safe": False, "why": "rain"})
        assert wet.status_code == 200, wet.text
        job = (await client.get(slew.headers["location"], params={"wait": 30})).json()
        assert job["state"] == "cancelled"
        assert "night" in job["problem"]["detail"], job["problem"]
        mechanics.slew_rate_deg_s = 45.0
        async with asyncio.timeout(60.0):
            while not mechanics.parked:
                await asyncio.sleep(0.05)


def test_what_a_safety_file_says(tmp_path: Path) -> None:
    file = tmp_path / "safety.txt"
    now_s = 1e9

    def now() -> float:
        return now_s

    assert "can't be read" in unsafe_by_file(file, 300, now)
    for text, safe in (
        ("safe\n", True),
        ("1", True),
        ("OK.", True),
        ("", False),
        ("0", False),
        ("rain", False),
    ):
        file.write_text(text)
        os.utime(file, (now_s - 10, now_s - 10))
        assert (unsafe_by_file(file, 300, now) == "") is safe, text
    file.write_text("safe")
    os.utime(file, (now_s - 301, now_s - 301))
    assert "301 s old" in unsafe_by_file(file, 300, now)
