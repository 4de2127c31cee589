"""Who may have images solved: keys with the role `solve` and those above it; and what such a key may not."""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from api.access.callers import Role
from api.access.keys import KeyStore
from api.access.roles import ROLES
from api.alpaca.answering import MEMBERS
from api.nova.server import NovaServer
from tests.api.nova.nova_service import HINT, Standing, as_fits, drawn, pixels, standing

KEYED = '[service]\nkeys_file = "{file}"'


def keyed_observatory(file: Path) -> str:
    from tests.api.conftest import OBSERVATORY

    return OBSERVATORY.replace("[service]", KEYED.format(file=file))


def test_roles_are_ordered_but_for_solve_and_view() -> None:
    """`solve` sees nothing that `view` sees, and `view` may not solve, as before."""
    may = {role: {other for other in Role if role.includes(other)} for role in Role}
    assert may == {
        Role.SOLVE: {Role.SOLVE},
        Role.VIEW: {Role.VIEW},
        Role.OPERATE: {Role.SOLVE, Role.VIEW, Role.OPERATE},
        Role.CONFIGURE: set(Role),
    }


def test_one_route_alone_is_for_keys_that_may_only_solve() -> None:
    allowed = {line for line, role in ROLES.items() if role is not None and Role.SOLVE.includes(role)}
    assert allowed == {"POST /v1/solve"}


async def _rest_refuses(nova: Standing, secret: str) -> None:
    """Over all routes: but for those that are open to everybody, one is not refused."""
    headers = {"X-API-Key": secret}
    for line, role in ROLES.items():
        method, _, template = line.partition(" ")
        # the routes of a virtual observatory are there on one alone
        if role is None or line == "POST /v1/solve" or " /v1/virtual" in line:
            continue
        path = re.sub(r"\{telescope_id\}", "east", template)
        path = re.sub(r"\{[a-z_]+\}", "nothing", path)
        answer = await nova.client.request(method, f"{nova.rest_url}{path}", headers=headers)
        assert (line, answer.status_code) == (line, 403)
        assert answer.json()["type"] == "urn:mountnav:problem:role-too-low"


async def _alpaca_refuses(nova: Standing, secret: str) -> None:
    """All members of a telescope, read and written."""
    for method, member in MEMBERS:
        answer = await nova.client.request(
            method,
            f"{nova.rest_url}/api/v1/telescope/0/{member}",
            headers={"X-API-Key": secret},
            data={"RightAscension": "1", "Declination": "1"} if method == "PUT" else None,
        )
        assert (method, member, answer.status_code) == (method, member, 403)


@pytest.mark.long
async def test_a_key_that_may_solve_moves_nothing_and_sees_nothing(tmp_path: Path) -> None:
    store = KeyStore(tmp_path / "keys.json")
    secrets = {role: store.new(f"the {role}", role)[1] for role in Role}
    async with standing(observatory=keyed_observatory(store.path)) as nova:
        await _rest_refuses(nova, secrets[Role.SOLVE])
        await _alpaca_refuses(nova, secrets[Role.SOLVE])
        mount = nova.service.observatory.telescope("east").bench
        assert mount is not None
        heard = getattr(mount.fake, "heard", [])
        assert not [word for word in heard if word.startswith((b":MS", b":CM", b":Mn", b":hP"))]
        # it solves by REST, but for a telescope it may not ask
        solve, solver = f"{nova.rest_url}/v1/solve", {"X-API-Key": secrets[Role.SOLVE]}
        hint = {"ra_deg": 85.1, "dec_deg": 29.95, "radius_deg": 1, "scale_low_arcsec_px": 3.8}
        hint["scale_high_arcsec_px"] = 4.2
        told = await nova.client.post(solve, params=hint, content=drawn(), headers=solver)
        assert (told.status_code, told.json()["solved"]) == (200, True)
        for telescope in ("east", "nothing"):
            asked = hint | {"telescope": telescope}
            refused = await nova.client.post(solve, params=asked, content=drawn(), headers=solver)
            assert refused.status_code == 403
            assert "gone" not in refused.text
        viewer = {"X-API-Key": secrets[Role.VIEW]}
        assert (await nova.client.post(solve, content=drawn(), headers=viewer)).status_code == 403
        # by the nova API: solve, operate and configure, but not view, nor what is no key
        for role, secret in secrets.items():
            told_of = (await nova.post("/api/login", {"apikey": secret})).json()
            assert (role, told_of["status"]) == (role, "error" if role is Role.VIEW else "success")
            if role is Role.VIEW:
                assert "role view may not solve" in told_of["errormessage"]
            else:
                assert told_of["message"] == f"authenticated user: the {role}"
        for wrong in ("mnk_x", secrets[Role.SOLVE][:-1], "", None, 5, ["x"], "x" * 100_000):
            assert (await nova.post("/api/login", {"apikey": wrong})).json()["status"] == "error"


@pytest.mark.long
async def test_sessions_and_jobs_end_with_their_key(tmp_path: Path) -> None:
    store = KeyStore(tmp_path / "keys.json")
    _, mine = store.new("mine", Role.SOLVE)
    _, other = store.new("other", Role.SOLVE)
    async with standing(observatory=keyed_observatory(store.path)) as nova:
        session = await nova.login(mine)
        job = await nova.solved(drawn(), session=session, **HINT)
        calibration = f"/api/jobs/{job}/calibration"
        stranger = await nova.login(other)
        # from one address: who shows a session is held to it
        assert (await nova.post(calibration, {"session": session})).status_code == 200
        refused = await nova.post(calibration, {"session": stranger})
        assert (refused.status_code, refused.json()["status"]) == (404, "error")
        assert (await nova.post("/api/myjobs", {"session": stranger})).json()["jobs"] == []
        assert (await nova.post("/api/myjobs", {"session": session})).json()["jobs"] == [job]
        nobody = (await nova.post(calibration, {"session": "nobody's"})).json()
        assert nobody["errormessage"] == 'no session with key "nobody\'s"'
        # another address, without a session
        owner = nova.app.submissions.of_job(job, None, "127.0.0.1").session
        owner.caller = replace(owner.caller, address="10.0.0.9")
        assert (await nova.get(calibration)).status_code == 404
        assert (await nova.post(calibration, {"session": session})).status_code == 200
        store.revoke("mine")
        assert (await nova.post(calibration, {"session": session})).json()["status"] == "error"
        again = (await nova.upload(drawn(), session=session, **HINT)).json()
        assert again["errormessage"] == f'no session with key "{session}"'
        rows = await asyncio.to_thread(
            lambda: [one for one in nova.service.journal.reader.audits() if one.face == "nova"]
        )
        assert {(one.caller, one.what, one.outcome) for one in rows} == {("mine", "solve", "taken")}


async def test_without_keys_programs_of_this_machine_alone(tmp_path: Path) -> None:
    async with standing() as nova:
        assert (await nova.post("/api/login", {"apikey": "whatever"})).json()["status"] == "success"
        form = {"request-json": json.dumps({"apikey": "x"})}
        for headers in (
            {"Origin": "https://evil.example"},
            {"Host": "evil.example"},
            {"X-Forwarded-For": "1.2.3.4"},
        ):
            answer = await nova.client.post(f"{nova.url}/api/login", data=form, headers=headers)
            assert answer.status_code == 403
        # the first key shuts it
        session = await nova.login()
        KeyStore(tmp_path / "keys.json").new("first", Role.VIEW)
        assert (await nova.post("/api/login", {"apikey": "whatever"})).json()["errormessage"] == "bad apikey"
        ended = (await nova.upload(as_fits(pixels()), session=session)).json()
        assert ended["status"] == "error"


async def test_an_open_port_takes_any_key(tmp_path: Path) -> None:
    store = KeyStore(tmp_path / "keys.json")
    _, known = store.new("known", Role.SOLVE)
    async with standing('open = true\nhost = "0.0.0.0"', keyed_observatory(store.path)) as nova:
        for key, user in (("anything", "nova 127.0.0.1"), (known, "known")):
            told = (await nova.post("/api/login", {"apikey": key})).json()
            assert told["message"] == f"authenticated user: {user}"
        # REST still asks for a key
        assert (await nova.client.get(f"{nova.rest_url}/v1/telescopes")).status_code == 401


@pytest.mark.long
async def test_a_wide_port_needs_a_key_even_if_there_are_none(tmp_path: Path) -> None:
    async with standing('host = "0.0.0.0"') as nova:
        server = nova.service.listeners._open["nova"]
        assert isinstance(server, NovaServer)
        assert (await nova.post("/api/login", {"apikey": "whatever"})).json()["errormessage"] == "bad apikey"
        _, secret = KeyStore(tmp_path / "keys.json").new("first", Role.SOLVE)
        assert (await nova.post("/api/login", {"apikey": secret})).json()["status"] == "success"
