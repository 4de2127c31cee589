"""The journal over HTTP: pages, filters, looks of a telescope, and what a restart leaves."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import httpx
import pytest

from mountnav.journal.records import Cause, CommandEnd, EntryKind, Outcome
from mountnav.journal.sql_journal import open_journal
from tests.journal.samples import at, look_of, note_of, slew_of

Serve = Callable[[str], AbstractAsyncContextManager[httpx.AsyncClient]]
WINDOW = {"since": "2026-11-22T03:12:00Z", "until": "2026-11-22T03:20:00Z"}


@pytest.fixture
def toml(observatory_toml: str, tmp_path: Path) -> str:
    """An observatory with a journal in which a night stands already."""
    path = tmp_path / "night.sqlite"
    journal = open_journal(path, inline=True)

    async def write() -> None:
        for number in range(12):
            cause = Cause(job_id="job-7" if number < 3 else None)
            await journal.look(look_of(seconds=number, solved=number % 4 > 0, cause=cause))
            command = slew_of(seconds=number, cause=cause)
            await journal.begin(command)
            await journal.end(command.command_id, CommandEnd(at(number), Outcome.DONE))
            await journal.note(note_of(f"note {number}", seconds=number, kind=EntryKind.NIGHT))

    asyncio.run(write())
    journal.close()
    return f'{observatory_toml}\n[journal]\nurl = "{path}"\n'


@pytest.mark.long
async def test_the_journal_is_told_page_by_page(serving: Serve, toml: str) -> None:
    async with serving(toml) as client:
        lines: list[dict[str, object]] = []
        cursor: dict[str, str] = {}
        while True:
            answer = await client.get("/v1/journal", params={**WINDOW, "limit": 7, **cursor})
            assert answer.status_code == 200
            page = answer.json()
            assert len(page["lines"]) <= 7
            lines += page["lines"]
            if page["next_cursor"] is None:
                break
            cursor = {"cursor": page["next_cursor"]}
        assert len(lines) == 36
        assert [line["utc"] for line in lines] == sorted(str(line["utc"]) for line in lines)
        look = next(line for line in lines if line["kind"] == "look" and "seen at" in str(line["words"]))
        assert look["facts"]["seen_ra_deg"] == 120.01  # type: ignore[index]


FILTERS: list[tuple[dict[str, str | list[str]], int]] = [
    ({"kind": "command"}, 12),
    ({"kind": ["command", "night"]}, 24),
    ({"job_id": "job-7"}, 6),
    ({"outcome": "unsolved"}, 3),
    ({"telescope": "west"}, 0),
    ({"text": "NOTE 11"}, 1),
    ({"newest_first": "true"}, 36),
]
NONSENSE = [
    "kind=nonsense",
    "outcome=nonsense",
    "cursor=nonsense",
    "since=yesterday",
    "since=0001-01-01T00:00:00%2B14:00",
    "limit=0",
    "limit=1001",
]


@pytest.mark.long
async def test_filters_looks_and_questions_that_make_no_sense(serving: Serve, toml: str) -> None:
    async with serving(toml) as client:
        for params, count in FILTERS:
            answer = await client.get("/v1/journal", params={**WINDOW, **params})
            assert len(answer.json()["lines"]) == count, params
        answer = await client.get("/v1/telescopes/east/looks", params={**WINDOW, "limit": 5})
        utcs = [line["utc"] for line in answer.json()["lines"]]
        assert len(utcs) == 5
        assert utcs == sorted(utcs, reverse=True)
        assert (await client.get("/v1/telescopes/nowhere/looks")).status_code == 404
        for query in NONSENSE:
            answer = await client.get(f"/v1/journal?{query}")
            assert answer.status_code == 422, query
            assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.long
async def test_starts_of_the_service(serving: Serve, toml: str) -> None:
    for _ in range(2):
        async with serving(toml) as client:
            runs = (await client.get("/v1/journal/runs")).json()
    assert len(runs) == 3
    assert [run["ended_utc"] is None for run in runs] == [True, False, False]
    assert runs[0]["settings_sha256"] == runs[1]["settings_sha256"] != runs[2]["settings_sha256"]


@pytest.mark.long
async def test_a_job_and_its_key_outlive_the_service(serving: Serve, toml: str) -> None:
    """A retry after a restart must not slew again."""
    async with serving(toml) as client:
        stands = (await client.get("/v1/telescopes/east")).json()["icrs"]
        body = {"ra_deg": stands["ra_deg"], "dec_deg": stands["dec_deg"] - 1.0}
        first = await client.post("/v1/telescopes/east/slew", json=body, headers={"Idempotency-Key": "k"})
        assert first.status_code == 202
        done = (await client.get(f"/v1/jobs/{first.json()['id']}", params={"wait": 60})).json()
        assert done["state"] == "succeeded", done
    async with serving(toml) as client:
        again = (await client.get(f"/v1/jobs/{done['id']}")).json()
        assert (again["state"], again["result"], again["request"]) == (
            "succeeded",
            done["result"],
            done["request"],
        )
        repeated = await client.post("/v1/telescopes/east/slew", json=body, headers={"Idempotency-Key": "k"})
        assert repeated.json()["id"] == done["id"]
        lines = (await client.get("/v1/journal", params={"job_id": done["id"], "kind": "command"})).json()[
            "lines"
        ]
        assert len(lines) == 1
        assert lines[0]["facts"]["outcome"] == "done"
