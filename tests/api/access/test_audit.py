"""The audit: every order leaves a row, also a refused one and one of a stranger's; none holds a secret."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from pydantic import BaseModel
from typer.testing import CliRunner

from api.access.audit import Audit
from api.access.callers import Caller, Face, Role
from api.access.keys import KeyStore
from api.cli.journal import journal_app
from api.problems import Refused, problem
from mountnav.errors import OutsideLimits
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.journal.upkeep import Thinning
from tests.api.conftest import Serve

PATIENCE_S = 60.0
ROBOT = Caller("robot", Role.OPERATE, Face.INDI, "10.0.0.7", lease_id="a lease's secret")


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[SqlJournal]:
    """A real one."""
    opened = open_journal(tmp_path / "audit.sqlite", fsync="never")
    yield opened
    opened.close()


def rows_of(journal: SqlJournal, tmp_path: Path) -> list[AuditRow]:
    """All rows, oldest first; what waits is written before."""
    journal.close()
    return open_journal(tmp_path / "audit.sqlite").reader.audits()[::-1]


class _Order(BaseModel):
    kind: str = "slew"
    ra_deg: float = 10.5
    password: str = "hush"
    planned_s: float | None = None


def test_an_order_is_noted_with_all_that_is_known(journal: SqlJournal, tmp_path: Path) -> None:
    Audit(journal).note(ROBOT, "slew", telescope="east", request=_Order(), job_id="job-1", status=202)
    [row] = rows_of(journal, tmp_path)
    assert (row.caller, row.role, row.face, row.address) == ("robot", "operate", "indi", "10.0.0.7")
    assert (row.telescope, row.what, row.outcome) == ("east", "slew", "taken")
    assert (row.status, row.job_id) == (202, "job-1")
    assert row.request == {"kind": "slew", "ra_deg": 10.5}
    assert abs((datetime.now(UTC) - row.utc).total_seconds()) < 3600


def test_a_refused_order_tells_why(journal: SqlJournal, tmp_path: Path) -> None:
    audit = Audit(journal)
    audit.refused(ROBOT, "slew", OutsideLimits("below the horizon"), telescope="east")
    audit.refused(ROBOT, "park", Refused(problem("leased", 409, "guest holds it")), telescope="east")
    audit.refused(ROBOT, "home", ValueError("boom"), telescope="east")
    assert [(row.what, row.outcome, row.detail, row.status) for row in rows_of(journal, tmp_path)] == [
        ("slew", "outside-limits", "below the horizon", 422),
        ("park", "leased", "guest holds it", 409),
        ("home", "internal", "this should not have happened", 500),
    ]


def test_no_request_is_too_strange_to_note(journal: SqlJournal, tmp_path: Path) -> None:
    deep: dict[str, object] = {"x": 1}
    for _ in range(50):
        deep = {"deeper": deep}
    strange = {
        "nan": float("nan"),
        "long": "x" * 100_000,
        "many": list(range(100_000)),
        "deep": deep,
        "object": object(),
        "bytes": b"\xff",
        "nul": "a\0b\ud800",
        "api_key": "hush",
        "nested": {"Authorization": "hush", "lease_id": "hush", "kept": 1},
        "listed": [{"token": "hush"}],
    }
    Audit(journal).note(ROBOT, "strange", request=strange)
    [row] = rows_of(journal, tmp_path)
    text = json.dumps(row.request)
    assert "hush" not in text
    assert len(text) < 5000
    assert row.request["nan"] is None
    assert row.request["nested"] == {"kept": 1}
    assert "a lease's secret" not in str(row)


def test_a_note_that_fails_fails_no_order() -> None:
    class Broken:
        def audit_now(self, row: AuditRow) -> None:
            raise RuntimeError("no")

    Audit(Broken()).note(ROBOT, "slew", telescope="east")
    Audit(Broken()).stranger("10.0.0.1", "POST /", status=401, outcome="unauthorized")


def test_a_journal_that_fails_for_a_while_loses_no_note(tmp_path: Path) -> None:
    """It is taken away beneath the service, and comes back: all that was noted meanwhile is in it."""
    path = tmp_path / "audit.sqlite"
    journal = open_journal(path, fsync="never", inline=True)
    audit = Audit(journal)
    audit.note(ROBOT, "before")
    away = tmp_path / "away"
    hidden = [file for file in tmp_path.glob("audit.sqlite*") if file.is_file()]
    away.mkdir()
    for file in hidden:
        file.rename(away / file.name)
    path.mkdir()
    for number in range(5):
        audit.note(ROBOT, f"meanwhile {number}")
    troubles = [journal.problem]
    path.rmdir()
    for file in hidden:
        (away / file.name).rename(file)
    audit.note(ROBOT, "after")
    troubles.append(journal.problem)
    assert [trouble is None for trouble in troubles] == [False, True]
    noted = [row.what for row in journal.reader.audits()][::-1]
    journal.close()
    assert noted == ["before", *(f"meanwhile {number}" for number in range(5)), "after"]


def test_pages_go_on_where_the_last_one_ended(journal: SqlJournal, tmp_path: Path) -> None:
    audit = Audit(journal)
    for number in range(25):
        who = ROBOT if number % 5 else Caller("guest", Role.VIEW, Face.REST)
        audit.note(who, f"order {number}", telescope="east" if number % 2 else "west")
    journal.close()
    reader = open_journal(tmp_path / "audit.sqlite").reader
    found: list[AuditRow] = []
    while page := reader.audits(limit=7, before_row=found[-1].row_id if found else None):
        found += page
    assert [row.what for row in found] == [f"order {number}" for number in reversed(range(25))]
    assert [row.what for row in reader.audits(caller="guest", telescope="east")] == ["order 15", "order 5"]
    middle = found[10].utc
    assert {row.what for row in reader.audits(since=middle)} | {
        row.what for row in reader.audits(until=middle)
    } == {row.what for row in found}


def test_old_rows_go_and_nobody_can_push_his_own_out(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    journal = open_journal(path, fsync="never", inline=True)
    old = AuditRow(
        datetime(2020, 1, 1, tzinfo=UTC), "east", "robot", "operate", "rest", "", "slew", {}, "taken"
    )
    journal.audit_now(old)
    audit = Audit(journal)
    audit.note(ROBOT, "slew")
    audit.note(ROBOT, "guide")
    from mountnav.journal.database import connectable, database_url

    engine = connectable(database_url(path), "write")
    with engine.connect() as connection, connection.begin():
        assert Thinning(keep_days=100.0).step(connection)
    assert [row.what for row in journal.reader.audits()] == ["guide", "slew"]
    with engine.connect() as connection, connection.begin():
        thinning = Thinning(max_size_mb=1e-6)
        while thinning.step(connection):
            pass
    engine.dispose()
    assert [row.what for row in journal.reader.audits()] == ["audit-thinned", "slew"]
    journal.close()


@pytest.mark.long
async def test_every_changing_request_leaves_a_row_and_no_question_does(
    serving: Serve, observatory_toml: str, tmp_path: Path
) -> None:
    store = KeyStore(tmp_path / "keys.json")
    secrets = {role: store.new(f"the {role}er", role)[1] for role in Role}
    async with serving(observatory_toml) as client:

        async def send(method: str, path: str, role: Role | None, json: object = None) -> int:
            headers = {} if role is None else {"X-API-Key": secrets[role]}
            return (await client.request(method, path, headers=headers, json=json)).status_code

        below = {"ra_deg": 10.0, "dec_deg": -89.0}
        operate, configure = Role.OPERATE, Role.CONFIGURE
        assert await send("GET", "/v1/telescopes/east", Role.VIEW) == 200
        # 202: not seen at rest yet, on a machine that has other work
        assert await send("POST", "/v1/telescopes/east/stop", operate) in (200, 202)
        assert await send("POST", "/v1/telescopes/east/slew", Role.VIEW, below) == 403
        assert await send("POST", "/v1/telescopes/east/slew", operate, {"ra_deg": "x"}) == 422
        assert await send("POST", "/v1/telescopes/nowhere/stop", operate) == 404
        assert await send("POST", "/v1/telescopes/east/acknowledge", operate) == 403
        assert await send("POST", "/v1/telescopes/east/acknowledge", configure) == 200
        assert await send("POST", "/v1/nothing?x=1", configure) == 404
        for _ in range(3):
            assert await send("POST", "/v1/telescopes/east/park", None) == 401
        assert await send("GET", "/v1/audit", operate) == 403
        rows: list[dict[str, object]] = []
        async with asyncio.timeout(PATIENCE_S):
            # they are written behind the requests, which wait for none
            while len(rows) < 8:
                answer = await client.get("/v1/audit", headers={"X-API-Key": secrets[configure]})
                rows = answer.json()["rows"][::-1]
    east = "/v1/telescopes/{telescope_id}"
    assert [(row["caller"], row["what"], row["outcome"], row["status"]) for row in rows] == [
        ("the operateer", "stop", "taken", None),
        ("the viewer", f"POST {east}/slew", "role-too-low", 403),
        ("the operateer", f"POST {east}/slew", "bad-request", 422),
        ("the operateer", f"POST {east}/stop", "not-found", 404),
        ("the operateer", f"POST {east}/acknowledge", "role-too-low", 403),
        ("the configureer", f"POST {east}/acknowledge", "answered", 200),
        ("the configureer", "POST /v1/nothing", "not-found", 404),
        # a stranger is noted once a minute: he must not fill the journal
        ("(unknown)", f"POST {east}/park", "unauthorized", 401),
    ]
    assert [row["telescope"] for row in rows[:4]] == ["east", "east", "east", "nowhere"]
    assert rows[0]["role"] == "operate"
    assert rows[6]["request"] == {"query": "x=1"}
    for secret in secrets.values():
        assert secret not in answer.text
    listed = CliRunner().invoke(journal_app, ["audit", "--journal", str(tmp_path / "journal.sqlite")])
    assert len(listed.stdout.splitlines()) == 8
    assert "the viewer (rest 127.0.0.1): POST" in listed.stdout
    assert "role-too-low: the viewer" in listed.stdout


@pytest.mark.long
async def test_the_audit_is_read_a_page_at_a_time(serving: Serve, observatory_toml: str) -> None:
    async with serving(observatory_toml) as client:
        for number in range(5):
            await client.post(f"/v1/nothing/{number}")
        async with asyncio.timeout(PATIENCE_S):
            while len((await client.get("/v1/audit")).json()["rows"]) < 5:
                pass
        seen, cursor = [], None
        while True:
            params = {"limit": "2"} | ({"cursor": cursor} if cursor else {})
            page = (await client.get("/v1/audit", params=params)).json()
            seen += [row["row"] for row in page["rows"]]
            cursor = page["next_cursor"]
            if cursor is None:
                break
        assert seen == sorted(seen, reverse=True)
        assert len(seen) == 5
        for wrong in (
            {"cursor": "x"},
            {"limit": "0"},
            {"since": "0001-01-01T00:00:00+14:00"},
            {"since": "x"},
        ):
            assert (await client.get("/v1/audit", params=wrong)).status_code == 422
