"""Several programs want one telescope by different faces: one has it, and the others are told."""

from __future__ import annotations

import asyncio

import pytest

from tests.api.all_faces.attacked_service import standing, up_now
from tests.api.all_faces.programs import FACES, hands
from tests.waiting import until


@pytest.mark.long
async def test_who_holds_it_is_disturbed_by_nobody() -> None:
    async with standing() as stand, hands(stand) as by:
        for holder in FACES:
            stand.mechanics.slew_rate_deg_s = 1.0
            mark = stand.mark()
            told = await by[holder].goto(up_now(-30.0, 30.0))
            assert told.taken is not False, (holder, told)
            await stand.on_its_way(mark, f"{holder}'s goto on the wire")
            job = stand.service.jobs.running_on("east")
            with stand.silent_wire():
                for other in FACES:
                    if other == holder:
                        continue
                    for order in (by[other].goto(up_now(20.0, 50.0)), by[other].park()):
                        refused = await order
                        assert refused.taken is not True, (holder, other, refused)
                        assert refused.taken is None or refused.words, (holder, other)
                    synced = await by[other].sync(up_now(-30.0, 30.0))
                    assert synced.taken is not True, (holder, other, synced)
                assert stand.service.jobs.running_on("east") is job, holder
            assert (await by["rest"].stop()).taken
            await stand.idle()
            await until(lambda: not stand.mechanics.slewing(), "at rest")


async def test_five_at_once_and_one_goes() -> None:
    async with standing() as stand, hands(stand) as by:
        for turn in range(len(FACES)):
            stand.mechanics.slew_rate_deg_s = 1.0
            mark = stand.mark()
            # each begins once: the order of the tasks is the order of their bytes
            order = FACES[turn:] + FACES[:turn]
            told = dict(
                zip(
                    order,
                    await asyncio.gather(
                        *(by[face].goto(up_now(-20.0 + 5.0 * n, 30.0)) for n, face in enumerate(order))
                    ),
                    strict=True,
                )
            )
            await stand.on_its_way(mark)
            taken = [face for face, one in told.items() if one.taken]
            assert len(taken) <= 1, told
            assert all(one.words for one in told.values() if one.taken is False), told
            assert stand.gotos(mark) == 1
            job = stand.service.jobs.running_on("east")
            assert job is not None
            assert (await by["indi"].stop()).taken
            await stand.idle()
            assert stand.gotos(mark) == 1
            assert str(job.state) == "cancelled"
