"""The line is lost, or the mount falls silent: every face says so, and nothing goes on by itself."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

import pytest

from drivers.fakes.bench import FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.indi.codec.messages import State
from mountnav.clock import utc_now
from tests.api.all_faces.attacked_service import Standing, fake_on_tcp, standing, up_now
from tests.api.all_faces.programs import hands
from tests.waiting import until

SILENT_S = 20.0


async def told_gone(by: dict[str, Any]) -> None:
    """Every face says that the mount isn't there, or hangs up where it has no word for that."""
    alpaca = await by["alpaca"].get("rightascension")
    assert alpaca["ErrorNumber"] != 0, alpaca
    await by["indi"].say()
    assert by["indi"].value("EQUATORIAL_EOD_COORD").state is State.ALERT
    # Stellarium and LX200 have no word for it
    while await by["stellarium"].reader.read(4096):
        pass
    await by["lx200"].say(":GR#")
    assert await by["lx200"].reader.read() == b""


async def test_a_plug_that_is_pulled_in_a_slew_is_told_by_every_face() -> None:
    with fake_on_tcp() as (bench, toml):
        await _pulled(bench, toml)


async def _pulled(bench: FakeOnTcp, toml: str) -> None:
    async with standing(toml, bench) as stand, hands(stand) as by:
        assert (await by["rest"].ended(await by["rest"].post("/trust")))["state"] == "succeeded"
        stand.mechanics.slew_rate_deg_s = 1.0
        mark = stand.mark()
        assert (await by["indi"].goto(up_now(-30.0, 20.0))).taken
        await stand.on_its_way(mark)
        job = stand.service.jobs.running_on("east")
        assert job is not None
        stand.bench.vanish()
        await job.ended.wait()
        assert str(job.state) == "failed", job
        watch = stand.service.dispatcher.watch("east")
        await until(lambda: not watch.latest.state.connected, "known to be gone")
        state = await by["rest"].state()
        assert (state["connected"], state["link"]) != (True, "up"), state
        assert state["problem"], state
        # orders are refused, by whatever face, and not kept for later
        told = await by["rest"].goto(up_now(20.0, 50.0))
        if told.taken:
            await stand.idle()
        assert not (await by["alpaca"].goto(up_now(20.0, 50.0))).taken
        assert not (await by["indi"].goto(up_now(20.0, 50.0))).taken
        await told_gone(by)
        # it comes back, still moving: it is stopped, and nothing is slewed by itself
        after = stand.mark()
        stand.bench.come_back()
        await until(lambda: stand.moving_words(after), "stopped when it was back")
        await until(lambda: watch.latest.state.connected, "back")
        await until(lambda: not stand.mechanics.slewing(), "at rest")
        words = stand.moving_words(after)
        assert words[0] == b":Q#", words
        assert set(words) == {b":Q#"}, words
        assert watch.latest.state.trusted is False


async def _silent(stand: Standing, by: dict[str, Any]) -> None:
    silent_from = utc_now()
    watch = stand.service.dispatcher.watch("east")
    at_once: list[str | None] = []

    def heard(what: str, facts: Mapping[str, object]) -> None:
        if what == "link-silent":
            at_once.append(watch.latest.state.link)

    stand.service.observatory.telescope("east").navigator.mount.listen(heard)
    stand.fake.add_fault(Fault("silence", for_s=SILENT_S))

    def owned() -> bool:
        state = watch.latest.state
        return not state.connected or bool(state.problem) or state.link not in (None, "up")

    await until(owned, "said to be silent")
    await until(lambda: bool(at_once), "known to be silent")
    # whoever asks at that moment is told, though the reading that hangs has seconds to go
    assert at_once[0] == "silent"
    state = await by["rest"].state()
    assert not state["connected"] or state["problem"] or state["link"] != "up", state
    # and never a reading that is given out for one of now
    if state["read_utc"] is not None:
        read_utc = datetime.fromisoformat(state["read_utc"])
        assert read_utc <= silent_from + timedelta(seconds=0.5), state


@pytest.mark.long
async def test_a_mount_that_falls_silent_is_not_shown_as_well() -> None:
    async with standing() as stand, hands(stand) as by:
        await _silent(stand, by)
        with stand.silent_wire():
            assert not (await by["alpaca"].goto(up_now(20.0, 50.0))).taken


@pytest.mark.long
async def test_a_stop_into_silence_is_never_said_to_have_arrived() -> None:
    """It is sent all the same; who asked is told that nobody knows."""
    async with standing() as stand, hands(stand) as by:
        stand.mechanics.slew_rate_deg_s = 1.0
        mark = stand.mark()
        assert (await by["rest"].goto(up_now(-30.0, 20.0))).taken
        await stand.on_its_way(mark)
        stand.fake.add_fault(Fault("silence", for_s=SILENT_S))
        after = stand.mark()
        told = await by["rest"].stop()
        await until(lambda: b":Q#" in stand.fake.heard[after:], "the stop on the wire")
        if told.taken:  # it was heard again before the line was given up: then it is at rest indeed
            assert not stand.mechanics.slewing()
            return
        await stand.idle()
        state = await by["rest"].state()
        assert state["problem"] or state["link"] != "up" or not state["connected"], state
