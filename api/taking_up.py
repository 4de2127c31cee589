"""When a telescope's link is first up: what an earlier run left in flight, and what to tell of it."""

from __future__ import annotations

from mountnav.journal.records import Entry, EntryKind
from mountnav.journal.restart import acknowledge, take_up
from mountnav.journal.sql_journal import SqlJournal
from mountnav.navigation.checked_mount import CheckedMount
from mountnav.navigation.syncing import GuardedSync
from mountnav.sky.coordinates import utc_now

ROWS_READ = 500
"""Of syncs: more than a night has."""


class TakingUp:
    """Takes one telescope up again, once, before the first order of this run goes out.

    Parameters
    ----------
    journal : SqlJournal
    telescope_id : str

    Attributes
    ----------
    notice : str or None
        What an operator should know; until a solved look or his own word settles it.
    """

    def __init__(self, journal: SqlJournal, telescope_id: str) -> None:
        self.notice: str | None = None
        self._journal = journal
        self._telescope_id = telescope_id
        self._done = False
        self._recalled = False

    async def at_first_link(self, mount: CheckedMount, guard: GuardedSync) -> None:
        """Close what was in flight by what the mount reads, and recall what was learned of the camera.

        Raises
        ------
        DeviceError
            The mount can't be read: to be called again.
        JournalFailed
        """
        if not self._recalled:
            await self._recall(guard)
            await self._note_model(guard.pointing.model_id)
            self._recalled = True
        if not self._done:
            restart = await take_up(self._journal, self._journal.reader, self._telescope_id, mount)
            self.notice = restart.notice
            self._done = True

    def heard(self, kind: str) -> None:
        """A solved look tells where the telescope points: the notice is settled."""
        if kind == "solved":
            self.notice = None

    async def acknowledge(self, who: str) -> None:
        """An operator has seen it. Raises `JournalFailed`."""
        await acknowledge(self._journal, self._telescope_id, who)
        self.notice = None

    async def _note_model(self, model_id: str | None) -> None:
        """A change of the pointing model in force belongs to the story."""
        last = await self._journal.recent(self._telescope_id, EntryKind.MODEL, 1)
        before = last[-1].facts.get("model_id") if last else None
        if before != model_id:
            what = (
                "no pointing model is in force any more"
                if model_id is None
                else "a pointing model is in force"
            )
            facts = {"model_id": model_id, "before": before}
            await self._journal.note(Entry(utc_now(), self._telescope_id, EntryKind.MODEL, what, facts))

    async def _recall(self, guard: GuardedSync) -> None:
        syncs = await self._journal.recent(self._telescope_id, EntryKind.SYNC, ROWS_READ)
        learned = await self._journal.recent(self._telescope_id, EntryKind.LEARNED, 1)
        guard.restore(sorted((*syncs, *learned), key=lambda one: one.utc))
