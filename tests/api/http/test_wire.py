"""The wire log, as the service shows it and as `mountnav wire` prints it; fakes of every family served."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import httpx
import pytest

from api.cli.wire import wire
from drivers.fakes.bench import FakeOnPty
from drivers.registry import fake_dialects, make_fake
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, BadSettings, DeviceMissing
from mountnav.settings.telescope import FAKES
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site
from tests.api.command_here import exit_code

Serve = Callable[[str], AbstractAsyncContextManager[httpx.AsyncClient]]
WIRE = "/v1/telescopes/east/wire"


async def _lines(client: httpx.AsyncClient, after: int = 0) -> list[dict[str, object]]:
    answer = await client.get(WIRE, params={"after": after})
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("application/x-ndjson")
    return [json.loads(line) for line in answer.text.splitlines()]


async def test_the_service_shows_what_was_said(client: httpx.AsyncClient) -> None:
    header, *lines = await _lines(client)
    assert header["dir"] == "header"
    assert header["telescope"] == "east"
    assert [line["n"] for line in lines] == list(range(1, len(lines) + 1))
    said = [line["bytes"] for line in lines if line["dir"] == "driver->mount"]
    assert ":GR#" in said
    assert all(
        bytes.fromhex(str(line.get("hex", ""))).decode("latin-1") == line.get("bytes", "") for line in lines
    )
    later: list[dict[str, object]] = []
    async with asyncio.timeout(60):
        while not later:  # the mount is read again and again, whoever asks
            await asyncio.sleep(0.05)
            later = await _lines(client, after=len(lines))
    assert later[0]["n"] == len(lines) + 1
    assert (await client.get("/v1/telescopes/nobody/wire")).status_code == 404
    assert (await client.get(WIRE, params={"after": -1})).status_code == 422


@pytest.mark.long
@pytest.mark.parametrize("protocol", FAKES)
async def test_fakes_of_every_family_are_served(serving: Serve, observatory_toml: str, protocol: str) -> None:
    dialect = "onstep" if protocol == "lx200" else fake_dialects(protocol)[-1]
    toml = observatory_toml.replace("fake+lx200://", f"fake+{protocol}://?dialect={dialect}")
    async with serving(toml) as client:
        state = (await client.get("/v1/telescopes/east")).json()
        assert state["connected"] is True, state
        assert state["link"] == "up"
        assert len(await _lines(client)) > 3


async def test_a_dialect_that_is_none_is_told(serving: Serve, observatory_toml: str) -> None:
    with pytest.raises((BadSettings, BadRequest), match="dialect"):
        async with serving(observatory_toml.replace("fake+lx200://", "fake+lx200://?dialect=klingon")):
            pass


def test_the_command_watches_a_line_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mechanics = Mechanics(Site(49.6, 36.9), Air(), PointingErrors())
    fake = make_fake("nexstar", None, mechanics, clock=utc_now, monotonic=time.monotonic)
    dump = tmp_path / "said.jsonl"
    with FakeOnPty(fake) as bench:
        url = f"nexstar+serial://{bench.address}"
        assert exit_code(wire, url, follow=False, dump=dump) == 0
    told = capsys.readouterr().out
    assert url in told
    assert "-> V" in told
    kept = [json.loads(line) for line in dump.read_text().splitlines()]
    assert kept[0]["dir"] == "header"
    assert {line["dir"] for line in kept[1:]} == {"driver->mount", "mount->driver", "event"}


def test_the_command_says_when_there_is_no_service(tmp_path: Path) -> None:
    nobody = "http://127.0.0.1:9"
    with pytest.raises(DeviceMissing, match="no mountnav service"):
        wire("east", service=nobody, follow=False, as_json=True)
    with pytest.raises(BadRequest, match="can't be written"):
        wire("east", service=nobody, follow=False, as_json=True, dump=tmp_path / "no" / "dump")
