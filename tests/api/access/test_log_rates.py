"""What strangers can have logged and written down is bounded, whoever writes it and whatever it says."""

from __future__ import annotations

import asyncio
import io
import logging
from collections.abc import Iterator

import pytest

from api.access.audit import EACH_S, Audit, AuditedRequests, Seldom, Unnoted
from api.access.callers import Caller, Face, Role
from api.access.log_rates import KnownCallers, RateLimitedLog
from api.problems import Refused, problem
from mountnav.journal.audit_and_leases import AuditRow


class Clock:
    """Stands still until it is set."""

    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Log:
    """A logger of its own and what its handler wrote."""

    def __init__(self, name: str, clock: Clock) -> None:
        self.text = io.StringIO()
        self.handler = logging.StreamHandler(self.text)
        self.handler.addFilter(RateLimitedLog(clock))
        self.logger = logging.getLogger(name)
        self.logger.setLevel(logging.INFO)
        self.logger.addHandler(self.handler)

    @property
    def lines(self) -> list[str]:
        return self.text.getvalue().splitlines()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(params=["a test of sparing", "uvicorn.access"])
def log(request: pytest.FixtureRequest, clock: Clock) -> Iterator[Log]:
    made = Log(request.param, clock)
    yield made
    made.logger.removeHandler(made.handler)


def _say(log: Log, text: str) -> None:
    log.logger.warning("somebody said %s", text)


@pytest.mark.long
def test_one_place_fills_no_log_and_hides_no_other_place(
    log: Log, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(10_000):
        _say(log, str(number))
    written = len(log.lines)
    assert 20 <= written <= 120
    log.logger.error("something else")
    assert log.lines[-1] == "something else"
    clock.now_s += EACH_S
    caplog.clear()
    _say(log, "again")
    assert log.lines[-1] == "somebody said again"
    assert len(log.lines) == written + 2
    counted = [text for text in caplog.messages if "not written" in text]
    assert len(counted) == 1
    assert counted[0].startswith(f"{10_000 - written} more lines like those of {log.logger.name}")


def test_what_is_said_makes_one_line_of_bounded_length(log: Log, clock: Clock) -> None:
    log.handler.addFilter(RateLimitedLog(clock))  # as if another handler had it before
    _say(log, "a\r\nERROR: all is lost\x1b[2J" + "x" * 8000)
    (line,) = log.lines
    assert "a\\x0d\\x0aERROR: all is lost\\x1b[2Jxx" in line
    assert line.endswith("(8025 characters)")
    assert len(line) < 1000
    log.logger.warning("%d of %5.1f %s", 3, 2.25, None)
    assert log.lines[-1] == "3 of   2.2 None"


@pytest.mark.parametrize(("is_known", "lines"), [(True, 1000), (False, 120)])
async def test_requests_of_those_who_show_a_key_are_all_logged(
    clock: Clock, is_known: bool, lines: int
) -> None:
    access = Log("uvicorn.access", clock)

    def shows_who(_: object) -> Caller:
        if is_known:
            return Caller("a program", Role.VIEW, Face.REST)
        raise Refused(problem("unauthorized", 401, "no key came with the request"))

    async def answer(*_: object) -> None:
        access.logger.info('%s - "%s %s HTTP/%s" %d', "10.0.0.1:5", "GET", "/" + "y" * 8000, "1.1", 401)

    app = KnownCallers(answer, shows_who)
    try:
        for _ in range(1000):
            # a task for each, as the server makes them
            await asyncio.create_task(app({"type": "http"}, None, None))  # type: ignore[arg-type]
    finally:
        access.logger.removeHandler(access.handler)
    assert len(access.lines) == lines
    assert len(access.lines[0]) < 1000


def test_notes_are_due_so_often_and_what_was_not_is_counted(clock: Clock) -> None:
    seldom = Seldom(2, 5, clock)
    assert [seldom.due("a") for _ in range(4)] == [Unnoted(), Unnoted(), None, None]
    assert [seldom.due(key) is None for key in "bcde"] == [False, False, False, True]
    clock.now_s += EACH_S
    assert seldom.due("a") == Unnoted(same=2)
    assert seldom.due("e") == Unnoted(same=1)
    # who is forgotten is counted among the others
    seldom = Seldom(1, 10, clock)
    for number in range(3000):
        seldom.due(number)
    clock.now_s += EACH_S
    found = seldom.due("new")
    assert found is not None
    assert found.others >= 1900


class Kept:
    """What would be written down."""

    def __init__(self) -> None:
        self.rows: list[AuditRow] = []

    def audit_now(self, row: AuditRow) -> None:
        self.rows.append(row)


async def test_strangers_from_many_addresses_do_not_fill_the_journal(clock: Clock) -> None:
    kept = Kept()
    audit = Audit(kept)

    async def app(scope: object, receive: object, send: object) -> None:
        await send({"type": "http.response.start", "status": 401, "headers": []})  # type: ignore[operator]

    async def nowhere(_: object) -> None: ...

    def nobody(_: object) -> Caller:
        raise Refused(problem("unauthorized", 401, "no key came with the request"))

    audited = AuditedRequests(app, lambda: audit, nobody, clock_s=clock)
    for number in range(5000):
        scope = {"type": "http", "method": "POST", "path": "/v1/stop", "client": (f"2001:db8::{number:x}", 1)}
        await audited(scope, nowhere, nowhere)  # type: ignore[arg-type]
    assert len(kept.rows) == 60


@pytest.mark.parametrize("face", [Face.LX200, Face.INDI, Face.STELLARIUM, Face.ALPACA])
def test_refusals_of_faces_without_keys_do_not_fill_the_journal(face: Face) -> None:
    kept = Kept()
    audit = Audit(kept)
    refusal = Refused(problem("outside-limits", 422, "below the lowest altitude"))
    for number in range(5000):
        caller = Caller(f"a client {number}", Role.OPERATE, face, f"10.0.0.{number % 2}")
        audit.refused(caller, "slew", refusal, request={"ra_deg": 1.0})
        if number < 100:
            audit.note(caller, "slew", request={"ra_deg": 1.0})
    refused = [row for row in kept.rows if row.outcome != "taken"]
    assert len(refused) == 40
    assert len(kept.rows) == 140


def test_stops_without_end_are_all_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept()
    audit = Audit(kept)
    caller = Caller("lx200 10.0.0.1", Role.OPERATE, Face.LX200, "10.0.0.1")
    for number in range(1000):
        monkeypatch.setattr("api.access.audit.EACH_S", 0.0 if number == 999 else 60.0)
        audit.note(caller, "stop")
    assert len(kept.rows) == 21
    assert kept.rows[-1].request == {"more_since_the_last_note": 979}


def test_refusals_by_rest_are_all_noted() -> None:
    kept = Kept()
    audit = Audit(kept)
    refusal = Refused(problem("outside-limits", 422, "below the lowest altitude"))
    for _ in range(100):
        audit.refused(Caller("a program", Role.OPERATE, Face.REST, "10.0.0.1"), "slew", refusal)
    assert len(kept.rows) == 100
