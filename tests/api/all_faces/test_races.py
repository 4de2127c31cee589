"""Superseding, cancelling, stopping and ordering all at once: after the last stop nothing moves."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import httpx
import pytest

from api.access.callers import Face
from tests.api.all_faces.attacked_service import STOP, Standing, standing, up_now
from tests.api.all_faces.programs import EAST, hands
from tests.waiting import until


def _slew(ha_deg: float, dec_deg: float) -> dict[str, Any]:
    place = up_now(ha_deg, dec_deg)
    return {"kind": "slew", "target": {"kind": "apparent", "ra_deg": place.ra_deg, "dec_deg": place.dec_deg}}


async def _mixed(stand: Standing, by: dict[str, Any], chance: random.Random) -> None:
    """A handful of everything, begun in the same moment, in an order of chance."""
    http: httpx.AsyncClient = by["rest"].http
    first = await http.post(f"{EAST}/jobs", json=_slew(-30.0, 30.0))
    assert first.status_code == 202, first.text
    if chance.random() < 0.5:
        await asyncio.sleep(chance.uniform(0.0, 0.3))
    path = first.headers["location"]
    acts = [
        http.post(f"{EAST}/jobs", params={"supersede": "true"}, json=_slew(-20.0, 40.0)),
        http.post(f"{EAST}/jobs", params={"supersede": "true"}, json=_slew(20.0, 50.0)),
        http.delete(path),
        http.delete(path),
        http.post(f"{EAST}/stop"),
        by["alpaca"].stop(),
        by["indi"].stop(),
        by["lx200"].stop(),
        by["stellarium"].goto(up_now(-40.0, 35.0)),
    ]
    chance.shuffle(acts)
    clicked = _clicked(stand)
    ended = await asyncio.gather(*acts)
    for one in ended:
        if isinstance(one, httpx.Response):
            assert one.status_code < 500, one.text
    # Stellarium is never answered: only the audit tells that its goto has been heard, and is not yet to come
    await until(lambda: _clicked(stand) > clicked, "heard Stellarium")


def _clicked(stand: Standing) -> int:
    """How many gotos of Stellarium were taken or refused."""
    rows = stand.service.journal.reader.audits(telescope="east", limit=1000)
    return sum(row.face == Face.STELLARIUM for row in rows)


def _stops_by_lx200(stand: Standing) -> int:
    """How many stops of LX200 were carried out."""
    rows = stand.service.journal.reader.audits(telescope="east", limit=1000)
    return sum(row.face == Face.LX200 and row.what == "stop" for row in rows)


async def _judged(stand: Standing, by: dict[str, Any], seed: int, seen: int) -> None:
    """One last stop, by any face: from then on the wire brings no goto, and the tube rests.

    `seen` is how many stops of LX200 were noted before the mix, which sends one.
    """
    face = ("rest", "alpaca", "indi", "lx200")[seed % 4]
    assert (await by[face].stop()).taken is not False, (seed, face)
    # LX200 has no answer to a stop: the one to the next question may come before a goto that went out earlier
    # has reached the mount, and its stop behind it. Only the audit tells that a stop was carried out
    await until(lambda: _stops_by_lx200(stand) == 1 + seen + (face == "lx200"), f"{seed}: stops carried out")
    mark = stand.mark()
    await stand.idle()
    await until(lambda: not stand.mechanics.slewing(), f"{seed}: at rest")
    # whatever was taken before that stop is over, and none of it comes out late
    await asyncio.sleep(0.3)
    assert stand.gotos(mark) == 0, (seed, face, stand.moving_words(mark))
    assert not stand.mechanics.slewing(), seed
    assert STOP in stand.fake.heard
    jobs = stand.service.jobs.all()
    assert all(job.is_over for job in jobs), (seed, jobs)


async def test_everything_at_once_and_then_a_stop() -> None:
    async with standing() as stand, hands(stand) as by:
        for seed in range(2):
            stand.mechanics.slew_rate_deg_s = 2.0
            seen = _stops_by_lx200(stand)
            await _mixed(stand, by, random.Random(seed))
            await _judged(stand, by, seed, seen)


@pytest.mark.long
async def test_everything_at_once_many_times(monkeypatch: pytest.MonkeyPatch) -> None:
    # its gotos are counted by their notes; of a minute's refusals only so many are noted
    monkeypatch.setattr("api.access.audit._MOST_REPEATED", 10_000)
    async with standing() as stand, hands(stand) as by:
        for seed in range(100, 125):
            stand.mechanics.slew_rate_deg_s = 2.0
            seen = _stops_by_lx200(stand)
            await _mixed(stand, by, random.Random(seed))
            await _judged(stand, by, seed, seen)
