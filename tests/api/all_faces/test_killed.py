"""kill -9 of the real process, and the same request again: never two slews on the wire."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivers.fakes.wire_fake import WireFake
from drivers.lx200.codec.angles import ra_from_text
from mountnav.sky.coordinates import Apparent
from tests.api.all_faces.attacked_service import fake_on_tcp, up_now
from tests.api.all_faces.programs import EAST
from tests.waiting import PATIENCE_S, until

ROOT = Path(__file__).resolve().parents[3]


@asynccontextmanager
async def process(folder: Path, toml: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, str]]:
    """`mountnav serve` as it is run by its users, and its address."""
    config = folder / "observatory.toml"
    config.write_text(toml)
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "api.main", "serve", "--config", str(config)),
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    assert child.stdout is not None
    try:
        async with asyncio.timeout(PATIENCE_S):
            told = (await child.stdout.readline()).decode()
        assert "http://" in told, told
        url = told[told.index("http://") :].split()[0]
        async with httpx.AsyncClient(base_url=url, timeout=PATIENCE_S) as http:
            async with asyncio.timeout(PATIENCE_S):
                while not await _lives(http):
                    await asyncio.sleep(0.05)
        yield child, url
    finally:
        with contextlib.suppress(ProcessLookupError):
            child.kill()
        await child.wait()


async def _lives(http: httpx.AsyncClient) -> bool:
    try:
        return (await http.get(EAST)).json()["connected"] is True
    except httpx.HTTPError:
        return False


async def _posted(url: str, path: str, body: object, key: str) -> httpx.Response | None:
    async with httpx.AsyncClient(base_url=url, timeout=PATIENCE_S) as http:
        try:
            return await http.post(f"{EAST}{path}", json=body, headers={"Idempotency-Key": key})
        except httpx.HTTPError:
            return None


def _gotos(fake: WireFake, place: Apparent) -> int:
    """How often it was sent to that place; on the way there it may be sent by others."""
    hours = place.ra_deg / 15.0
    aims, count = b"", 0
    for word in list(fake.heard):
        aims = word if word[:3] == b":Sr" else aims
        if word == b":MS#":
            there = ra_from_text(aims[3:-1]).deg / 15.0
            count += abs((there - hours + 12.0) % 24.0 - 12.0) < 0.01
    return count


@pytest.mark.long
@pytest.mark.parametrize("moment", ["at once", "on the wire", "answered"])
async def test_a_request_repeated_after_a_kill_never_slews_twice(moment: str, tmp_path: Path) -> None:
    with fake_on_tcp() as (bench, toml):
        fake = bench.fake
        assert isinstance(fake, WireFake)
        place = up_now(-30.0, 30.0)
        body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
        async with process(tmp_path, toml) as (child, url):
            trusting = await _posted(url, "/trust", None, "t")
            assert trusting is not None
            assert trusting.status_code == 202, trusting.text
            fake.mechanics.slew_rate_deg_s = 1.0
            posting = asyncio.create_task(_posted(url, "/slew", body, "once"))
            if moment == "on the wire":
                await until(lambda: _gotos(fake, place) == 1, "on the wire")
            elif moment == "answered":
                await posting
            else:
                await asyncio.sleep(0.005)
            child.send_signal(signal.SIGKILL)
            await child.wait()
            answer = await posting
            assert moment != "answered" or (answer is not None and answer.status_code == 202)
        # whoever was killed could stop nothing, and a restart sends nothing that moves: it tells of it
        before = _gotos(fake, place)
        assert before <= 1
        fake.mechanics.slew_rate_deg_s = 40.0
        async with process(tmp_path, toml) as (child, url):
            again = [await _posted(url, "/slew", body, "once") for _ in range(3)]
            answers = [one for one in again if one is not None]
            assert len(answers) == 3
            assert all(one.status_code == 202 for one in answers), [one.text for one in answers]
            jobs = {one.json()["id"] for one in answers}
            assert len(jobs) == 1, "one key, one job"
            async with httpx.AsyncClient(base_url=url, timeout=PATIENCE_S) as http:
                end = (await http.get(f"/v1/jobs/{jobs.pop()}", params={"wait": 30})).json()
                other = await http.post(
                    f"{EAST}/slew", json={**body, "dec_deg": 31.0}, headers={"Idempotency-Key": "once"}
                )
            assert other.status_code == 422, other.text
            assert end["state"] in ("failed", "succeeded"), end
            # the first never got so far, or it did and isn't done again
            assert _gotos(fake, place) <= 1, fake.heard
            if before == 1:
                assert end["state"] == "failed", end
                assert end["problem"]["type"].endswith(":interrupted"), end
            child.send_signal(signal.SIGTERM)
            await child.wait()


async def _ended(url: str, path: str, body: object, key: str) -> dict[str, Any]:
    answer = await _posted(url, path, body, key)
    assert answer is not None
    assert answer.status_code == 202, answer.text
    async with httpx.AsyncClient(base_url=url, timeout=PATIENCE_S) as http:
        while True:
            end = (await http.get(f"/v1/jobs/{answer.json()['id']}", params={"wait": 30})).json()
            if end["state"] not in ("waiting", "running"):
                return dict(end)


async def _state(url: str) -> dict[str, Any]:
    async with httpx.AsyncClient(base_url=url, timeout=PATIENCE_S) as http:
        return dict((await http.get(EAST)).json())


@pytest.mark.long
async def test_a_mount_that_was_moved_while_the_service_was_dead_is_not_trusted(tmp_path: Path) -> None:
    with fake_on_tcp() as (bench, toml):
        fake = bench.fake
        assert isinstance(fake, WireFake)
        body = {"frame": "jnow-apparent"}
        here, there, far = up_now(-30.0, 30.0), up_now(-50.0, 10.0), up_now(-20.0, 20.0)
        places = [body | {"ra_deg": one.ra_deg, "dec_deg": one.dec_deg} for one in (here, there, far)]
        async with process(tmp_path, toml) as (child, url):
            await _ended(url, "/trust", None, "t1")
            assert (await _ended(url, "/slew", places[0], "s1"))["state"] == "succeeded"
            child.send_signal(signal.SIGKILL)
            await child.wait()
        async with process(tmp_path, toml) as (child, url):
            # it stands where it was left
            assert (await _state(url))["trusted"] is True
            child.send_signal(signal.SIGKILL)
            await child.wait()
        assert fake.mechanics.slew(there) is None
        await until(lambda: not fake.mechanics.slewing(), "at rest")
        for number in range(2):
            async with process(tmp_path, toml) as (child, url):
                state = await _state(url)
                assert state["trusted"] is False
                assert "from where it was seen last" in state["problem"], state["problem"]
                end = await _ended(url, "/slew", places[2], f"far {number}")
                assert end["problem"]["reasons"] == ["untrusted"], end
                child.send_signal(signal.SIGKILL)
                await child.wait()
        async with process(tmp_path, toml) as (child, url):
            await _ended(url, "/trust", None, "t2")
            assert (await _ended(url, "/slew", places[2], "s2"))["state"] == "succeeded"
            assert (await _state(url))["problem"] is None
            child.send_signal(signal.SIGTERM)
            await child.wait()
