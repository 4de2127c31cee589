"""A sync is a transaction: plausible? allowed? send, read back, verify; commit, or undo and fall back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime

from mountnav.clock import Clock, SystemClock
from mountnav.devices import MountReading, PierSide
from mountnav.errors import (
    BadFrame,
    DeviceRefused,
    JournalFailed,
    MountnavError,
    Refusal,
    SkyError,
    SyncDoubt,
    SyncElsewhere,
    SyncRefused,
)
from mountnav.journal.records import Entry, EntryKind, Journal, Unwritten, because
from mountnav.mount import CheckedMount
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.learned import Learned, Lesson, LessonKind
from mountnav.navigation.reports import CameraIdentity, Look, SyncReport
from mountnav.navigation.sync_judge import Judge, SyncCounts, decide, night_of
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.navigation.sync_to_coordinates import CoordinateSyncs, Seen
from mountnav.navigation.sync_transaction import (
    Listener,
    LookAgain,
    SyncEnd,
    SyncProgress,
    SyncTransaction,
    TookElsewhere,
    context_facts,
    end_of,
    look_facts,
    off_at_most_arcsec,
    stood_still,
    why_not_by_sight,
)
from mountnav.navigation.sync_trigger import SyncDecision, SyncTrigger, decided
from mountnav.navigation.vetoes import (
    ADVICE,
    AGAINST_THE_LOOK,
    ConfirmingLooks,
    SurprisingLooks,
    SyncContext,
    disagreement,
    in_order,
)
from mountnav.pointing.model.in_force import Pointing
from mountnav.pointing.offset import TooFarToSync
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset

_PASSING = frozenset({Refusal.BUSY, Refusal.PARKED, Refusal.NOT_TRACKING, Refusal.UNTRUSTED})
"""A mount that refuses a sync for one of these may take the next one."""
_WONT_TAKE = (SyncEnd.IGNORED, SyncEnd.ELSEWHERE, SyncEnd.UNDONE, SyncEnd.UNDO_FAILED)
"""A mount of which a sync ended so will do the same with the next one."""


class GuardedSync:
    """The syncs of one telescope, and what its looks teach.

    The limits are not asked: a tube may look where it may not be sent.

    Parameters
    ----------
    mount : CheckedMount
        It writes the commands down and begins a new segment with each sync that was seen.
    learned : Learned
        Of the camera.
    pointing : Pointing
        The model in force; it gets each new segment and each look that nothing stands against.
    listen : callable, optional
        Told of each step: ``listen(kind, data)``.

    Attributes
    ----------
    synced : Look or None
        The look that the mount was last synced on, whatever came of it.
    """

    def __init__(
        self,
        mount: CheckedMount,
        *,
        telescope: str,
        policy: SyncPolicy,
        learned: Learned,
        pointing: Pointing,
        journal: Journal | None = None,
        clock: Clock | None = None,
        listen: Listener | None = None,
    ) -> None:
        self._mount = mount
        self._telescope = telescope
        self._site = mount.site
        self._journal = journal or Unwritten()
        self._clock = clock or SystemClock()
        self._listen = listen or _nobody
        counts = SyncCounts(mount.site, policy.same_target_deg)
        self._judge = Judge(mount, policy, learned, pointing, self._clock, counts)
        self._surprising = SurprisingLooks()
        self._confirming = ConfirmingLooks()
        self._offset_night: str | None = None
        self.synced: Look | None = None
        self.coordinate_syncs = CoordinateSyncs(self._judge, self._note, self._listen)
        """Syncs on given coordinates, by whatever face."""
        mount.listen(self._mount_said)
        mount.on_segment(self._new_segment)

    # -- what is known -----------------------------------------------------------------------------

    @property
    def policy(self) -> SyncPolicy:
        """When it syncs; may be replaced."""
        return self._judge.policy

    @policy.setter
    def policy(self, policy: SyncPolicy) -> None:
        self._judge.policy = policy

    @property
    def pointing(self) -> Pointing:
        """The model in force; may be replaced."""
        return self._judge.pointing

    @pointing.setter
    def pointing(self, pointing: Pointing) -> None:
        self._judge.pointing = pointing

    @property
    def learned(self) -> Learned:
        """What is known of the camera."""
        return self._judge.learned

    @property
    def camera(self) -> str:
        """Whose `learned` is, as `CameraIdentity` is written; empty until a frame has shown it."""
        return self._judge.camera

    def looks_through(self, camera: CameraIdentity) -> None:
        """Take note of the camera that looks: `learned` is what is known of it."""
        self._judge.looks_through(camera)

    @property
    def prefers_offset(self) -> bool:
        """Whether a sync was ignored, refused or undone: for this night, corrections go by offset."""
        return self._offset_night is not None and self._offset_night == self._night()

    def reconnected(self) -> None:
        """Forget that syncs didn't work: it may be another mount, or the same one set right."""
        self._offset_night = None

    def note_move(self, utc: datetime) -> None:
        """Take note of a motion that ended at `utc`, and that the mount doesn't know of itself."""
        self._judge.note_move(utc)

    def side_seen(self, found: Look) -> PierSide:
        """On which side of the pier the tube hangs, by the solved rotation; unknown if it can't say."""
        return self._judge.learned_of(found).side_seen(self._judge.sample(found))

    def restore(self, entries: Iterable[Entry]) -> None:
        """Take over from the journal what was learned and counted; rows of others are passed over.

        Parameters
        ----------
        entries : iterable of Entry
            The oldest first.
        """
        for entry in entries:
            if entry.telescope != self._telescope:
                continue
            learned = entry.facts.get("learned")
            if entry.kind is EntryKind.LEARNED and isinstance(learned, Mapping):
                self.learned.restore(learned)
                self._judge.camera = str(entry.facts.get("camera") or "")
            elif entry.kind is EntryKind.SYNC:
                self._recount(entry)

    def _recount(self, entry: Entry) -> None:
        outcome, target, seen = (entry.facts.get(name) for name in ("outcome", "target", "seen"))
        if entry.facts.get("told"):
            self.coordinate_syncs.restore(entry.facts)
        elif outcome == SyncEnd.COMMITTED and isinstance(seen, Mapping):
            place = Icrs(float(seen["ra_deg"]), float(seen["dec_deg"]))
            self._judge.counts.add(entry.utc, None if target is None else str(target), place)
            self.coordinate_syncs.restore_proof(place, entry.utc)
        elif entry.facts.get("by_offset"):
            self._offset_night = night_of(entry.utc, self._site)

    # -- learning ----------------------------------------------------------------------------------

    async def learn(self, found: Look) -> Lesson:
        """Learn the camera and the pointing's zero points from a look, unless something stands against it.

        One false solve teaches nothing. Three looks in a row that are not what was expected, and agree with
        each other, mean that the mount's zero points have changed: a clutch slipped, or a hand was at work.
        """
        # judged by what was known before it: what is learned here changes what a decision later on goes by
        context = self._judge.context(found, SyncTrigger.ORDERED)
        doubts = in_order(self._judge.vetoes(found, context))
        against = {kind for kind in doubts if kind in AGAINST_THE_LOOK}
        if against - set(context.departures):
            lesson = Lesson(LessonKind.REFUSED, "; ".join(doubts.values()))
        else:
            lesson = self._judge.learned_of(found).learn(self._judge.sample(found))
        if lesson.worth_writing and self._judge.learned_of(found) is self.learned:
            facts = {"learned": self.learned.as_dict(), "camera": self._judge.camera}
            await self._note(EntryKind.LEARNED, lesson.words, facts)
        if lesson.kind is LessonKind.NEW_NORMAL:
            self._listen("camera-changed", {"look_id": found.look_id, "words": lesson.words})
        if not against - {SyncDoubt.NOT_EXPECTED, SyncDoubt.TOO_FAR}:
            self._confirming.add(found)
            self.coordinate_syncs.looked(found)
        astray = against & {SyncDoubt.NOT_EXPECTED, SyncDoubt.TOO_FAR}
        if not context.trusted:
            # what it believes says nothing, and a recovery begins from nothing
            self._surprising.forget()
        elif astray and against == astray:
            expected = Offset(0.0, 0.0) if context.expected is None else context.expected.offset
            if self._surprising.agree(found, expected, self.policy.expected_floor_arcsec):
                await self._slipped(found, next(doubts[kind] for kind in doubts if kind in astray), astray)
        elif not against:
            self._surprising.forget()
            self.pointing.observed(self._judge.observation(found))
        return lesson

    async def _slipped(self, found: Look, words: str, astray: set[SyncDoubt]) -> None:
        self._surprising.forget()
        why = f"looks in a row agree that the zero points have changed: {words}"
        self.pointing.new_segment(self._mount.new_segment(why), None)
        if SyncDoubt.TOO_FAR in astray:
            # further than any sync but a recovery's goes, and slews by such a belief are not safe
            self._mount.distrust(why)
        else:
            self.pointing.observed(self._judge.observation(found))
        self.coordinate_syncs.looked(found)
        self._listen("zero-points-changed", {"look_id": found.look_id, "words": why})
        await self._note(EntryKind.FAULT, why, look_facts(found, self.learned.normal))

    # -- the transaction ---------------------------------------------------------------------------

    def consider(self, found: Look, trigger: SyncTrigger, *, target: str | None = None) -> SyncDecision:
        """Judge without sending anything.

        Parameters
        ----------
        target : str, optional
            Name of the target, for the rules and caps that count by target; its place if left out.
        """
        return self._judge.consider(found, trigger, target)

    def context(self, found: Look, trigger: SyncTrigger, *, target: str | None = None) -> SyncContext:
        """What `consider` goes by besides the look itself."""
        return self._judge.context(found, trigger, target)

    def judge(self, found: Look, trigger: SyncTrigger, context: SyncContext) -> SyncDecision:
        """Judge a look by that alone: the same values give the same decision."""
        return decide(found, trigger, self.policy, context)

    async def commit(
        self,
        found: Look,
        trigger: SyncTrigger,
        *,
        target: str | None = None,
        decision: SyncDecision | None = None,
        look_again: LookAgain | None = None,
    ) -> SyncReport:
        """Do the whole transaction.

        Parameters
        ----------
        decision : SyncDecision, optional
            Of `consider`, for the same look, if nothing was awaited since; it is judged here if left out.
        look_again : callable, optional
            Takes the look that confirms the first one before anything is sent, when nothing known can judge
            it, and the verifying one after the sync, when the policy asks for that.

        Returns
        -------
        SyncReport
            Of a sync that was seen, in time or late.

        Raises
        ------
        SyncRefused
            Nothing was sent; with all doubts. `TooFarToSync` if the size is the gravest.
        SyncUndone
            It was sent, contradicted, and taken back: go by offset.
        UndoFailed
            It could not be taken back: the mount's position counts no more.
        SyncIgnored
            Sent, and the reading didn't follow.
        SyncElsewhere
            Sent, and taken for another place: the mount's position counts no more; or by what a look after it
            showed (`TookElsewhere`): go by offset.
        DeviceRefused
            The mount said no.
        DeviceError
            Whether it was carried out may be unknown.
        JournalFailed
        """
        with because(look_id=found.look_id):
            decision = decision or self._judge.consider(found, trigger, target)
            context = decision.context
            assert context is not None, "`consider` makes decisions with their context"
            decided_by = {
                "occasion": str(trigger),
                "target": target,
                **look_facts(found, self.learned.normal),
                **context_facts(context, self.policy),
            }
            progress = SyncProgress(found, decided_by)
            if not decision.allowed:
                raise await self._refused(decision, progress)
            if not trigger.lost and self._judge.needs_second_look(found, context):
                decision = await self._confirmed(progress, look_again)
                if not decision.allowed:
                    raise await self._refused(decision, progress)
            kill_point("sync transaction: decided")
            # durable before anything is sent; if it can't be written, nothing is
            await self._journal.note(
                self._entry(EntryKind.DECISION, f"sync: {decision.why}", progress.facts())
            )
            kill_point("sync transaction: decision written")
            # read once more: what the look says is sent only to a mount that has not moved since
            before = await self._mount.reading()
            decision = self._judge.unmoved(found, before)
            if not decision.allowed:
                raise await self._refused(decision, progress)
            self.synced = found
            transaction = SyncTransaction(self._judge, self._listen, progress, before)
            try:
                sent, again = await transaction.run(look_again)
            except BaseException as error:
                await self._failed(error, progress)
                if isinstance(error, SyncElsewhere) and context.trusted and look_again is not None:
                    seen = await self._seen_after(found, before, look_again)
                    if seen is not None and await self.count_by_sight(seen):
                        raise TookElsewhere(error, seen) from error
                raise
            self._judge.counts.add(self._clock.utc(), target, found.seen)
            self._surprising.forget()
            if self._mount.segment_id == progress.segment_before:
                self._mount.new_segment("a sync that had seemed to be ignored was seen late")
            synced = replace(
                self._judge.observation(found),
                utc=sent.reading.utc,
                reading=sent.reading.place,
                side=sent.reading.side,
            )
            self.pointing.new_segment(self._mount.segment_id, synced)
            self.coordinate_syncs.proven(Seen(found.seen, Offset(0.0, 0.0), side=sent.reading.side))
            if again is not None:
                self.pointing.observed(self._judge.observation(again))
            verified_by = None if again is None else again.look_id
            await self._ended(SyncEnd.COMMITTED, progress.facts() | {"verified_by": verified_by})
            return SyncReport(sent.outcome, found, sent.place, sent.miss_arcsec)

    async def _seen_after(self, found: Look, before: MountReading, look_again: LookAgain) -> Look | None:
        """Look where the tube points after a sync that went elsewhere; None if that shows nothing."""
        kill_point("sync transaction: to be seen by the sky")
        try:
            again = await look_again()
        except MountnavError as error:
            self._listen("not-by-sight", {"why": str(error)})
            return None
        allowed = self.policy.max_motion_arcsec + self._mount.resolution_arcsec
        if not stood_still(found, before, again, allowed):
            self._listen("not-by-sight", {"why": "the looks before and after the sync don't agree"})
            return None
        return again

    async def count_by_sight(self, found: Look) -> bool:
        """Let the mount's position count by a look, without a sync, if it isn't too far off; whether it does.

        Parameters
        ----------
        found : Look
            Another one agrees with it, and how a German mount stands is known. From now on corrections go by
            offset.
        """
        words = why_not_by_sight(self._judge, found)
        if words is not None:
            self._listen("not-by-sight", {"why": words})
            return False
        off_arcsec, widest_arcsec = found.offset.total_arcsec, off_at_most_arcsec(self._judge, found)
        facts: dict[str, object] = {**look_facts(found, self.learned.normal), "by_offset": True}
        why = (
            "its position is trusted because of a look, which saw the tube "
            f"{off_arcsec:.0f}″ from where it believes"
        )
        self._mount.trust_by_sight(widest_arcsec / 3600.0, why)
        self._offset_night = self._night()
        self.pointing.observed(self._judge.observation(found))
        self.coordinate_syncs.looked(found)
        self._listen("by-sight", {"look_id": found.look_id, "off_arcsec": off_arcsec})
        await self._note(EntryKind.SYNC, why, {**facts, "outcome": str(SyncEnd.BY_SIGHT)})
        return True

    async def _confirmed(self, progress: SyncProgress, look_again: LookAgain | None) -> SyncDecision:
        """Whether an earlier look agrees, or one that is taken now."""
        found = progress.found
        resolution = self._mount.resolution_arcsec
        witness = self._confirming.for_look(found, self.policy, resolution)
        words = None
        if witness is None and look_again is None:
            words = "nothing is known yet to judge it by, and there is no second look that agrees"
        elif witness is None and look_again is not None:
            kill_point("sync transaction: to be confirmed")
            self._listen("confirming", {"look_id": found.look_id})
            try:
                witness = await look_again()
            except (SkyError, BadFrame) as error:
                words = f"nothing is known yet to judge it by, and no second look could be had: {error}"
            else:
                no_good = self._judge.no_good(witness)
                words = no_good[1] if no_good else disagreement(found, witness, self.policy, resolution)
        progress.asked_for_second = True
        progress.confirmed_by = witness.look_id if witness is not None and words is None else None
        return decided({} if words is None else {SyncDoubt.NOT_EXPECTED: words}, found)

    async def _refused(self, decision: SyncDecision, progress: SyncProgress) -> SyncRefused:
        """Tell and write down that nothing is sent; what is to be raised."""
        doubts = [str(doubt) for doubt in decision.doubts]
        self._listen(
            "sync-refused", {"look_id": progress.found.look_id, "doubts": doubts, "why": decision.why}
        )
        told = {**progress.facts(), "order": "sync", "doubts": doubts}
        await self._note(EntryKind.REFUSAL, f"sync refused: {decision.why}", told)
        kind = TooFarToSync if decision.doubts[0] is SyncDoubt.TOO_FAR else SyncRefused
        return kind(
            decision.why,
            device=self._mount.name,
            advice=f"nothing was synced; {ADVICE[decision.doubts[0]]}",
            doubts=decision.doubts,
        )

    async def _failed(self, error: BaseException, progress: SyncProgress) -> None:
        """Write down how a sync did not come to its end; the error itself is the caller's."""
        refused = isinstance(error, DeviceRefused)
        end = SyncEnd.REFUSED if refused else end_of(error)
        if isinstance(error, DeviceRefused):
            lasting = error.reason not in _PASSING
        else:
            lasting = end in _WONT_TAKE and not progress.unverified
        if lasting:
            self._offset_night = self._night()
        if not refused:
            # it may have been carried out, or will be: frames from before don't compare any more
            self._judge.note_move(self._clock.utc())
        if end not in (SyncEnd.REFUSED, SyncEnd.IGNORED):
            self.pointing.new_segment(self._mount.segment_id, None)
        if end is SyncEnd.ELSEWHERE:
            # it believes neither what it did nor what was seen
            self.synced = None
        told = {**progress.facts(), "by_offset": lasting, "error": str(error)}
        if end is SyncEnd.INTERRUPTED:
            # a cancelled task must not wait
            self._journal.note_now(self._entry(EntryKind.SYNC, f"sync {end}", {**told, "outcome": str(end)}))
            return
        if end is SyncEnd.UNDO_FAILED:
            await self._note(EntryKind.FAULT, str(error), told)
        await self._ended(end, told)

    async def _ended(self, end: SyncEnd, facts: Mapping[str, object]) -> None:
        kill_point("sync transaction: over")
        told = {**facts, "outcome": str(end), "segment_after": self._mount.segment_id}
        await self._note(EntryKind.SYNC, f"sync {end}", told)
        kill_point("sync transaction: end written")

    # -- the small things --------------------------------------------------------------------------

    def _mount_said(self, what: str, facts: Mapping[str, object]) -> None:
        if what == "link-back":
            self.reconnected()
        elif what == "sync-late":
            # the mount has done what it had seemed to ignore: what was read before doesn't compare any more
            self._judge.note_move(self._clock.utc())
            self._new_segment(self._mount.segment_id, what)

    def _new_segment(self, segment_id: str, why: str) -> None:
        self._surprising.forget()
        self._confirming.forget()
        self.coordinate_syncs.new_segment(why)
        self.pointing.new_segment(segment_id, None)

    def _night(self) -> str:
        return night_of(self._clock.utc(), self._site)

    def _entry(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> Entry:
        return Entry(self._clock.utc(), self._telescope, kind, what, dict(facts))

    async def _note(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> None:
        """Write what has happened already: a journal that fails then must not hide it."""
        try:
            await self._journal.note(self._entry(kind, what, facts))
        except JournalFailed as error:
            self._listen("journal-failed", {"problem": str(error), "lost": what})


def _nobody(kind: str, data: dict[str, object]) -> None:
    """Tell nobody."""


__all__ = ["GuardedSync", "LookAgain", "SyncDecision", "SyncTrigger"]
