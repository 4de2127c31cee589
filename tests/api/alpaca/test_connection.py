"""Who is connected, who may: several clients of one telescope, keys, an open door, a mount that goes away."""

from __future__ import annotations

import asyncio
import base64
import os
from pathlib import Path

import pytest

from api.access.callers import Role
from api.access.keys import KeyStore
from api.alpaca.connection import GRACE_S
from api.alpaca.management import ids_path, unique_ids
from api.alpaca.telescope import AlpacaTelescope
from mountnav.settings.observatory import Settings
from tests.api.alpaca.alpaca_observatory import OBSERVATORY, Running, running


@pytest.mark.long
async def test_no_client_disconnects_a_telescope_that_another_one_uses(observatory: Running) -> None:
    one, other, silent = (observatory.probe.as_client(number) for number in (1, 2, 0))
    await one.put("connected", Connected=True)
    await other.put("connected", Connected=True)
    await one.put("connected", Connected=False)
    assert await one.get("connected") is False
    assert await one.refused("GET", "rightascension") == 0x407
    for client in (other, silent):
        assert await client.get("connected") is True
        await client.get("rightascension")
    await other.put("disconnect")
    await other.put("disconnect")  # a second one is nobody's trouble
    assert await other.get("connected") is False
    assert await other.get("connecting") is False
    # the mount itself was never let go: the service and its night go on
    assert observatory.service.observatory.telescope("german").is_open
    await silent.get("rightascension")
    await other.put("connect")
    await other.until("connecting", False)
    assert await other.get("connected") is True


@pytest.mark.long
async def test_targets_are_not_set_when_a_new_session_begins(observatory: Running) -> None:
    client = observatory.probe
    await client.put("connected", Connected=True)
    await client.put("targetdeclination", TargetDeclination=5.0)
    await client.as_client(9).put("connected", Connected=True)
    assert await client.get("targetdeclination") == 5.0
    for number in (9, client.client_id):
        await client.as_client(number).put("connected", Connected=False)
    await client.put("connected", Connected=True)
    assert await client.refused("GET", "targetdeclination") == 0x402


@pytest.mark.long
async def test_without_auto_connect_a_client_has_to_say_so() -> None:
    async with running(OBSERVATORY.replace("[alpaca]", "[alpaca]\nauto_connect = false")) as found:
        client = found.probe
        assert await client.get("connected") is False
        assert await client.refused("GET", "tracking") == 0x407
        await client.put("connected", Connected=True)
        assert await client.get("tracking") is True
        assert await client.as_client(2).refused("GET", "tracking") == 0x407


async def test_a_mount_that_is_not_there_says_why(observatory: Running) -> None:
    gone = observatory.probe.at(2)
    assert await gone.get("connected") is False
    found = await gone.ask("PUT", "connected", Connected=True)
    assert found.number == 0x501
    assert "there-is-no-such-port" in found.words
    # one that fails in the background is told where its end is told, once, to whoever asked for it
    await gone.put("connect")
    async with asyncio.timeout(60):
        while (ended := await gone.ask("GET", "connecting")).value:
            await asyncio.sleep(0.02)
    assert ended.number == 0x501
    assert "there-is-no-such-port" in ended.words
    assert await gone.get("connecting") is False
    assert await gone.as_client(9).get("connecting") is False
    assert await gone.get("connected") is False
    read = await gone.ask("GET", "rightascension")
    assert read.number == 0x407
    assert "there-is-no-such-port" in read.words
    for member in ("name", "driverinfo", "interfaceversion"):
        await gone.get(member)
    # a stop is tried even so by those who may know better than the last answer
    assert await gone.refused("PUT", "abortslew") == 0x501


@pytest.mark.long
async def test_one_lost_answer_is_no_lost_mount(
    observatory: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    telescope = observatory.service.observatory.telescope("german")
    now = [1000.0]
    service = observatory.service
    device = AlpacaTelescope(
        0, "x", telescope, service.dispatcher, service.settings, service.audit, lambda: now[0]
    )
    watch = observatory.service.dispatcher.watch("german")
    assert device.link.is_up()
    await observatory.probe.get("rightascension")
    await watch.close()  # no reading but ours
    navigator = telescope.navigator

    async def silent() -> object:
        from mountnav.errors import DeviceSilent

        raise DeviceSilent("no answer", device="german")

    monkeypatch.setattr(navigator.mount, "reading", silent)
    await watch.refresh()
    now[0] += GRACE_S - 1.0
    assert device.link.is_up()
    assert await observatory.probe.refused("GET", "rightascension") == 0x502
    assert await observatory.probe.get("connected") is True
    now[0] += 2.0
    assert not device.link.is_up()
    monkeypatch.undo()
    await watch.refresh()
    assert device.link.is_up()


async def test_nothing_waits_for_a_mount_that_takes_its_time(
    observatory: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    german = observatory.probe
    watch = observatory.service.dispatcher.watch("german")
    await watch.close()
    hangs, released = asyncio.Event(), asyncio.Event()
    telescope = observatory.service.observatory.telescope("german")

    async def slow() -> object:
        hangs.set()
        await released.wait()
        raise AssertionError("nobody waits for this")

    monkeypatch.setattr(type(telescope), "state", lambda self: slow())
    reading = asyncio.create_task(watch.refresh())
    await hangs.wait()
    for member in ("rightascension", "altitude", "tracking", "slewing", "atpark", "devicestate", "connected"):
        await german.get(member)
    assert not reading.done()
    reading.cancel()


@pytest.mark.long
async def test_the_first_reading_after_a_restart_has_the_same_ids(tmp_path: Path) -> None:
    found = []
    for _ in range(2):
        async with running() as observatory:
            page = await observatory.http.get("/management/v1/configureddevices")
            found.append([one["UniqueID"] for one in page.json()["Value"]])
            assert ids_path(observatory.service.settings) == tmp_path / "alpaca-ids.json"
    assert found[0] == found[1]
    assert len(set(found[0])) == 3


def test_ids_outlive_other_telescopes_and_damaged_files(tmp_path: Path) -> None:
    path = tmp_path / "state" / "alpaca-ids.json"
    first = unique_ids(path, ["a", "b"])
    assert unique_ids(path, ["c"]).keys() == {"c"}
    assert unique_ids(path, ["b", "a"]) == first
    path.write_text("{ damaged", encoding="utf-8")
    made = unique_ids(path, ["a"])
    assert made == unique_ids(path, ["a"])
    # what can't be read may be put right by hand: it isn't written over
    assert path.read_text(encoding="utf-8") == "{ damaged"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_ids_where_nothing_can_be_written_are_the_same_each_time(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    path = tmp_path / "alpaca-ids.json"
    assert unique_ids(path, ["a"]) == unique_ids(path, ["a"])


def _basic(password: str) -> dict[str, str]:
    return {"Authorization": "Basic " + base64.b64encode(f"anybody:{password}".encode()).decode()}


@pytest.fixture
def keys(tmp_path: Path) -> dict[Role, str]:
    """Keys of each role, and the file that the settings name."""
    store = KeyStore(tmp_path / "keys.json")
    return {role: store.new(f"a {role}", role)[1] for role in Role}


def _with_keys(tmp_path: Path) -> str:
    return OBSERVATORY.replace("port = 0", f'port = 0\nkeys_file = "{tmp_path / "keys.json"}"', 1)


@pytest.mark.long
async def test_a_key_comes_by_basic_or_by_header(tmp_path: Path, keys: dict[Role, str]) -> None:
    async with running(_with_keys(tmp_path)) as found:
        path = "/api/v1/telescope/0/tracking"
        without = await found.http.get(path)
        assert without.status_code == 401
        assert without.headers["www-authenticate"].startswith("Basic")
        assert without.headers["content-type"].startswith("text/plain")
        assert (await found.http.get(path, headers=_basic("wrong"))).status_code == 401
        assert (await found.http.get("/setup")).status_code == 401
        # what there is may be seen: programs look for devices before anybody typed a key
        assert (await found.http.get("/management/v1/configureddevices")).status_code == 200
        for headers in (_basic(keys[Role.VIEW]), {"X-API-Key": keys[Role.VIEW]}):
            seen = await found.http.get(path, headers=headers)
            assert seen.json()["Value"] is True
        looker = await found.http.put(
            "/api/v1/telescope/0/tracking", data={"Tracking": "False"}, headers=_basic(keys[Role.VIEW])
        )
        assert looker.json()["ErrorNumber"] == 0x40B
        stopped = await found.http.put("/api/v1/telescope/0/abortslew", headers=_basic(keys[Role.VIEW]))
        assert stopped.json()["ErrorNumber"] == 0x40B
        operator = await found.http.put(
            "/api/v1/telescope/0/tracking", data={"Tracking": "False"}, headers=_basic(keys[Role.OPERATE])
        )
        assert operator.json()["ErrorNumber"] == 0


@pytest.mark.long
async def test_an_open_door_needs_no_key(tmp_path: Path, keys: dict[Role, str]) -> None:
    toml = _with_keys(tmp_path).replace("[alpaca]", "[alpaca]\nopen = true")
    async with running(toml) as found:
        await found.probe.put("tracking", Tracking=True)
        wrong = await found.http.get("/api/v1/telescope/0/tracking", headers=_basic("wrong"))
        assert wrong.status_code == 401
        # nothing else is open
        assert (await found.http.get("/v1/telescopes")).status_code == 401


@pytest.mark.long
async def test_every_order_is_written_down_with_its_face(observatory: Running) -> None:
    german = observatory.probe
    await german.put("tracking", Tracking=True)
    # what never became a job, too: outside the limits, and not without tracking
    below = await german.at_hour_angle(12.0)
    await german.refused("PUT", "slewtocoordinatesasync", RightAscension=below, Declination=-20.0)
    await german.put("tracking", Tracking=False)
    await german.refused("PUT", "synctocoordinates", RightAscension=below, Declination=-20.0)
    wanted = {("tracking", "taken"), ("slew", "outside-limits"), ("sync-to", "invalid-operation")}
    async with asyncio.timeout(60):
        # rows are written down behind the answer
        while not wanted <= await _noted(observatory):
            await asyncio.sleep(0.02)


async def _noted(observatory: Running) -> set[tuple[str, str]]:
    found = await observatory.http.get("/v1/audit")
    assert found.status_code == 200, found.text
    return {(row["what"], row["outcome"]) for row in found.json()["rows"] if row["face"] == "alpaca"}


def test_settings_know_the_door() -> None:
    alpaca = Settings.parse(OBSERVATORY).alpaca
    assert alpaca.enabled
    assert not alpaca.open
    assert alpaca.discovery_port == 32227
