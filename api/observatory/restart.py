"""When a telescope's link is first up: what an earlier run left in flight, and what to tell of it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping

from api.observatory.dead_man import MountGuard
from mountnav.clock import utc_now
from mountnav.errors import DeviceError, JournalFailed
from mountnav.journal.reading import COMMAND, JournalReader, Wanted
from mountnav.journal.records import CommandRecord, Entry, EntryKind, Outcome
from mountnav.journal.restart import acknowledge, take_up
from mountnav.journal.sql_journal import SqlJournal
from mountnav.mount import CheckedMount, LeftGoing, SelfActing, left_going
from mountnav.mount.pier_side import SIDE_PROVEN
from mountnav.mount.trust import ACCEPTED, ADVICE, LastSeen, seen_of
from mountnav.navigation.rates_kept import RATES_KEPT, RatesKept
from mountnav.navigation.rotator import CheckedRotator
from mountnav.navigation.sync import GuardedSync
from mountnav.tasks import fault_words

_log = logging.getLogger(__name__)

_FAULT_ADVICE = "mountnav tries again by itself, and stops are taken; the service's log has more"
LESSONS_READ = 1000
"""Of what was learned: one row of the camera each ten looks, and those of the mount's rates between them.
Halved, a correction of rates is forgotten after 5,000 looks."""
_ORDERS_READ = 40
"""So many of the latest orders of a kind tell what is in force; those that were refused don't. Halved, twenty
refusals one after the other hide an order."""
ROWS_READ = 500
"""Of syncs: more than a night has."""


class Restart:
    """Takes one telescope up again, once, before the first order of this run goes out.

    Parameters
    ----------
    outlives : bool
        Whether the mount goes on while the service is down; a fake that the service runs itself doesn't, and
        begins again each time.

    Attributes
    ----------
    notice : str or None
        What an operator should know; until a solved look or his own word settles it.
    distrust : str or None
        Why the mount isn't trusted since the restart; until it is.
    fault : str or None
        What keeps it from being taken up besides its link and the journal: a fault of ours, which is tried
        again. What was remembered of it isn't known so long, so its position doesn't count and it is refused.
    guard : MountGuard or None
        Whose reports of earlier runs are told.
    tell : callable or None
        Told ``dead-man``, with what the guard of an earlier run has done.
    """

    def __init__(self, journal: SqlJournal, telescope_id: str, *, outlives: bool = True) -> None:
        self.guard: MountGuard | None = None
        self.tell: Callable[[str, dict[str, object]], None] | None = None
        self.notice: str | None = None
        self.distrust: str | None = None
        self.fault: str | None = None
        self._outlives = outlives
        self._journal = journal
        self._telescope_id = telescope_id
        self._done = False
        self._recalled = False

    async def at_first_link(
        self,
        mount: CheckedMount,
        guard: GuardedSync,
        rates: RatesKept,
        rotator: CheckedRotator | None = None,
    ) -> None:
        """Close what was in flight by what the mount reads; recall what was learned of camera and rates.

        Raises
        ------
        DeviceError
            The mount can't be read: to be called again.
        JournalFailed
            Also for a fault of ours: to be called again.
        """
        try:
            await self._take_up(mount, guard, rates, rotator)
        except (DeviceError, JournalFailed):
            raise
        except Exception as fault:
            raise self._faulted(mount, fault) from fault
        self.fault = None

    async def _take_up(
        self,
        mount: CheckedMount,
        guard: GuardedSync,
        rates: RatesKept,
        rotator: CheckedRotator | None,
    ) -> None:
        if not self._recalled:
            await self._recall(mount, guard, rates)
            await self._recall_rotator(rotator)
            await self._note_model(guard.pointing.model_id)
            self._recalled = True
        if not self._done:
            await self._meet_again(mount)
            restart = await take_up(self._journal, self._journal.reader, self._telescope_id, mount)
            self.notice = restart.notice
            self._done = True

    def _faulted(self, mount: CheckedMount, fault: Exception) -> JournalFailed:
        """Nobody knows what the last run knew of it: less than that is not trusted."""
        words = f"what an earlier run left of it can't be taken up: {fault_words(fault)}"
        if words != self.fault:
            self.fault = words
            _log.error("%s: %s", self._telescope_id, words, exc_info=fault)
            mount.distrust(words)
        return JournalFailed(words, device=self._telescope_id, advice=_FAULT_ADVICE)

    async def _meet_again(self, mount: CheckedMount) -> None:
        """Trust the mount no more than the last run did, and not if it stands elsewhere than it was left."""
        last, in_flight, left = None, list[CommandRecord](), dict[SelfActing, LeftGoing]()
        if self._outlives:
            reader, own = self._journal.reader, self._journal.run_id
            await self._tell_of_guards()
            left = await asyncio.to_thread(self._left)
            last = await asyncio.to_thread(last_seen, reader, self._telescope_id)
            in_flight = await asyncio.to_thread(reader.in_flight, self._telescope_id, but_run=own)
        why = await mount.take_up(last, in_flight, left)
        if why is None and not mount.trusted and self.fault is not None:
            why = self.fault
        if why is not None:
            self.distrust = f"its position can't be trusted: {why}. Let it look (recover), or home it"

    def _left(self) -> dict[SelfActing, LeftGoing]:
        """What an earlier run has left going."""
        reader, own = self._journal.reader, self._journal.run_id
        rates, axes = (
            reader.latest_of(order, self._telescope_id, but_run=own, limit=_ORDERS_READ)
            for order in ("offset-rates", "move-axis")
        )
        return left_going(rates, axes)

    async def _tell_of_guards(self) -> None:
        """Write down and tell what guards of earlier runs have done. Raises `JournalFailed`."""
        if self.guard is None:
            return
        for report in await asyncio.to_thread(self.guard.reports):
            what = f"the guard of an earlier run: {report.get('why')}; {report.get('outcome')}"
            _log.warning("%s: %s", self._telescope_id, what)
            facts = {"about": "dead-man", **report}
            await self._journal.note(Entry(utc_now(), self._telescope_id, EntryKind.FAULT, what, facts))
            if self.tell is not None:
                self.tell("dead-man", dict(report))
        await asyncio.to_thread(self.guard.told)

    def told(self, mount: CheckedMount) -> str | None:
        """What an operator should know now."""
        if mount.trusted:
            self.distrust = None
        if self.fault is not None:
            return f"{self.fault} ({_FAULT_ADVICE})"
        if (going := mount.following_problem) is not None:
            return going
        if (words := mount.contradiction) is not None:
            return f"mount and settings contradict each other, nothing is slewed: {words} ({ADVICE})"
        return self.distrust or self.notice

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

    async def _recall_rotator(self, rotator: CheckedRotator | None) -> None:
        if rotator is not None:
            rotator.restore(await self._journal.recent(self._telescope_id, EntryKind.SETTINGS, ROWS_READ))

    async def _recall(self, mount: CheckedMount, guard: GuardedSync, rates: RatesKept) -> None:
        syncs = await self._journal.recent(self._telescope_id, EntryKind.SYNC, ROWS_READ)
        learned = await self._journal.recent(self._telescope_id, EntryKind.LEARNED, LESSONS_READ)
        settings = await self._journal.recent(self._telescope_id, EntryKind.SETTINGS, ROWS_READ)
        said = [entry.facts for entry in settings if entry.facts.get("about") == ACCEPTED]
        if said and said[-1].get("difference") is not None:
            mount.restore_agreement(said[-1])
        proven = [entry.facts for entry in settings if entry.facts.get("about") == SIDE_PROVEN]
        if proven:
            mount.restore_side_proof(proven[-1])
        kept = [entry.facts[RATES_KEPT] for entry in learned if RATES_KEPT in entry.facts]
        if kept and isinstance(kept[-1], Mapping):
            rates.restore(kept[-1])
        cameras = [entry for entry in learned if RATES_KEPT not in entry.facts][-1:]
        guard.restore(sorted((*syncs, *cameras), key=lambda one: one.utc))


def last_seen(reader: JournalReader, telescope_id: str) -> LastSeen | None:
    """How a telescope's mount was seen last, by its rows of standing and its last order that was done."""
    done = Wanted(telescope=telescope_id, kinds=frozenset({COMMAND}), outcome=str(Outcome.DONE))
    # by the order of writing: a clock that was ahead for a while must not bring an older word back
    written = reader.last_entry(EntryKind.STANDING, telescope_id)
    orders = reader.commands(done, limit=1, newest_first=True)
    last = None if written is None else LastSeen.of_facts(written.facts)
    after = orders[0][1].after if orders and orders[0][1] is not None else None
    if after is None or (last is not None and last.utc >= after.utc):
        return last
    if last is None:
        return seen_of(after)
    return seen_of(after, trusted=last.trusted, why=last.why)
