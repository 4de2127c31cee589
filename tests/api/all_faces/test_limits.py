"""Places that aren't allowed, by every face: nothing moves, and who can be told is told why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from mountnav.clock import utc_now
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Apparent
from mountnav.sky.named import position_of_name
from tests.api.all_faces.attacked_service import OBSERVATORY, SITE, Standing, standing, up_now
from tests.api.all_faces.programs import EAST, FACES, hands

# the mount begins at the zenith, which the Sun never comes within 23 degrees of here: with a wider cone the
# watch ends its tracking at a noon in summer
NARROW = OBSERVATORY.replace(
    "sun_cone_deg = 0.0",
    """sun_cone_deg = 8.0
sun_cone_from_altitude_deg = -90.0
hour_angle_deg = [-75.0, 75.0]
declination_deg = [-20.0, 85.0]
min_altitude_deg = 10.0
max_altitude_deg = 85.0""",
)


def sun() -> Apparent:
    """Of date; below the horizon at night, which is no better."""
    utc = utc_now()
    return icrs_to_apparent(position_of_name("Sun", utc, SITE), utc)


FORBIDDEN: Mapping[str, Any] = {
    "below the horizon": lambda: up_now(150.0, -10.0),
    "under the pole": lambda: up_now(180.0, 60.0),
    "too far west": lambda: up_now(85.0, 60.0),
    "the Sun": sun,
    "the zenith": lambda: up_now(0.0, 47.0),
    "too near the pole": lambda: up_now(-10.0, 89.0),
}


async def everywhere_refused(stand: Standing, by: Mapping[str, Any], what: str, place: Apparent) -> None:
    tube = stand.mechanics.axes()
    with stand.silent_wire():
        for face in FACES:
            told = await by[face].goto(place)
            if told.taken:
                # REST answers with a job, whose end tells
                assert face == "rest", (what, face, told)
                await stand.idle()
            assert told.taken is None or told.words, (what, face)
        centered = await by["rest"].ended(
            await by["rest"].post(
                "/center", {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
            )
        )
        assert centered["state"] == "failed", (what, centered)
        assert centered["problem"]["type"].endswith((":outside-limits", ":device-refused")), centered
        assert centered["problem"]["detail"], what
    now = stand.mechanics.axes()
    assert abs(now.dec_axis_deg - tube.dec_axis_deg) < 1e-6, what


async def test_what_is_not_allowed_moves_nothing_by_any_face() -> None:
    async with standing(NARROW) as stand, hands(stand) as by:
        for what, place in FORBIDDEN.items():
            await everywhere_refused(stand, by, what, place())
        # every one of them is in the audit, also those that have no answer
        rows = (await by["rest"].http.get("/v1/audit", params={"limit": 1000})).json()
        told = {(row["face"], row["outcome"]) for row in (rows if isinstance(rows, list) else rows["rows"])}
        for face in FACES:
            outcome = "taken" if face == "rest" else "outside-limits"
            assert (face, outcome) in told, (face, told)


@pytest.mark.long
async def test_a_parked_mount_stays_parked_for_every_face() -> None:
    async with standing() as stand, hands(stand) as by:
        parked = await by["rest"].ended(await by["rest"].post("/park"))
        assert parked["state"] == "succeeded", parked
        assert stand.mechanics.parked
        place = up_now(-30.0, 30.0)
        body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
        with stand.silent_wire():
            for face in FACES:
                told = await by[face].goto(place)
                # REST answers with a job, whose end tells
                assert not told.taken or face == "rest", (face, told)
                await stand.idle()
                # REST's sync would look at the sky first
                if face != "rest":
                    assert not (await by[face].sync(place)).taken, face
            for path, given in (
                ("/slew", body),
                ("/center", body),
                ("/flip", body),
                ("/offset", {"east_arcsec": 600.0, "north_arcsec": 0.0}),
                ("/home", None),
                ("/tracking", {"on": True}),
                ("/jobs", {"kind": "guide", "direction": "n", "duration_s": 1.0}),
                ("/jobs", {"kind": "model-run", "points": 5}),
                ("/jobs", {"kind": "sync-to", "target": {"kind": "altaz", "alt_deg": 60.0, "az_deg": 90.0}}),
            ):
                ended = await by["rest"].ended(await by["rest"].post(path, given))
                assert ended["state"] == "failed", (path, ended)
            for member, form in (
                ("pulseguide", {"Direction": 0, "Duration": 500}),
                ("findhome", {}),
                ("tracking", {"Tracking": "true"}),
                ("slewtoaltazasync", {"Altitude": 60.0, "Azimuth": 100.0}),
            ):
                told = await by["alpaca"].put(member, **form)
                assert not told.taken, (member, told)
        assert stand.mechanics.parked
        state = (await by["rest"].http.get(EAST)).json()
        assert (state["parked"], state["slewing"]) == (True, False), state
