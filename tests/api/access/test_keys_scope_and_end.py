"""Keys for some telescopes, keys that end, keys that are renewed: what they open, on every face."""

from __future__ import annotations

import json
import logging
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.access.callers import Role
from api.access.keys import KeyClock, KeyStore
from api.access.roles import OF_ALL, ROLES
from api.cli.keys import key_app
from mountnav.errors import BadRequest, NotFound
from tests.api.conftest import Serve

DAY = timedelta(days=1)


class Hand:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.utc = datetime.now(UTC)

    def __call__(self) -> datetime:
        return self.utc


@pytest.fixture
def clock() -> Hand:
    return Hand()


@pytest.fixture
def store(tmp_path: Path, clock: Hand) -> KeyStore:
    return KeyStore(tmp_path / "keys.json", clock=clock)


def test_a_key_ends_at_its_instant_and_its_holder_is_told_why(store: KeyStore, clock: Hand) -> None:
    key, secret = store.new("guest", Role.VIEW, lasts=DAY)
    clock.utc += DAY - timedelta(seconds=1)
    assert store.find(secret) == key
    assert store.known(key.sha256) == key
    clock.utc += timedelta(seconds=1)
    assert store.find(secret) is None
    assert store.known(key.sha256) is None
    assert store.ended(secret) == key
    assert store.ended("mnk_other") is None


def test_a_clock_that_is_set_back_makes_no_key_live_again() -> None:
    """Nor does one that was ahead keep anybody out for good."""
    machine, seconds = [datetime(2026, 11, 26, tzinfo=UTC)], [100.0]
    clock = KeyClock(lambda: machine[0], lambda: seconds[0])
    seconds[0] += 7200.0
    machine[0] -= timedelta(days=400)
    assert clock() == datetime(2026, 11, 26, 2, tzinfo=UTC)
    machine[0] = datetime(2038, 1, 19, tzinfo=UTC)
    assert clock() == machine[0]
    machine[0] = datetime(2026, 11, 26, 2, 30, tzinfo=UTC)
    assert clock() == machine[0]


def test_a_start_with_a_clock_of_before_believes_the_newest_key(store: KeyStore, clock: Hand) -> None:
    """A small computer without a battery begins in 1970: a key of last year stays over."""
    made = clock.utc
    _, over = store.new("old", Role.VIEW, lasts=timedelta(seconds=1))
    clock.utc = datetime(1970, 1, 1, tzinfo=UTC)
    later = KeyStore(store.path, clock=lambda: made + DAY)
    later.new("newest", Role.VIEW)
    newest = json.loads(store.path.read_text("utf-8"))
    newest["keys"][-1]["created_utc"] = (made + DAY).isoformat()
    store.path.write_text(json.dumps(newest), "utf-8")
    assert store.find(over) is None


@pytest.mark.parametrize(
    "end",
    [
        {"lasts": timedelta(0)},
        {"lasts": -DAY},
        {"lasts": timedelta.max},
        {"until": datetime(2020, 1, 1, tzinfo=UTC)},
        {"until": datetime.max.replace(tzinfo=UTC)},
        {"lasts": DAY, "until": datetime(2100, 1, 1, tzinfo=UTC)},
        {"telescopes": []},
        {"telescopes": ["east", "../west"]},
        {"telescopes": ["east\n"]},
        {"telescopes": [f"t{at}" for at in range(101)]},
    ],
)
def test_ends_and_telescopes_that_are_none_make_no_key(store: KeyStore, end: dict[str, object]) -> None:
    with pytest.raises(BadRequest):
        store.new("guest", Role.VIEW, **end)  # type: ignore[arg-type]
    assert not store.path.exists() or store.keys == []


def test_a_renewed_key_has_two_secrets_for_a_while(store: KeyStore, clock: Hand) -> None:
    _, old = store.new("scheduler", Role.OPERATE, lasts=30 * DAY, telescopes=["east"])
    clock.utc += 29 * DAY
    new_key, new = store.renew("scheduler", overlap=timedelta(hours=2))
    assert new_key.telescopes == frozenset({"east"})
    assert new_key.expires_utc is not None
    assert new_key.expires_utc - clock.utc == pytest.approx(30 * DAY, abs=timedelta(minutes=5))
    assert store.find(old) is not None
    assert store.find(new) == new_key
    # its successor is there: nobody needs to be told of the old one's end
    assert store.ending(3 * DAY) == []
    clock.utc += timedelta(hours=2)
    assert store.find(old) is None
    assert store.find(new) == new_key
    # the overlap never lets one live longer than it would have
    _, third = store.renew("scheduler", overlap=400 * DAY)
    found = store.find(new)
    assert found is not None
    assert found.expires_utc == new_key.expires_utc
    store.revoke("scheduler", hint=new[-4:])
    assert (store.find(new), store.find(third) is not None) == (None, True)
    with pytest.raises(NotFound):
        store.revoke("scheduler", hint="none")
    store.revoke("scheduler")
    assert store.find(third) is None


def test_old_files_go_on_working_and_are_left_as_they_were(store: KeyStore, clock: Hand) -> None:
    """As a service of before wrote them; and it can read what is written while no key is narrow."""
    record = {
        "name": "old",
        "role": "operate",
        "sha256": "0" * 64,
        "created_utc": "2026-01-01T00:00:00Z",
        "hint": "abcd",
    }
    store.path.write_text(json.dumps({"version": 1, "keys": [record]}), "utf-8")
    assert [(key.name, key.telescopes, key.expires_utc) for key in store.keys] == [("old", None, None)]
    store.new("another", Role.VIEW)
    written = json.loads(store.path.read_text("utf-8"))
    assert written["version"] == 1
    assert all(set(one) == set(record) for one in written["keys"])
    store.new("narrow", Role.VIEW, telescopes=["east"])
    # such a service must refuse it whole, rather than let the narrow key do everything
    assert json.loads(store.path.read_text("utf-8"))["version"] == 2


def test_ends_are_told_before_they_come_without_names_in_health(
    store: KeyStore, clock: Hand, caplog: pytest.LogCaptureFixture
) -> None:
    store.new("far", Role.VIEW, lasts=60 * DAY)
    store.new("guest of the week", Role.VIEW, lasts=7 * DAY)
    assert store.concerns()[0].startswith("keys: 1 end within 14 days")
    assert "guest" not in "".join(store.concerns())
    with caplog.at_level(logging.WARNING):
        for second in (0.0, 3600.0, 86_399.0, 86_400.0):
            store.tell_ends(second)
    assert [record.message for record in caplog.records if "guest of the week" in record.message] == [
        caplog.records[0].message
    ] * 2
    clock.utc += 8 * DAY
    assert store.concerns() == ["keys: 1 have ended and open nothing; `mountnav key list` names them"]


def test_the_command_line_makes_narrow_keys_renews_and_changes_them(tmp_path: Path) -> None:
    file = str(tmp_path / "keys.json")
    runner = CliRunner()

    def run(*words: str) -> str:
        result = runner.invoke(key_app, [*words, "--file", file])
        assert (words, result.exit_code) == (words, 0), result.output
        return result.stdout

    first = run("new", "guest", "--role", "view", "-t", "east", "-t", "west", "--for", "90d").strip()
    second = run("renew", "guest", "--for", "12h", "--overlap", "0").strip()
    store = KeyStore(tmp_path / "keys.json")
    assert (store.find(first), store.find(second) is not None) == (None, True)
    run("change", "guest", "--all-telescopes", "--endless", "--role", "operate")
    found = store.find(second)
    assert found is not None
    assert (found.role, found.telescopes, found.expires_utc) == (Role.OPERATE, None, None)
    run("change", "guest", "--until", "2099-06-30", "-t", "east")
    row = json.loads(run("list", "--json"))[0]
    assert (row["expires_utc"], row["telescopes"]) == ("2099-06-30T00:00:00+00:00", ["east"])
    assert "ends 2099-06-30 00:00 UTC  only east" in run("list")
    for words in (["--for", "0d"], ["--for", "1 century"], ["--until", "soon"], []):
        assert runner.invoke(key_app, ["change", "guest", *words, "--file", file]).exit_code != 0


@pytest.mark.long
async def test_a_key_for_one_telescope_opens_no_door_to_another(
    serving: Serve, observatory_toml: str, tmp_path: Path
) -> None:
    """Over all routes, and over Alpaca; the lists show it what is its own."""
    store = KeyStore(tmp_path / "keys.json")
    _, narrow = store.new("of east", Role.CONFIGURE, telescopes=["east"])
    _, wide = store.new("of all", Role.CONFIGURE)
    async with serving(observatory_toml) as client:

        async def ask(method: str, path: str, secret: str = narrow, **more: object) -> tuple[int, str]:
            answer = await client.request(method, path, headers={"X-API-Key": secret}, **more)  # type: ignore[arg-type]
            return answer.status_code, answer.text

        for line, role in ROLES.items():
            method, _, template = line.partition(" ")
            if role is None or ("{telescope_id}" not in template and line not in OF_ALL):
                continue
            path = re.sub(r"\{telescope_id\}", "gone", template)
            status, text = await ask(method, re.sub(r"\{[a-z_]+\}", "1", path))
            assert (line, status) == (line, 403)
            assert "forbidden" in text
        # an order to the other is a job that the narrow key neither sees nor ends
        order = {"target": {"kind": "icrs", "ra_deg": 10.0, "dec_deg": 80.0}}
        status, text = await ask("POST", "/v1/telescopes/gone/slew", wide, json=order)
        assert status == 202
        job_id = json.loads(text)["id"]
        for method, path in (
            ("GET", f"/v1/jobs/{job_id}"),
            ("GET", f"/v1/jobs/{job_id}/events"),
            ("DELETE", f"/v1/jobs/{job_id}"),
            ("POST", f"/v1/jobs/{job_id}/cancel"),
            ("GET", "/v1/journal?telescope=gone"),
            ("GET", "/v1/audit?telescope=gone"),
            ("POST", "/v1/solve?telescope=gone"),
            ("GET", "/api/v1/telescope/1/rightascension"),
            ("PUT", "/api/v1/telescope/1/abortslew"),
            ("GET", "/setup/v1/telescope/1/setup"),
        ):
            assert (path, (await ask(method, path))[0]) == (path, 403)
        for path in ("/v1/jobs", "/v1/journal", "/v1/audit", "/v1/telescopes", "/v1/capabilities", "/setup"):
            status, text = await ask("GET", path)
            assert (path, status) == (path, 200)
            assert (path, '"gone"' in text or ">gone<" in text) == (path, False)
        assert job_id in (await ask("GET", "/v1/jobs", wide))[1]
        told = json.loads((await ask("GET", "/v1/capabilities"))[1])
        assert (told["your_telescopes"], told["your_key_ends_utc"]) == (["east"], None)
        stopped = json.loads((await ask("POST", "/v1/stop"))[1])
        assert [one["telescope"] for one in stopped["telescopes"]] == ["east"]
        # a key that has ended is told so, and counted by health without its name
        store.change("of east", lasts=timedelta(milliseconds=1))
        status, text = await ask("GET", "/v1/telescopes")
        assert (status, "the key ended at" in text) == (401, True)
        assert (await ask("GET", "/api/v1/telescope/0/rightascension"))[0] == 401
        health = (await client.get("/v1/health")).text
        assert "have ended" in health
        assert "of east" not in health
