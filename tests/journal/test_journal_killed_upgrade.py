"""kill -9 at each step of an upgrade, of each older version: nothing is lost, and the audit's chain holds."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import create_engine

import mountnav.journal
from mountnav.errors import BadSettings
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.journal.audit_chain import open_audit_key, prove
from mountnav.journal.database import database_url
from mountnav.journal.sql_journal import open_journal
from mountnav.journal.tables import HEAD
from mountnav.journal.upkeep import check
from tests.journal.samples import at

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
VERSION_1 = Path(__file__).with_name("version_1.sql")
AUDITS = 5
"""Rows of the audit in an old journal that has one."""


def old_journal(path: Path, version: str) -> None:
    """A journal as a mountnav of this version left it, with rows in what it had."""
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(VERSION_1.read_text(encoding="utf-8"))
    engine = create_engine(f"sqlite:///{path}")
    with engine.begin() as connection:
        config = Config()
        config.set_main_option("script_location", str(Path(mountnav.journal.__path__[0]) / "migrations"))
        config.attributes["connection"] = connection
        command.upgrade(config, version)
    engine.dispose()
    if version < "0003":
        return
    with closing(sqlite3.connect(path)) as connection:
        for number in range(AUDITS):
            row = {
                "run_id": "old",
                "utc": f"2026-11-22 03:1{number}:00.000000",
                "telescope": "east",
                "caller": "me",
                "role": "operate",
                "face": "rest",
                "address": "",
                "what": "slew",
                "request": "{}",
                "outcome": "taken",
                "detail": "",
            }
            names = [line[1] for line in connection.execute("PRAGMA table_info(audit)")]
            known = {name: row[name] for name in names if name in row}
            connection.execute(
                f"INSERT INTO audit ({', '.join(known)}) VALUES ({', '.join('?' * len(known))})",
                tuple(known.values()),
            )
        connection.commit()


def killed(path: Path, step: int) -> int:
    """Upgrade in a child that dies at a step; its exit code."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.journal.killed_upgrade", str(path), str(step)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode in (0, -signal.SIGKILL), done.stderr
    return done.returncode


def version_of(path: Path) -> str:
    with closing(sqlite3.connect(path)) as connection:
        return str(connection.execute("SELECT version_num FROM alembic_version").fetchone()[0])


def require_whole(path: Path, version: str) -> None:
    """Open it as a service does, write on, and have all of it and its audit proven."""
    key = open_audit_key(path.with_name("audit.key"))
    assert key is not None
    journal = open_journal(path, audit_key=key)
    journal.audit_now(AuditRow(at(0), "east", "me", "operate", "rest", "", "slew", {}, "taken"))
    journal.close()
    found = check(database_url(path))
    assert (found.version, found.damage) == (HEAD, ())
    assert (found.rows["look"], found.rows["command"]) == (2, 2)
    proof = prove(database_url(path), [key], [])
    assert proof.fault is None
    assert proof.rows == 1 + (AUDITS if version >= "0003" else 0)


@pytest.mark.parametrize("version", ["0001", "0002", "0003"])
def test_an_upgrade_that_is_killed_is_as_if_it_had_not_begun_or_as_done(tmp_path: Path, version: str) -> None:
    old = tmp_path / "old.sqlite"
    old_journal(old, version)
    whole = tmp_path / "whole.sqlite"
    shutil.copy(old, whole)
    told = subprocess.run(
        [sys.executable, "-m", "tests.journal.killed_upgrade", str(whole), "0"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    steps = int(told.stdout)
    assert steps > 3
    # in the midst of it, and at its commit; of the oldest at the first change as well
    for step in sorted({steps // 2, steps, *((1, steps - 1) if version == "0001" else ())}):
        path = tmp_path / f"{step}" / "journal.sqlite"
        path.parent.mkdir()
        shutil.copy(old, path)
        assert killed(path, step) == -signal.SIGKILL
        assert version_of(path) in (version, HEAD)
        require_whole(path, version)


def test_a_downgrade_is_refused_until_the_backup_of_before_is_put_back(tmp_path: Path) -> None:
    """An older mountnav refuses what a newer one has written, and reads its own backup."""
    from mountnav.journal.backup import back_up, restore

    path = tmp_path / "journal.sqlite"
    old_journal(path, "0003")
    backup = back_up(path, tmp_path / "before.sqlite", at(0))
    require_whole(path, "0003")
    with closing(sqlite3.connect(path)) as connection:
        # as a version that is not yet written would leave it
        connection.execute("UPDATE alembic_version SET version_num = '0005'")
        connection.commit()
    with pytest.raises(BadSettings, match="newer mountnav"):
        open_journal(path)
    kept = restore(backup, path, at(1))
    assert kept is not None
    require_whole(path, "0003")
