"""A mount that contradicts the settings on its site: by every way that tells, and the ways out over REST."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from typing import Any

import pytest

from mountnav.sky.coordinates import Site
from tests.api.all_faces.attacked_service import SITE, fake_on_tcp, standing, up_now
from tests.api.all_faces.programs import EAST, hands


async def _command(port: int, *given: str) -> tuple[int, str]:
    """Run `mountnav site-time` as its user does; the exit code and what it prints."""
    command = (sys.executable, "-m", "api.main", "site-time", "east", "--service", f"http://127.0.0.1:{port}")
    process = await asyncio.create_subprocess_exec(*command, *given, stdout=subprocess.PIPE)
    printed, _ = await process.communicate()
    return process.returncode or 0, printed.decode()


@pytest.mark.long
async def test_it_is_told_everywhere_and_nothing_slews_until_it_is_resolved() -> None:
    with fake_on_tcp() as (bench, toml):
        fake: Any = bench.fake
        mechanics = fake.mechanics
        mechanics.set_believed_site(Site(SITE.latitude_deg, -SITE.longitude_deg, SITE.height_m))
        async with standing(toml, bench) as stand, hands(stand) as by:
            http = by["rest"].http
            state = (await http.get(EAST)).json()
            assert "longitude is -22.000°" in state["contradiction"]
            assert "contradict each other" in state["problem"]
            health = (await http.get("/v1/health")).json()
            assert any("contradict each other" in one for one in health["concerns"]), health
            journal = (await http.get("/v1/journal", params={"kind": "fault"})).json()
            assert "contradict each other" in str(journal)
            await by["rest"].ended(await by["rest"].post("/trust"))
            place = up_now(-30.0, 30.0)
            body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
            with stand.silent_wire():
                for path in ("/slew", "/center"):
                    ended = await by["rest"].ended(await by["rest"].post(path, body))
                    assert ended["problem"]["reasons"] == ["site-or-time"], ended
                for face in ("alpaca", "indi", "lx200"):
                    assert not (await by[face].goto(place)).taken, face
            code, told = await _command(stand.port)
            assert code == 1, told
            assert "contradict each other" in told
            assert "--set" in told
            assert await _command(stand.port, "--accept") == (
                0,
                "east: mount and settings agree, as you confirmed\n",
            )
            assert (await http.get(EAST)).json()["contradiction"] is None
            audit = (await http.get("/v1/audit", params={"limit": 100})).json()
            assert "accept-site-time" in str(audit)
            assert await _command(stand.port, "--set") == (0, "east: mount and settings agree\n")
            assert abs(mechanics.believed_site.longitude_deg - SITE.longitude_deg) < 0.02
            state = (await http.get(EAST)).json()
            assert state["contradiction"] is None
            # its reading jumped by 22° of longitude: another place among the stars
            await by["rest"].ended(await by["rest"].post("/trust"))
            ended = await by["rest"].ended(await by["rest"].post("/slew", body))
            assert ended["state"] == "succeeded", ended
