"""Settings read again: telescopes come, change and go, and the others don't notice."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
import pytest
from fastapi import FastAPI

from api.access.callers import Role
from api.access.roles import OF_ALL, ROLES
from api.http.app import create_app
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from tests.settings_text import SERVICE_AND_SITE

_ONE = """
[[telescope]]
id = "{id}"
exposure_s = {exposure_s}
mount = {{ url = "fake+lx200://", slew_rate_deg_s = 2.0 }}
camera = {{ kind = "simulated", width_px = 400, height_px = 300, scale_arcsec_px = 8.0 }}
"""


def _toml(**exposures: float) -> str:
    return SERVICE_AND_SITE + "".join(_ONE.format(id=name, exposure_s=s) for name, s in exposures.items())


class _Running:
    """A service whose file can be changed."""

    def __init__(self, app: FastAPI, client: httpx.AsyncClient, text: str) -> None:
        self.app, self.client, self.text = app, client, text

    def read_again(self) -> Settings:
        return Settings.parse(self.text)

    async def reload(self, text: str) -> httpx.Response:
        self.text = text
        return await self.client.post("/v1/reload")

    async def ids(self) -> list[str]:
        return [one["id"] for one in (await self.client.get("/v1/telescopes")).json()]

    async def idle(self, telescope: str) -> None:
        async with asyncio.timeout(60):
            while self.app.state.service.jobs.running_on(telescope) is not None:
                await asyncio.sleep(0.02)


@asynccontextmanager
async def _running(text: str) -> AsyncIterator[_Running]:
    app = create_app(Settings.parse(text))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app, raise_app_exceptions=False),
            base_url="http://127.0.0.1",
            timeout=60,
        ) as client,
    ):
        one = _Running(app, client, text)
        app.state.read_again = one.read_again
        yield one


async def _alpaca(client: httpx.AsyncClient, number: int, what: str) -> dict[str, object]:
    told: dict[str, object] = (await client.get(f"/api/v1/telescope/{number}/{what}")).json()
    return told


@pytest.mark.long
async def test_telescopes_come_change_and_go_while_another_slews() -> None:
    async with _running(_toml(east=0.5, west=0.5, south=0.5)) as one:
        service, client = one.app.state.service, one.client
        east, west = (service.observatory.telescope(name) for name in ("east", "west"))
        assert [(await _alpaca(client, n, "connected"))["Value"] for n in range(3)] == [True] * 3
        before = (await client.get("/v1/telescopes/west")).headers["etag"]
        where = {"target": {"kind": "altaz", "alt_deg": 50.0, "az_deg": 120.0}}
        slew = (await client.post("/v1/telescopes/east/slew", json=where)).json()

        told = await one.reload(_toml(north=0.5, east=0.5, west=0.7))
        assert told.status_code == 200, told.text
        assert told.json() == {
            "added": ["north"],
            "changed": ["west"],
            "removed": ["south"],
            "untouched": ["east"],
            "needs_restart": [],
        }
        # the slew of the one that stayed goes on
        assert service.observatory.telescope("east") is east
        assert (await client.get(f"/v1/jobs/{slew['id']}")).json()["state"] in ("running", "succeeded")
        assert await one.ids() == ["north", "east", "west"]
        # the others are new, connected, and take orders
        assert service.observatory.telescope("west") is not west
        assert west.is_gone
        assert not west.is_open
        states = {state["id"]: state for state in (await client.get("/v1/telescopes")).json()}
        assert all(state["connected"] for state in states.values()), states
        again = await client.get("/v1/telescopes/west", headers={"If-None-Match": before})
        assert again.status_code == 200
        for name in ("north", "west"):
            assert (await client.post(f"/v1/telescopes/{name}/slew", json=where)).status_code == 202
        # a number of Alpaca stands for the telescope that it stood for
        names = [(await _alpaca(client, number, "name"))["Value"] for number in range(4)]
        assert names == ["mountnav east", "mountnav west", "mountnav south", "mountnav north"]
        gone = await client.put("/api/v1/telescope/2/connected", data={"Connected": "True"})
        assert gone.json()["ErrorNumber"] != 0
        assert (await client.post("/v1/telescopes/south/stop")).status_code == 404
        stopped = (await client.post("/v1/stop")).json()
        assert {row["telescope"] for row in stopped["telescopes"]} == {"north", "east", "west"}
        # and back again
        for name in ("north", "east", "west"):
            await one.idle(name)
        assert (await one.reload(_toml(east=0.5, west=0.5, south=0.5))).status_code == 200
        assert await one.ids() == ["east", "west", "south"]
        assert (await _alpaca(client, 2, "connected"))["Value"] is True


@pytest.mark.long
async def test_what_is_busy_wrong_or_not_for_reading_again_changes_nothing() -> None:
    text = _toml(east=0.5, west=0.5)
    async with _running(text) as one:
        service, client = one.app.state.service, one.client
        telescopes = service.observatory.telescopes
        where = {"target": {"kind": "altaz", "alt_deg": 40.0, "az_deg": 200.0}}
        assert (await client.post("/v1/telescopes/east/slew", json=where)).status_code == 202
        for other in (_toml(east=0.9, west=0.9, north=0.5), _toml(west=0.5)):
            refused = await one.reload(other)
            assert refused.status_code == 409, refused.text
            assert "east can't be changed or taken out: it has the job slew" in refused.json()["detail"]
        lease = await client.post("/v1/telescopes/west/lease", json={"ttl_s": 60})
        assert lease.status_code in (200, 201), lease.text
        held = await one.reload(_toml(east=0.5, west=0.9))
        assert held.status_code == 409
        assert "holds its lease" in held.json()["detail"]
        with pytest.raises(BadSettings):
            Settings.parse(text + "[[telescope]]\nid = 5")
        wrong = await one.reload(text + "[[telescope]]\nid = 5")
        assert wrong.status_code >= 400
        assert wrong.json()["type"].endswith("bad-settings")
        nowhere = (
            _toml(east=0.5, west=0.5)
            + _ONE.format(id="new", exposure_s=1)
            + '[telescope.model]\nfile = "/x"\n'
        )
        assert (await one.reload(nowhere)).status_code >= 400
        later = await one.reload(text.replace("latitude_deg = 47.0", "latitude_deg = 48.0"))
        assert later.json()["needs_restart"] == ["site"]
        assert service.settings.site.latitude_deg == 47.0
        assert all(now is then for now, then in zip(service.observatory.telescopes, telescopes, strict=True))
        one.app.state.read_again = None
        assert (await client.post("/v1/reload")).status_code >= 400


def test_only_who_may_configure_all_may_reload() -> None:
    assert ROLES["POST /v1/reload"] is Role.CONFIGURE
    assert "POST /v1/reload" in OF_ALL
