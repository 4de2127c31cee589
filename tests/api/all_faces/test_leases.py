"""A telescope that somebody holds: strangers by every face are told, and the wire hears of none of them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.api.all_faces.attacked_service import Standing, standing, up_now
from tests.api.all_faces.programs import EAST, FACES, RestHand, hands
from tests.waiting import until

SHORTEST_S = 5.0


async def held(rest: RestHand, on_expiry: str = "stop", ttl_s: float = 600.0) -> dict[str, str]:
    """Take a lease; the header that shows its holder."""
    taken = await rest.post("/lease", {"ttl_s": ttl_s, "on_expiry": on_expiry, "note": "tonight"})
    assert taken.status_code == 201, taken.text
    return {"Mountnav-Lease": taken.json()["lease"]}


async def test_strangers_are_refused_by_every_face_and_the_wire_is_silent() -> None:
    async with standing() as stand, hands(stand) as by:
        secret = await held(by["rest"])
        place = up_now(-30.0, 30.0)
        with stand.silent_wire():
            for face in FACES:
                for order in (by[face].goto(place), by[face].sync(place), by[face].park()):
                    told = await order
                    assert told.taken is not True, (face, told)
                    assert told.taken is None or told.words, face
            for path, body in (
                ("/look", None),
                ("/unpark", None),
                ("/home", None),
                ("/tracking", {"on": False}),
                ("/offset", {"east_arcsec": 60.0, "north_arcsec": 0.0}),
                ("/trust", None),
                ("/jobs", {"kind": "slew", "target": {"kind": "altaz", "alt_deg": 60.0, "az_deg": 100.0}}),
            ):
                refused = await by["rest"].post(path, body)
                assert refused.status_code == 409, (path, refused.text)
                assert refused.json()["type"].endswith(":leased"), (path, refused.text)
                assert "tonight" in refused.json()["detail"]
            for member in ("findhome", "setpark"):
                assert not (await by["alpaca"].put(member)).taken, member
            assert not (await by["alpaca"].put("tracking", Tracking="false")).taken
            assert not (await by["alpaca"].put("pulseguide", Direction=0, Duration=500)).taken
            wrong = await by["rest"].post(
                "/slew", {"ra_deg": 10.0, "dec_deg": 60.0}, **{"Mountnav-Lease": "x"}
            )
            assert wrong.status_code == 409, wrong.text
        assert all(job.state == "failed" for job in stand.service.jobs.all()), stand.service.jobs.all()
        # the holder's own order goes through, by whatever face it can show the lease
        target: dict[str, Any] = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
        mark = stand.mark()
        taken = await by["rest"].post("/slew", target, **secret)
        assert taken.status_code == 202, taken.text
        await stand.on_its_way(mark)


@pytest.mark.long
async def test_a_stop_is_taken_from_strangers_by_every_face() -> None:
    async with standing() as stand, hands(stand) as by:
        secret = await held(by["rest"])
        for face in ("rest", "alpaca", "indi", "lx200"):
            stand.mechanics.slew_rate_deg_s = 1.0
            mark = stand.mark()
            place = up_now(-30.0, 30.0)
            target: dict[str, Any] = {
                "ra_deg": place.ra_deg,
                "dec_deg": place.dec_deg,
                "frame": "jnow-apparent",
            }
            started = await by["rest"].post("/slew", target, **secret)
            assert started.status_code == 202, (face, started.text)
            await stand.on_its_way(mark)
            assert (await by[face].stop()).taken is not False, face
            await stand.idle()
            assert stand.moving_words(mark)[-1] == b":Q#", (face, stand.moving_words(mark))
            assert stand.service.leases.of("east") is not None, "a stop ends no lease"


async def _left_alone(by: dict[str, Any], stand: Standing, on_expiry: str) -> int:
    """A holder who set out for a long slew, and is never heard of again; the wire's mark of that moment."""
    secret = await held(by["rest"], on_expiry, SHORTEST_S)
    stand.mechanics.slew_rate_deg_s = 1.0
    place = up_now(-30.0, 10.0)
    body = {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg, "frame": "jnow-apparent"}
    mark = stand.mark()
    assert (await by["rest"].post("/slew", body, **secret)).status_code == 202
    await until(lambda: stand.gotos(mark) == 1 and stand.mechanics.slewing(), "on its way")
    # that of the next slew: this one is slow
    stand.mechanics.slew_rate_deg_s = 40.0
    return stand.mark()


@pytest.mark.long
@pytest.mark.parametrize("on_expiry", ["stop", "park", "keep-tracking"])
async def test_the_holder_dies_and_the_policy_acts_once(on_expiry: str) -> None:
    async with standing() as stand, hands(stand) as by:
        mark = await _left_alone(by, stand, on_expiry)
        lease = stand.service.leases.of("east")
        assert lease is not None
        # strangers try all the while, as a planetarium does
        while stand.service.leases.of("east") is lease:
            for face in FACES:
                told = await by[face].goto(up_now(20.0, 60.0))
                if stand.service.leases.of("east") is lease:
                    assert told.taken is not True, (face, told)
            await asyncio.sleep(0.2)
        if on_expiry == "keep-tracking":
            assert b":Q#" not in stand.moving_words(mark)
            return
        words = stand.moving_words(mark)
        assert words[0] == b":Q#", words
        if on_expiry == "park":
            await until(lambda: b":hP#" in stand.moving_words(mark), "ordered to park")
            await stand.idle()
            await until(lambda: stand.mechanics.parked, "parked")
            assert stand.moving_words(mark).count(b":hP#") == 1


@pytest.mark.long
async def test_the_holder_s_orders_go_by_alpaca_too() -> None:
    async with standing() as stand, hands(stand) as by:
        secret = await held(by["rest"])
        place = up_now(-30.0, 30.0)
        form = {"RightAscension": str(place.ra_deg / 15.0), "Declination": str(place.dec_deg)}
        path = "/api/v1/telescope/0/slewtocoordinatesasync"
        mark = stand.mark()
        refused = await by["rest"].http.put(path, data=form)
        assert refused.json()["ErrorNumber"] == 0x40B, refused.text
        taken = await by["rest"].http.put(path, data=form, headers=secret)
        assert taken.json()["ErrorNumber"] == 0, taken.text
        await stand.on_its_way(mark)
        released = await by["rest"].http.delete(f"{EAST}/lease", headers=secret)
        assert released.status_code == 200
