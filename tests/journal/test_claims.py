"""Several services on one PostgreSQL: each telescope is one service's alone, as long as that lives."""

from __future__ import annotations

import pytest
from sqlalchemy import Connection, text

from mountnav.clock import utc_now
from mountnav.errors import BadSettings, JournalFailed
from mountnav.journal.claims import claim
from mountnav.journal.database import connectable, database_url
from mountnav.journal.records import Cause, Entry, EntryKind
from mountnav.journal.sql_journal import open_journal

pytestmark = pytest.mark.long


_END_OTHERS = (
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid() "
    "AND backend_type = 'client backend'"
)


def _steal(thief: Connection, telescope: str) -> None:
    """End other connections until this one has the telescope: the journal takes it back in a second."""
    while True:
        with thief.begin():
            thief.execute(text(_END_OTHERS))
        try:
            claim(thief, {telescope})
        except JournalFailed:
            continue
        return


def _note(what: str) -> Entry:
    return Entry(utc_now(), "one", EntryKind.SERVICE, what, {}, Cause())


async def test_a_telescope_is_one_service_s_alone_until_that_ends(postgresql: str) -> None:
    first = open_journal(postgresql, telescopes=frozenset({"one"}))
    other = open_journal(postgresql, telescopes=frozenset({"two"}))
    try:
        with pytest.raises(BadSettings, match="telescope 'one' is served by another service") as told:
            open_journal(
                postgresql, telescopes=frozenset({"one", "three"}), patient=True, claim_patience_s=0.0
            )
        assert ", process " in told.value.what
        assert told.value.advice == "end that one, or give this telescope another id"
        await other.note(_note("the other goes on"))
        first.close()
        # what was closed is free at once, and what was refused had taken nothing for good
        open_journal(postgresql, telescopes=frozenset({"one", "three"}), claim_patience_s=0.0).close()
    finally:
        other.close()


async def test_a_connection_that_is_lost_is_claimed_again_and_a_thief_is_told(postgresql: str) -> None:
    journal = open_journal(postgresql, telescopes=frozenset({"one"}))
    engine = connectable(database_url(postgresql), "write")
    try:
        with engine.connect() as thief:
            _steal(thief, "one")
            with pytest.raises(JournalFailed):
                await journal.note(_note("its line is gone"))
            with pytest.raises(JournalFailed, match="served by another service"):
                await journal.note(_note("and somebody else has the telescope"))
            assert journal.problem is not None
            assert "served by another service" in journal.problem
        while journal.problem is not None:
            try:
                await journal.note(_note("now it is free again"))
            except JournalFailed:
                continue
        with engine.connect() as late, pytest.raises(JournalFailed, match="served by another service"):
            claim(late, {"one"})
    finally:
        journal.close()
        engine.dispose()
