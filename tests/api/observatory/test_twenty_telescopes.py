"""Twenty telescopes in one service with a pool of two: all are read, looked through, stopped; one changes."""

from __future__ import annotations

import asyncio

import httpx
import pytest

from api.http.app import create_app
from mountnav.settings.observatory import Settings

COUNT = 20
_HEAD = """
[service]
port = 0
[solver]
engine = "pool"
workers = 2
[solving]
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
"""
_ONE = """
[[telescope]]
id = "t{number:02d}"
exposure_s = {exposure_s}
mount = {{ url = "fake+lx200://", slew_rate_deg_s = 2.0 }}
camera = {{ kind = "simulated", width_px = 500, height_px = 400, scale_arcsec_px = 8.0 }}
"""


def _toml(*, last_exposure_s: float = 0.2) -> str:
    exposures = [0.2] * (COUNT - 1) + [last_exposure_s]
    return _HEAD + "".join(_ONE.format(number=n, exposure_s=s) for n, s in enumerate(exposures))


@pytest.mark.long
async def test_twenty_telescopes_share_two_processes_and_do_not_notice_each_other() -> None:
    app = create_app(Settings.parse(_toml()))
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=300) as client,
    ):
        service = app.state.service
        names = [f"t{number:02d}" for number in range(COUNT)]
        states = (await client.get("/v1/telescopes")).json()
        assert [one["id"] for one in states] == names
        assert all(one["connected"] for one in states)

        async def looked(name: str) -> str:
            job = (await client.post(f"/v1/telescopes/{name}/look", json={})).json()
            while job["state"] not in ("succeeded", "failed", "cancelled"):
                job = (await client.get(f"/v1/jobs/{job['id']}", params={"wait": 30})).json()
            return str(job["state"])

        ends = await asyncio.gather(*map(looked, names))
        # a simulated sky may be poor where a tube stands; nothing is lost or left over
        assert ends.count("succeeded") >= COUNT // 2, ends
        pool = service.solver.pool
        assert pool is not None
        assert len(pool.pids) == 2
        assert (
            (await client.get("/v1/health")).json()["solver_engine"].startswith("pool: 2 of 2 processes, 0")
        )

        where = {"target": {"kind": "altaz", "alt_deg": 50.0, "az_deg": 120.0}}
        for name in names[:-1]:
            assert (await client.post(f"/v1/telescopes/{name}/slew", json=where)).status_code == 202
        telescopes = service.observatory.telescopes
        app.state.read_again = lambda: Settings.parse(_toml(last_exposure_s=0.3))
        told = (await client.post("/v1/reload")).json()
        assert (told["changed"], told["untouched"]) == (["t19"], names[:-1])
        now = service.observatory.telescopes
        assert [a is b for a, b in zip(now, telescopes, strict=True)] == [True] * (COUNT - 1) + [False]
        assert all(service.jobs.running_on(name) is not None for name in names[:-1])

        stopped = (await client.post("/v1/stop")).json()
        assert [one["telescope"] for one in stopped["telescopes"]] == names
        assert False not in [one["stopped"] for one in stopped["telescopes"]]
        async with asyncio.timeout(120):
            while any(service.jobs.running_on(name) is not None for name in names):
                await asyncio.sleep(0.05)
