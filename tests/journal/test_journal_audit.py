"""Audits and leases in the journal, on SQLite and on PostgreSQL alike."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from mountnav.journal.audit_and_leases import AuditRow, LeaseRow
from mountnav.journal.sql_journal import open_journal
from tests.journal.samples import at

ROW = AuditRow(
    at(0), "east", "robot", "operate", "rest", "10.0.0.7", "slew", {"ra_deg": 1.5}, "taken", "", 202, "job-1"
)
LEASE = LeaseRow(
    "east", "robot", "operate", "rest", "10.0.0.7", "ab" * 32, "night", 30.0, "park", at(0), at(30)
)


def _the_same_everywhere(where: str | Path) -> None:
    journal = open_journal(where, fsync="never")
    for number in range(4):
        journal.audit_now(replace(ROW, utc=at(number), telescope="east" if number % 2 else "west"))
    later = replace(LEASE, deadline_utc=at(60))
    other = replace(LEASE, holder="guest", secret_sha256="cd" * 32)

    async def leases() -> None:
        await journal.save_lease(LEASE)
        assert journal.reader.leases(frozenset({"east", "west"})) == [LEASE]
        assert journal.reader.leases(frozenset({"west"})) == []
        journal.save_lease_now(later)
        # the end of a lease that was broken doesn't end the one that took its place
        await journal.save_lease(other)
        journal.end_lease_now("east", LEASE.secret_sha256)
        await journal.save_lease(replace(other, telescope="west"))
        assert journal.reader.leases(frozenset({"east"})) == [other]
        journal.end_lease_now("east", other.secret_sha256)

    asyncio.run(leases())
    journal.close()
    reader = open_journal(where).reader
    assert reader.leases(frozenset({"east"})) == []
    rows = reader.audits()
    assert [row.utc for row in rows] == [at(number) for number in (3, 2, 1, 0)]
    assert replace(rows[0], row_id=0) == replace(ROW, utc=at(3), telescope="east")
    assert [row.utc for row in reader.audits(telescope="west")] == [at(2), at(0)]
    assert [row.utc for row in reader.audits(since=at(1), until=at(2) + timedelta(microseconds=1))] == [
        at(2),
        at(1),
    ]
    assert reader.audits(caller="nobody") == []
    assert [row.utc for row in reader.audits(before_row=rows[1].row_id, limit=1)] == [at(1)]


def test_audits_and_leases_in_a_file(tmp_path: Path) -> None:
    _the_same_everywhere(tmp_path / "journal.sqlite")


@pytest.mark.long
def test_audits_and_leases_on_a_server(postgresql: str) -> None:
    _the_same_everywhere(postgresql)
