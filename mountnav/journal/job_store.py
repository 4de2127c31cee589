"""Jobs kept over restarts: saved as they change, found again by their ids and by their clients' keys."""

from __future__ import annotations

from datetime import datetime
from typing import Protocol

from mountnav.errors import MountnavError
from mountnav.journal.job_rows import JobRow
from mountnav.journal.reading import COMMAND, JournalReader, Wanted
from mountnav.journal.restart import named
from mountnav.journal.sql_journal import SqlJournal


class JobKeeper(Protocol):
    """Where jobs are kept. `latest`, `find` and `last_order` block: they are called in threads."""

    async def save(self, row: JobRow) -> None:
        """Keep it; on the disk on return. Raises `JournalFailed`."""
        ...

    def save_now(self, row: JobRow) -> None:
        """Keep it, without waiting. Never raises."""
        ...

    def latest(self, count: int, since: datetime | None = None) -> list[JobRow]:
        """The last jobs, newest first. Raises `JournalFailed`."""
        ...

    def find(self, job_id: str) -> JobRow | None:
        """A job of any age. Raises `JournalFailed`."""
        ...

    def last_order(self, job_id: str) -> str:
        """What is known of the last order a job gave, in words; never raises."""
        ...


class JobStore:
    """Keeps jobs in the journal.

    Parameters
    ----------
    reader : JournalReader
        Of the same journal.
    telescopes : iterable of str
        This service's: several may share a journal.
    """

    def __init__(self, journal: SqlJournal, reader: JournalReader, telescopes: frozenset[str]) -> None:
        self._journal = journal
        self._reader = reader
        self._telescopes = telescopes

    def know(self, telescopes: frozenset[str]) -> None:
        """These are this service's from now on."""
        self._telescopes = telescopes

    async def save(self, row: JobRow) -> None:
        """Keep it; on the disk on return. Raises `JournalFailed`."""
        await self._journal.save_job(row)

    def save_now(self, row: JobRow) -> None:
        """Keep it, without waiting."""
        self._journal.save_job_now(row)

    def latest(self, count: int, since: datetime | None = None) -> list[JobRow]:
        """The last jobs of this service's telescopes, newest first. Raises `JournalFailed`."""
        return self._reader.jobs(count, telescopes=self._telescopes, since=since)

    def find(self, job_id: str) -> JobRow | None:
        """A job of any age. Raises `JournalFailed`."""
        return self._reader.job(job_id)

    def last_order(self, job_id: str) -> str:
        """What is known of the last order it gave."""
        wanted = Wanted(job_id=job_id, kinds=frozenset({COMMAND}))
        try:
            found = self._reader.commands(wanted, limit=1, newest_first=True)
        except MountnavError as error:
            return f"what it had ordered can't be read: {error.what}"
        if not found:
            return "it had ordered nothing yet"
        command, end = found[0]
        last = f"its last order was {named(command)} at {command.utc:%H:%M:%S} UTC"
        if end is None:
            return f"{last}, which may have been sent or not"
        return f"{last}: {end.outcome}{f' ({end.detail})' if end.detail else ''}"
