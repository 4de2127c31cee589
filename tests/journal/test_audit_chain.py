"""The audit's chain: whatever a stranger does to its rows is found, and the first row of it is named."""

from __future__ import annotations

import json
import os
import sqlite3
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import insert, text
from typer.testing import CliRunner

from api.cli.journal import journal_app
from mountnav.journal import upkeep
from mountnav.journal.audit_and_leases import AuditRow, audit_values
from mountnav.journal.audit_chain import (
    AuditHead,
    AuditKey,
    AuditProof,
    open_audit_key,
    prove,
    row_sha256,
)
from mountnav.journal.database import connectable, database_url
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.journal.tables import audit
from mountnav.journal.upkeep import Thinning
from tests.journal.samples import at

KEY = AuditKey(b"k" * 32)
ODD = {
    "words": "\u00e9\u2028\ud800\x00\U0001f600",
    "ra": 1e-300,
    "nan": float("nan"),
    "huge": 2**70,
    "minus": -0.0,
    "deep": [[[[{"b": 1, "a": (1, 2.5, None, True)}]]]],
    "when": at(1),
}
ROW = AuditRow(at(0), "east", "robot", "operate", "rest", "::1", "slew", ODD, "taken", "n\u00e4", 202, "job")


def write(where: str | Path, numbers: range, key: AuditKey | None = KEY) -> None:
    journal = open_journal(where, fsync="never", audit_key=key, inline=True)
    for number in numbers:
        what = "guide" if number % 3 == 0 else "slew"
        journal.audit_now(replace(ROW, utc=at(number), what=what, job_id=f"job-{number}"))
    journal.close()


def proof(where: str | Path, *expected: AuditHead, keys: tuple[AuditKey, ...] = (KEY,)) -> AuditProof:
    return prove(database_url(where), keys, expected)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine rows of a service with a key."""
    path = tmp_path_factory.mktemp("chain") / "journal.sqlite"
    write(path, range(9))
    return path


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    path = tmp_path / "journal.sqlite"
    with closing(sqlite3.connect(whole)) as source, closing(sqlite3.connect(path)) as target:
        source.backup(target)
    return path


def test_a_chain_that_nobody_touched_holds(whole: Path) -> None:
    found = proof(whole)
    assert (found.rows, found.sealed, found.fault, found.unproven) == (9, 9, None, ())
    assert found.head is not None
    assert found.head.chain_no == 9
    assert open_journal(whole, audit_key=KEY).reader.audit_head() == found.head
    # without the key the chain holds as well, and nothing is proven
    bare = proof(whole, keys=())
    assert (bare.fault, bare.sealed) == (None, 0)
    assert bare.unproven == ("rows 1 to 9", "the head of the chain, at 9 to 9")


def _sql(*statements: str) -> Callable[[sqlite3.Connection], None]:
    def run(connection: sqlite3.Connection) -> None:
        for statement in statements:
            connection.execute(statement)

    return run


def _rehashed(connection: sqlite3.Connection) -> None:
    """Somebody who knows the program changes row 5 and makes all hashes behind it again."""
    connection.execute("UPDATE audit SET caller = 'guest' WHERE row_id = 5")
    connection.row_factory = sqlite3.Row
    before = "0" * 64
    for row in connection.execute("SELECT * FROM audit ORDER BY chain_no").fetchall():
        before = row_sha256(before, row["chain_no"], dict(row))
        connection.execute("UPDATE audit SET sha256 = ? WHERE row_id = ?", (before, row["row_id"]))
    connection.execute("UPDATE audit_head SET sha256 = ?", (before,))


def _closed_up(connection: sqlite3.Connection) -> None:
    """Row 4 taken out, the numbers behind it moved up, the hashes made again."""
    connection.execute("DELETE FROM audit WHERE row_id = 4")
    for number in range(5, 10):
        connection.execute("UPDATE audit SET chain_no = ? WHERE row_id = ?", (number - 1, number))
    connection.execute("UPDATE audit_head SET chain_no = 8")
    _rehashed(connection)


_SWAP = "UPDATE audit SET {0} = (SELECT other.{0} FROM audit AS other WHERE other.row_id = 9 - audit.row_id)"


@pytest.mark.parametrize(
    ("touch", "row", "words"),
    [
        (_sql("UPDATE audit SET caller = 'guest' WHERE row_id = 5"), 5, "altered"),
        (_sql("UPDATE audit SET utc = '2020-01-01 00:00:00.000000' WHERE row_id = 1"), 1, "altered"),
        (_sql("UPDATE audit SET utc = 'yesterday' WHERE row_id = 2"), 2, "altered"),
        (_sql("UPDATE audit SET request = '{' WHERE row_id = 3"), 3, "altered"),
        (_sql("UPDATE audit SET status = x'ff' WHERE row_id = 3"), 3, "altered"),
        (_sql("UPDATE audit SET job_id = NULL WHERE row_id = 9"), 9, "altered"),
        (_rehashed, 5, "altered, and its hash made again"),
        (_closed_up, 5, "altered, and its hash made again"),
        (_sql("DELETE FROM audit WHERE row_id = 4"), 5, "1 row before it was removed (number 4)"),
        (_sql("DELETE FROM audit WHERE row_id < 4"), 4, "3 rows before it were removed (numbers 1 to 3)"),
        (_sql("DELETE FROM audit WHERE row_id > 7"), None, "rows 8 to 9 were removed from the end"),
        (_sql("DELETE FROM audit"), None, "rows 1 to 9 were removed from the end"),
        (
            _sql(
                "DELETE FROM audit WHERE row_id > 7",
                "UPDATE audit_head SET chain_no = 7, sha256 = (SELECT sha256 FROM audit WHERE row_id = 7)",
            ),
            None,
            "the head was altered",
        ),
        (_sql("DELETE FROM audit_head"), None, "the head of the chain is missing"),
        (
            _sql(
                "INSERT INTO audit SELECT 100, run_id, utc, telescope, caller, role, face, address, what, "
                "request, outcome, detail, status, job_id, NULL, NULL, NULL FROM audit WHERE row_id = 2"
            ),
            100,
            "inserted",
        ),
        (
            _sql(
                "INSERT INTO audit SELECT 100, run_id, utc, telescope, caller, role, face, address, what, "
                "request, outcome, detail, status, job_id, 10, sha256, seal FROM audit WHERE row_id = 2"
            ),
            100,
            "altered, inserted or reordered",
        ),
        (
            _sql(
                "DROP INDEX audit_by_chain",
                "INSERT INTO audit SELECT 100, run_id, utc, telescope, caller, role, face, address, what, "
                "request, outcome, detail, status, job_id, chain_no, sha256, seal FROM audit "
                "WHERE row_id = 3",
            ),
            100,
            "its number in the chain is taken",
        ),
        (
            _sql(
                "UPDATE audit SET chain_no = -chain_no WHERE row_id IN (4, 5)",
                "UPDATE audit SET chain_no = 9 + chain_no WHERE row_id IN (4, 5)",
            ),
            5,
            "altered, inserted or reordered",
        ),
        (
            _sql(
                "UPDATE audit SET row_id = 1000 WHERE row_id = 4",
                "UPDATE audit SET row_id = 4 WHERE row_id = 5",
                "UPDATE audit SET row_id = 5 WHERE row_id = 1000",
            ),
            4,
            "reordered",
        ),
        (
            _sql(
                "INSERT INTO audit_gap SELECT 4, 4, sha256, 'retention', utc, run_id, seal FROM audit "
                "WHERE row_id = 4",
                "DELETE FROM audit WHERE row_id = 4",
            ),
            5,
            "removed, and not by the service",
        ),
    ],
)
def test_the_first_row_that_was_touched_is_named(
    copy: Path, touch: Callable[[sqlite3.Connection], None], row: int | None, words: str
) -> None:
    with closing(sqlite3.connect(copy)) as connection:
        touch(connection)
        connection.commit()
    fault = proof(copy).fault
    assert fault is not None
    assert (fault.row_id, words in fault.what) == (row, True), fault


def test_an_old_copy_in_its_place_is_found_by_what_the_log_told(copy: Path, tmp_path: Path) -> None:
    """Seals and all: nothing in the file itself can tell."""
    old = tmp_path / "old.sqlite"
    with closing(sqlite3.connect(copy)) as source, closing(sqlite3.connect(old)) as target:
        source.backup(target)
    write(copy, range(9, 12))
    head = proof(copy).head
    assert head is not None
    assert proof(old).fault is None
    fault = proof(old, head).fault
    assert fault is not None
    assert "rows 10 to 12 were removed from the end" in fault.what
    assert proof(copy, head).fault is None
    other = proof(copy, AuditHead(3, "0" * 64)).fault
    assert other is not None
    assert other.row_id == 3


def test_retention_leaves_gaps_that_hold_and_says_so(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the middle (guide pulses), then from the beginning; gaps that meet become one."""
    monkeypatch.setattr(upkeep, "_AT_ONCE", 2)
    engine = connectable(database_url(copy), "write")

    def thin(thinning: Thinning) -> None:
        more = True
        while more:
            with engine.begin() as connection:
                more = thinning.step(connection)

    monkeypatch.setattr(upkeep, "utc_now", lambda: at(10))
    thin(Thinning(0.0, 1e-9, KEY, "run"))
    after = proof(copy)
    # numbers 1, 4 and 7 were pulses; a row tells of it
    assert (after.fault, after.rows, after.removed, after.unproven) == (None, 7, 3, ())
    assert after.head is not None
    assert after.head.chain_no == 10
    days = ((at(10) - at(5)).total_seconds() + 0.5) / 86_400.0
    thin(Thinning(days, 0.0, KEY, "run"))
    after = proof(copy)
    assert (after.fault, after.rows, after.removed) == (None, 5, 6)
    with closing(sqlite3.connect(copy)) as connection:
        gaps = connection.execute("SELECT first_no, last_no FROM audit_gap ORDER BY first_no").fetchall()
        told = connection.execute("SELECT request FROM audit WHERE what = 'audit-thinned'").fetchall()
        assert gaps == [(1, 5), (7, 7)]
        assert [json.loads(row[0])["rows"] for row in told] == [3, 3]
        # a gap made wider by hand, over a row that is taken out
        connection.execute("UPDATE audit_gap SET last_no = 6 WHERE first_no = 1")
        connection.execute("DELETE FROM audit WHERE chain_no = 6")
        connection.commit()
    fault = proof(copy).fault
    assert fault is not None
    assert "removed, and not by the service" in fault.what
    engine.dispose()


def test_a_clock_set_ahead_empties_no_journal(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [at(10)]
    monkeypatch.setattr(upkeep, "utc_now", lambda: now[0])
    thinning = Thinning(30.0, 0.0, KEY, "run", clock_s=lambda: float(len(now)) * 1e9)
    engine = connectable(database_url(copy), "write")
    with engine.begin() as connection:
        assert not thinning.step(connection)
    now.insert(0, at(0) + timedelta(days=4000))
    with engine.begin() as connection:
        assert not thinning.step(connection)
    engine.dispose()
    assert proof(copy).rows == 9


def _old_journal(path: str | Path, rows: int) -> None:
    """A journal of version 3 with an audit."""
    open_journal(path).close()
    engine = connectable(database_url(path), "write")
    with engine.begin() as connection:
        connection.execute(text("DROP INDEX audit_by_chain"))
        for column in ("chain_no", "sha256", "seal"):
            connection.execute(text(f"ALTER TABLE audit DROP COLUMN {column}"))
        connection.execute(text("DROP TABLE audit_head"))
        connection.execute(text("DROP TABLE audit_gap"))
        connection.execute(text("UPDATE alembic_version SET version_num = '0003'"))
        columns = [
            column.name for column in audit.columns if column.name not in ("chain_no", "sha256", "seal")
        ]
        for number in range(rows):
            values = audit_values(replace(ROW, utc=at(number)), "before")
            named = {name: values[name] for name in columns if name != "row_id"}
            connection.execute(insert(audit).values(named))
    engine.dispose()


def test_an_old_journal_is_chained_as_it_is_found(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    _old_journal(path, 3)
    with closing(sqlite3.connect(path)) as connection:
        # what an odd disk may have left there must not keep the service from starting
        connection.execute("UPDATE audit SET request = '{', utc = 'never' WHERE row_id = 2")
        connection.commit()
    write(path, range(3, 5))
    found = proof(path)
    assert (found.fault, found.rows, found.sealed, found.unproven) == (None, 5, 2, ("rows 1 to 3",))
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE audit SET caller = 'x' WHERE row_id = 2")
        connection.commit()
    fault = proof(path).fault
    assert fault is not None
    assert fault.row_id == 2


def _many_writers(where: str | Path) -> None:
    """Two services, each with two threads, on one journal."""
    journals = [open_journal(where, fsync="never", audit_key=key) for key in (KEY, AuditKey(b"o" * 32))]

    def note(journal: SqlJournal) -> None:
        for number in range(40):
            journal.audit_now(replace(ROW, utc=at(number)))

    threads = [threading.Thread(target=note, args=(journal,)) for journal in journals * 2]
    for thread in threads:
        thread.start()
    running = proof(where, keys=(KEY, AuditKey(b"o" * 32)))
    assert running.fault is None
    for thread in threads:
        thread.join()
    for journal in journals:
        journal.close()
    found = proof(where, keys=(KEY, AuditKey(b"o" * 32)))
    assert (found.fault, found.rows, found.sealed, found.unproven) == (None, 160, 160, ())
    assert proof(where).sealed == 80


def test_two_services_write_one_file(tmp_path: Path) -> None:
    _many_writers(tmp_path / "journal.sqlite")


@pytest.mark.long
def test_two_services_write_one_server(postgresql: str) -> None:
    engine = connectable(database_url(postgresql), "write")

    def emptied() -> None:
        with engine.begin() as connection:
            connection.execute(text("DROP SCHEMA public CASCADE"))
            connection.execute(text("CREATE SCHEMA public"))

    emptied()
    try:
        _many_writers(postgresql)
        with engine.begin() as connection:
            connection.execute(text("UPDATE audit SET caller = 'guest' WHERE row_id = 17"))
        fault = proof(postgresql).fault
        assert fault is not None
        assert fault.row_id == 17
        emptied()
        # rows of before are chained there as in a file, and read back the same
        _old_journal(postgresql, 3)
        write(postgresql, range(3, 5))
        found = proof(postgresql)
        assert (found.fault, found.rows, found.sealed, found.unproven) == (None, 5, 2, ("rows 1 to 3",))
    finally:
        # other tests have the same server
        emptied()
        engine.dispose()


@pytest.fixture
def key_file(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "state"
    yield folder / "audit.key"
    folder.chmod(0o700)


def test_the_key_is_made_once_for_its_owner_alone(key_file: Path) -> None:
    made: list[AuditKey | None] = []
    threads = [threading.Thread(target=lambda: made.append(open_audit_key(key_file))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({one.id for one in made if one is not None}) == 1
    assert stat.S_IMODE(key_file.stat().st_mode) == 0o600
    assert [one.name for one in key_file.parent.iterdir()] == ["audit.key"]
    key_file.write_bytes(b"half")
    assert open_audit_key(key_file) is None
    assert key_file.read_bytes() == b"half"


def test_the_command_line_proves_and_names(copy: Path, tmp_path: Path) -> None:
    key = tmp_path / "audit.key"
    key.write_text((b"k" * 32).hex(), "ascii")
    runner = CliRunner()

    def run(*words: str) -> tuple[int, str]:
        result = runner.invoke(journal_app, ["verify-audit", "--journal", str(copy), *words])
        return result.exit_code, result.output

    code, told = run()
    assert (code, "nothing was altered" in told, "it is now at 9:" in told) == (0, True, True)
    head = json.loads(run("--json")[1])["head"]
    assert run("--expect", head)[0] == 0
    assert run("--expect", "10:" + "0" * 64)[0] == 1
    assert run("--expect", "soon")[0] != 0
    with closing(sqlite3.connect(copy)) as connection:
        connection.execute("UPDATE audit SET caller = 'guest' WHERE row_id = 6")
        connection.commit()
    code, told = run()
    assert (code, told.startswith("BROKEN: row 6 (number 6): it was altered")) == (1, True)
    os.unlink(key)
    code, told = run()
    assert (code, "no key is available" in told) == (1, True)
    assert datetime.now(UTC) > at(0)


def test_looks_and_audits_may_be_kept_for_other_times(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upkeep, "utc_now", lambda: at(0) + timedelta(days=50))
    engine = connectable(database_url(copy), "write")
    for thinning, left in (
        (Thinning(1.0, 0.0, KEY, "run", audit_keep_days=0.0), 9),
        (Thinning(1.0, 0.0, KEY, "run", audit_keep_days=60.0), 9),
        (Thinning(0.0, 0.0, KEY, "run", looks_keep_days=1.0), 9),
        (Thinning(0.0, 0.0, KEY, "run", audit_keep_days=40.0), 1),
    ):
        assert thinning.wanted
        more = True
        while more:
            with engine.begin() as connection:
                more = thinning.step(connection)
        assert proof(copy).rows == left
    assert not Thinning(0.0, 0.0, audit_keep_days=0.0).wanted
    engine.dispose()
