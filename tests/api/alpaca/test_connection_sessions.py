"""Where one client's session ends and another's begins: targets, failures, connecting, orders given twice."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

from api.alpaca.connection import Client, Connecting
from api.alpaca.errors import AlpacaError
from api.orders import dispatcher
from api.orders.targets import require_place
from api.orders.vocabulary import ParkOrder
from mountnav.errors import DeviceRefused, Refusal
from tests.api.alpaca.alpaca_observatory import Running
from tests.api.alpaca.test_motion import SOMEBODY


async def test_a_new_session_begins_without_the_targets_of_clients_that_are_gone(
    observatory: Running,
) -> None:
    client, silent = observatory.probe, observatory.probe.as_client(0)
    # a client that forgot its number once stays connected without a name, and disconnects with its name alone
    await silent.put("connect")
    await silent.until("connecting", False)
    await silent.put("targetrightascension", TargetRightAscension=5.0)
    await client.put("connected", Connected=True)
    assert await client.refused("GET", "targetrightascension") == 0x402
    await client.put("targetrightascension", TargetRightAscension=6.0)
    await client.put("connected", Connected=False)
    await client.as_client(9).put("connected", Connected=True)
    assert await client.as_client(9).refused("GET", "targetrightascension") == 0x402
    # nor does connecting once more end a session
    await client.as_client(9).put("targetrightascension", TargetRightAscension=7.0)
    await client.as_client(9).put("connected", Connected=True)
    assert await client.as_client(9).get("targetrightascension") == 7.0


@pytest.mark.long
async def test_who_connects_is_not_told_how_a_slew_before_that_failed(
    observatory: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    german = observatory.probe

    async def fails(target: object) -> object:
        raise DeviceRefused("a gear is broken", device="german", reason=Refusal.OTHER)

    monkeypatch.setattr(observatory.service.observatory.telescope("german").navigator, "slew", fails)
    ra_h = await german.at_hour_angle(-1.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    async with asyncio.timeout(60):
        while not (await german.ask("GET", "slewing")).number:
            await asyncio.sleep(0.01)
    new = german.as_client(77)
    await new.put("connected", Connected=True)
    assert await new.get("slewing") is False
    # one that was there all the time is
    assert await german.as_client(78).refused("GET", "slewing") >= 0x500


@pytest.mark.parametrize("member", ["slewtocoordinates", "slewtocoordinatesasync"])
async def test_a_slew_that_is_stopped_while_it_is_taken_never_begins(
    observatory: Running, monkeypatch: pytest.MonkeyPatch, member: str
) -> None:
    german = observatory.probe
    ra_h = await german.at_hour_angle(-3.0)
    begun, go = threading.Event(), threading.Event()

    def later(*given: Any) -> None:
        begun.set()
        assert go.wait(60)
        require_place(*given)

    monkeypatch.setattr(dispatcher, "require_place", later)
    ordering = asyncio.create_task(
        german.as_client(7).ask("PUT", member, RightAscension=ra_h, Declination=20.0)
    )
    assert await asyncio.to_thread(begun.wait, 60)
    await german.put("abortslew")
    go.set()
    answer = await ordering
    assert answer.number == 0x40E
    assert "a stop came first" in answer.words
    await german.until_rest()
    assert [one.kind for one in observatory.service.jobs.all()] == []


async def test_a_slew_that_is_waited_for_and_stopped_says_so(observatory: Running) -> None:
    german = observatory.probe
    ra_h = await german.at_hour_angle(-3.0)
    waiting = asyncio.create_task(
        german.as_client(7).ask("PUT", "slewtocoordinates", RightAscension=ra_h, Declination=20.0)
    )
    async with asyncio.timeout(60):
        while not await german.get("slewing"):
            await asyncio.sleep(0.01)
    await german.put("abortslew")
    assert (await waiting).number == 0x40E
    # which is no failure to anybody else
    await german.until_rest()


@pytest.mark.long
async def test_parking_once_more_is_harmless_whoever_parks(fast: Running) -> None:
    german = fast.probe
    await german.put("park")
    await german.as_client(9).put("park")
    await german.as_client(0).put("park")
    await german.until_rest()
    assert await german.get("atpark") is True
    await german.put("unpark")
    await german.until_rest()
    job = await fast.service.dispatcher.order(SOMEBODY, "german", ParkOrder())
    await german.put("park")
    assert not job.is_over
    await german.until_rest()
    assert await german.get("atpark") is True
    assert [one.kind for one in fast.service.jobs.all()].count("park") == 2


@pytest.mark.long
async def test_the_way_to_park_makes_no_room_for_a_slew_even_of_the_same_client(fast: Running) -> None:
    german = fast.probe
    ra_h = await german.slew_to(-1.0, 20.0)
    await german.put("park")
    late = await german.ask("PUT", "slewtocoordinatesasync", RightAscension=ra_h, Declination=30.0)
    assert late.number == 0x40B
    # and says what can be done about it here
    assert "park" in late.words
    assert "AbortSlew" in late.words
    await german.until_rest()
    assert await german.get("atpark") is True


@pytest.mark.long
async def test_unparking_what_is_not_parked_is_harmless_while_a_stop_is_under_way(
    observatory: Running,
) -> None:
    german = observatory.probe
    ra_h = await german.at_hour_angle(-3.0)
    await german.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=20.0)
    await german.put("abortslew")
    await german.put("unpark")
    await german.until_rest()
    # not even asked: a mount may well refuse to be unparked twice
    assert [one.kind for one in observatory.service.jobs.all()].count("unpark") == 0


@pytest.mark.long
async def test_unparking_while_it_unparks_is_harmless(fast: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    german = fast.probe
    await german.put("park")
    await german.until_rest()
    navigator = fast.service.observatory.telescope("german").navigator
    going_on, unpark = asyncio.Event(), navigator.unpark

    async def slowly() -> None:
        await going_on.wait()
        await unpark()

    monkeypatch.setattr(navigator, "unpark", slowly)
    await german.put("unpark")
    assert await german.get("slewing") is True
    await german.put("unpark")
    await german.as_client(9).put("unpark")
    going_on.set()
    await german.until_rest()
    assert await german.get("atpark") is False


async def test_who_gives_up_while_the_mount_is_opened_is_not_connected_after_all() -> None:
    opened = asyncio.Event()
    connected: list[Client] = []

    async def opens() -> None:
        await opened.wait()

    connecting = Connecting(opens, connected.append, "german")
    one, other = Client("here", 1), Client("here", 2)
    for client in (one, other):
        connecting.begin(client)
    connecting.give_up(one)
    assert connecting.under_way
    opened.set()
    await _ended(connecting)
    assert connected == [other]
    # and may begin again
    connecting.begin(one)
    await _ended(connecting)
    assert connected == [other, one]


@pytest.mark.parametrize("trouble", [AlpacaError(0x501, "no such port"), RuntimeError("unforeseen")])
async def test_whatever_goes_wrong_while_it_connects_comes_to_an_end(trouble: Exception) -> None:
    async def fails() -> None:
        raise trouble

    client = Client("here", 1)
    connecting = Connecting(fails, lambda client: None, "german")
    connecting.begin(client)
    await _ended(connecting)
    failure = connecting.failed_before(client)
    assert failure is not None
    assert failure.number >= 0x500
    assert connecting.failed_before(client) is None


async def _ended(connecting: Connecting) -> None:
    assert connecting.under_way
    async with asyncio.timeout(60):
        while connecting.under_way:
            await asyncio.sleep(0)
