"""Who is let in, and to what: every route states a role, keys are asked for, other pages stay outside."""

from __future__ import annotations

import asyncio
import base64
import re
from collections.abc import AsyncIterator
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from fastapi.dependencies.models import Dependant
from fastapi.routing import iter_route_contexts
from starlette.datastructures import Headers

from api.access.callers import Face, Role
from api.access.keys import KeyStore, sha256_of
from api.access.roles import LEASED, ROLES, route_of
from api.access.security import RoleRequired, caller_from_headers, require_role_of_route
from api.http.app import create_app
from api.http.serving import bind, make_server
from api.problems import Refused
from mountnav.settings.observatory import Settings
from tests.api.conftest import Serve
from tests.api.http.stop_answers import stopped

DOCS = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "security.md"

NO_KEY_NEEDED = {
    "/",
    "/web/{path}",
    "/favicon.ico",
    "/docs",
    "/docs/oauth2-redirect",
    "/redoc",
    "/openapi.json",
    "/static-offline-docs",
    "/help",
    "/help/",
    "/help/{path}",
}
"""The page's own files and the API's description: they tell nothing of the sky; the page asks for the key."""
ONLY_VIRTUAL = {"GET /v1/virtual", "POST /v1/virtual/skip"}
"""Of the virtual observatory alone."""
ALPACA = ("/api", "/management", "/setup")
"""The Alpaca face asks for keys itself, in its own way, and is tested for it in its own room."""


def routes_of(app: FastAPI) -> list[tuple[str, str, Dependant | None]]:
    """Method, full path and dependencies of each route."""
    found = []
    for one in iter_route_contexts(app.routes):
        path = re.sub(r":[a-z]+\}", "}", str(one.path))
        for method in sorted((one.methods or {"GET"}) - {"HEAD", "OPTIONS"}):
            found.append((method, path, getattr(one, "dependant", None)))
    return found


def calls_of(dependant: Dependant | None) -> set[object]:
    """All functions that a route depends on."""
    if dependant is None:
        return set()
    below = [calls_of(one) for one in dependant.dependencies]
    return {dependant.call}.union(*below)


@pytest.fixture
def app(observatory_toml: str) -> FastAPI:
    """The application, not begun."""
    return create_app(Settings.parse(observatory_toml))


def test_every_route_states_its_role_and_is_held_to_it(app: FastAPI) -> None:
    seen = set()
    for method, path, dependant in routes_of(app):
        if path in NO_KEY_NEEDED or path.startswith(ALPACA):
            continue
        line = f"{method} {path}"
        calls = calls_of(dependant)
        own = [one for one in calls if isinstance(one, RoleRequired)]
        assert line in ROLES or own, (
            f"{line}: say in api/access/roles.py and docs/how-to/security.md which role it needs"
        )
        seen.add(line)
        if line in ROLES and ROLES[line] is not None:
            assert require_role_of_route in calls, f"{line} is not held to its role: TokenRequired is missing"
            assert route_of(method, path) == line
    assert len(seen) > 40
    assert seen >= LEASED


def test_the_table_names_no_route_that_is_not_there(app: FastAPI, observatory_toml: str) -> None:
    there = {f"{method} {path}" for method, path, _ in routes_of(app)}
    assert set(ROLES) - there - ONLY_VIRTUAL == set()


def test_the_book_shows_the_same_table() -> None:
    told = {}
    for row in re.findall(
        r"^\| `([A-Z]+ /[^`]*)` \| (\w+) \|", DOCS.read_text(encoding="utf-8"), re.MULTILINE
    ):
        told[row[0]] = row[1]
    assert told == {line: "everybody" if role is None else str(role) for line, role in ROLES.items()}


def test_what_changes_something_is_never_for_viewers() -> None:
    for line, role in ROLES.items():
        # a forecast orders nothing: its body is what it asks about
        if not line.startswith("GET ") and not line.endswith("/forecast"):
            assert role in (Role.SOLVE, Role.OPERATE, Role.CONFIGURE), line
            # what may only solve changes nothing: it is answered and forgotten
            assert role is not Role.SOLVE or line == "POST /v1/solve"


@pytest.mark.parametrize(
    ("method", "path", "line"),
    [
        ("GET", "/v1/telescopes/east", "GET /v1/telescopes/{telescope_id}"),
        ("HEAD", "/v1/telescopes/east", "GET /v1/telescopes/{telescope_id}"),
        ("POST", "/v1/telescopes/ea st/night/stop", "POST /v1/telescopes/{telescope_id}/night/stop"),
        ("POST", "/v1/telescopes/east/", None),
        ("POST", "/v1/telescopes/a/b/stop", None),
        ("DELETE", "/v1/telescopes/east", None),
        ("GET", "/v1/telescopes/east/wire\n", None),
        ("GET", "/v1/telescopesXeast", None),
    ],
)
def test_a_path_is_of_one_line_or_of_none(method: str, path: str, line: str | None) -> None:
    assert route_of(method, path) == line


# -- over HTTP -------------------------------------------------------------------------------------------


class Keyed:
    """A service that asks for keys, and a key of each role."""

    def __init__(self, client: httpx.AsyncClient, store: KeyStore) -> None:
        self.client = client
        self.store = store
        self.secrets = {role: store.new(f"the {role}er", role)[1] for role in Role}

    def headers(self, role: Role) -> dict[str, str]:
        """To come in with."""
        return {"Authorization": f"Bearer {self.secrets[role]}"}


@pytest.fixture
async def keyed(serving: Serve, observatory_toml: str, tmp_path: Path) -> AsyncIterator[Keyed]:
    """It listens to the whole world, as far as its settings say."""
    file = tmp_path / "keys.json"
    toml = observatory_toml.replace("[service]", f'[service]\nhost = "0.0.0.0"\nkeys_file = "{file}"')
    async with serving(toml) as client:
        yield Keyed(client, KeyStore(file))


@pytest.mark.long
async def test_keys_over_http(keyed: Keyed) -> None:
    """One service for all of it: each costs half a second."""
    await _each_role_reaches_what_it_may_and_no_more(keyed)
    await _keys_are_taken_two_ways_and_a_missing_one_is_asked_for(keyed)
    await _a_revoked_key_is_refused_at_once_and_the_open_routes_need_none(keyed)


async def _each_role_reaches_what_it_may_and_no_more(keyed: Keyed) -> None:
    """Over all routes of the table: refused for the role below, and not for that reason with the role."""
    for line, role in ROLES.items():
        method, _, template = line.partition(" ")
        if role is None or template.endswith("/events") or line in ONLY_VIRTUAL:
            continue
        # nothing of that name: whoever may ask is told so, and nothing is moved
        path = re.sub(r"\{[a-z_]+\}", "nothing", template)
        nobody = await keyed.client.request(method, path)
        assert (line, nobody.status_code) == (line, 401)
        for one in Role:
            answer = await keyed.client.request(method, path, headers=keyed.headers(one))
            refused = (
                answer.status_code == 403 and answer.json()["type"] == "urn:mountnav:problem:role-too-low"
            )
            assert (line, one, refused) == (line, one, not one.includes(role))


async def _keys_are_taken_two_ways_and_a_missing_one_is_asked_for(keyed: Keyed) -> None:
    secret = keyed.secrets[Role.VIEW]
    get = keyed.client.get
    for headers in ({"Authorization": f"bearer {secret}"}, {"X-API-Key": secret}):
        assert (await get("/v1/telescopes", headers=headers)).status_code == 200
    bare = await get("/v1/telescopes")
    assert (bare.status_code, bare.headers["WWW-Authenticate"]) == (401, 'Bearer realm="mountnav"')
    assert bare.json()["type"] == "urn:mountnav:problem:unauthorized"
    basic = "Basic " + base64.b64encode(f"me:{secret}".encode()).decode()
    wrong = (
        {"Authorization": f"Bearer {secret[:-1]}"},
        {"Authorization": f"Bearer {sha256_of(secret)}"},
        {"X-API-Key": "mnk_"},
        {"Authorization": basic},
        {"Authorization": secret},
        {"Authorization": "Bearer "},
    )
    for headers in wrong:
        answer = await get("/v1/telescopes", headers=headers)
        assert (headers, answer.status_code) == (headers, 401)
    # a key in an address would stand in logs
    assert (await get("/v1/telescopes", params={"key": secret, "api_key": secret})).status_code == 401


async def _a_revoked_key_is_refused_at_once_and_the_open_routes_need_none(keyed: Keyed) -> None:
    viewer, operator = keyed.headers(Role.VIEW), keyed.headers(Role.OPERATE)
    refused = await keyed.client.post("/v1/telescopes/east/stop", headers=viewer)
    assert (refused.status_code, refused.json()["type"]) == (403, "urn:mountnav:problem:role-too-low")
    assert (await stopped(keyed.client, "/v1/telescopes/east/stop", headers=operator)).status_code == 200
    keyed.store.revoke("the operateer")
    refused = await keyed.client.post("/v1/telescopes/east/stop", headers=operator)
    assert refused.status_code == 401
    assert 'error="invalid_token"' in refused.headers["WWW-Authenticate"]
    assert (await keyed.client.get("/v1/jobs", headers=viewer)).status_code == 200
    for path in ("/v1/health", "/v1/version", "/openapi.json", "/"):
        assert (path, (await keyed.client.get(path)).status_code) == (path, 200)


async def test_the_first_key_shuts_a_running_service(
    serving: Serve, observatory_toml: str, tmp_path: Path
) -> None:
    """Beside the journal, where `mountnav key new` puts it."""
    async with serving(observatory_toml) as client:
        assert (await client.get("/v1/telescopes")).status_code == 200
        for name in ("X-Forwarded-For", "Forwarded", "Via", "X-Real-IP"):
            # a proxy on this machine would carry the whole world's requests
            assert (await client.get("/v1/telescopes", headers={name: "1.2.3.4"})).status_code == 403
        _, secret = KeyStore(tmp_path / "keys.json").new("first", Role.VIEW)
        assert (await client.get("/v1/telescopes")).status_code == 401
        # with keys another machine's name is no reason to refuse
        headers = {"X-API-Key": secret, "Host": "observatory.example", "X-Forwarded-For": "1.2.3.4"}
        assert (await client.get("/v1/telescopes", headers=headers)).status_code == 200


async def test_a_stream_of_a_revoked_key_tells_nothing_more(observatory_toml: str, tmp_path: Path) -> None:
    """On a real socket: the next event is not told any more, and the stream ends.

    So does that of a key that has come to its end, and of one that may see less than as it came.
    """
    store = KeyStore(tmp_path / "keys.json")
    _, listens = store.new("listens", Role.VIEW)
    _, stays = store.new("stays", Role.VIEW)
    _, ends = store.new("ends", Role.VIEW)
    _, narrows = store.new("narrows", Role.VIEW)
    app = create_app(Settings.parse(observatory_toml))
    server = make_server(app, log_level="warning")
    with bind("127.0.0.1", 0) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}/v1/events"
        task = asyncio.create_task(server._serve([listener]))
        async with httpx.AsyncClient(timeout=60, trust_env=False) as client, asyncio.timeout(60):
            while not server.started:
                await asyncio.sleep(0.01)
            async with (
                client.stream("GET", url, headers={"X-API-Key": listens}) as revoked,
                client.stream("GET", url, headers={"X-API-Key": stays}) as other,
                client.stream("GET", url, headers={"X-API-Key": ends}) as ended,
                client.stream("GET", url, headers={"X-API-Key": narrows}) as narrowed,
            ):
                events = app.state.service.events
                events.publish("first", {})
                heard, kept = revoked.aiter_lines(), other.aiter_lines()
                others = ended.aiter_lines(), narrowed.aiter_lines()
                for one in (heard, *others):
                    await _until(one, "event: first")
                store.revoke("listens")
                store.change("ends", lasts=timedelta(milliseconds=1))
                store.change("narrows", telescopes=["east"])
                events.publish("second", {})
                for one in (heard, *others):
                    assert [line async for line in one if "second" in line] == []
                await _until(kept, "event: second")
        server.should_exit = True
        await task


async def _until(lines: AsyncIterator[str], wanted: str) -> None:
    async for line in lines:
        if line == wanted:
            return
    pytest.fail(f"the stream ended before {wanted}")


# -- for the other faces ---------------------------------------------------------------------------------


def test_without_keys_it_is_this_machine_and_may_everything(tmp_path: Path) -> None:
    caller = caller_from_headers(
        Headers({"Mountnav-Lease": "abc"}),
        "127.0.0.1",
        keys=KeyStore(tmp_path / "none.json"),
        face=Face.ALPACA,
    )
    assert (caller.name, caller.role, caller.face) == ("this machine", Role.CONFIGURE, Face.ALPACA)
    assert (caller.address, caller.lease_id) == ("127.0.0.1", "abc")


def test_basic_is_taken_where_it_is_asked_for_with_the_key_as_password(tmp_path: Path) -> None:
    store = KeyStore(tmp_path / "keys.json")
    _, secret = store.new("planetarium", Role.OPERATE)

    def come(text: str, *, basic: bool = True) -> str:
        headers = Headers({"Authorization": "Basic " + base64.b64encode(text.encode()).decode()})
        return caller_from_headers(headers, "", keys=store, face=Face.ALPACA, basic=basic).name

    assert come(f":{secret}") == come(f"anybody:{secret}") == "planetarium"
    for wrong in (secret, f"{secret}:", f"a:{secret}x", f"a:b:{secret}", ""):
        with pytest.raises(Refused) as refused:
            come(wrong)
        assert refused.value.problem.status == 401
        assert refused.value.headers == {"WWW-Authenticate": 'Basic realm="mountnav"'}
    with pytest.raises(Refused):
        come(f":{secret}", basic=False)
    for garbled in ("Basic", "Basic !!!", "Basic /w==", "Basic ÿ"):
        with pytest.raises(Refused):
            caller_from_headers(
                Headers(raw=[(b"authorization", garbled.encode("latin-1"))]), "", keys=store, basic=True
            )
