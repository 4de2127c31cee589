"""Told syncs by every face that has a word for one: the same bounds, and none is passed by another door."""

from __future__ import annotations

import pytest

from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.api.all_faces.attacked_service import standing, up_now
from tests.api.all_faces.programs import hands

SYNCING = ("alpaca", "indi", "lx200")


@pytest.mark.long
async def test_no_face_turns_the_sky_or_adds_up_words() -> None:
    async with standing() as stand, hands(stand) as by:
        place = up_now(-20.0, 80.0)
        body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
        slewed = await by["rest"].ended(await by["rest"].post("/slew", body))
        assert slewed["state"] == "succeeded", slewed
        before = stand.mechanics.reported()

        async def rest(there: Apparent) -> bool:
            target = {"kind": "apparent", "ra_deg": there.ra_deg, "dec_deg": there.dec_deg}
            ended = await by["rest"].ended(
                await by["rest"].post("/jobs", {"kind": "sync-to", "target": target})
            )
            return bool(ended["state"] == "succeeded")

        # 1.5° on the sky at δ = 80° would turn everything else by 8.6°
        for face in SYNCING:
            there = displaced(stand.mechanics.reported(), 5400.0, 0.0)
            assert not (await by[face].sync(there)).taken, face
        assert not await rest(displaced(stand.mechanics.reported(), 5400.0, 0.0))
        assert separation_arcsec(stand.mechanics.reported(), before) < 60.0
        # what one face has told is counted for the next
        assert await rest(displaced(stand.mechanics.reported(), 0.0, -5400.0))
        for face in SYNCING:
            there = displaced(stand.mechanics.reported(), 0.0, -5400.0)
            told = await by[face].sync(there)
            assert not told.taken, face
        assert separation_arcsec(stand.mechanics.reported(), before) < 7200.0
