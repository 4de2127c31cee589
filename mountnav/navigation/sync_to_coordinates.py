"""A sync on given coordinates: a person or program says where the telescope points, and nobody has looked.

A planetarium's sync, mostly, by whatever face. Words are believed within the bounds of a solved sync: the
mount's own position counts, it follows the sky, the place stands well, the sky isn't turned more than a look
may turn it, what was seen last and the pointing model don't contradict. And all words of a night together
move the belief no further than one of them may. A mount that is lost, or further off, is for `recover`: words
don't make a position count again.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from mountnav.devices import MountReading, PierSide, SyncOutcome, from_mount
from mountnav.errors import (
    DeviceRefused,
    ModelRefused,
    MountnavError,
    Refusal,
    SyncDoubt,
    SyncIgnored,
    SyncRefused,
)
from mountnav.journal.records import EntryKind
from mountnav.mount.mount_state import SEEN_LATE
from mountnav.navigation.reports import CoordinateSyncReport, Listener, Look, finite_or_none
from mountnav.navigation.sync_judge import Judge, night_of
from mountnav.navigation.sync_transaction import (
    ReadBack,
    SyncEnd,
    place_facts,
    read_back_facts,
    send_sync,
    turned_over,
    undo,
    undone,
    went_elsewhere,
)
from mountnav.navigation.vetoes import Claim, Vetoes, in_order, place_vetoes
from mountnav.pointing.model.in_force import Expected, one_point_sigma_arcsec
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_hour_angle
from mountnav.sky.coordinates import HourAngle, Icrs
from mountnav.sky.sphere import Offset, half_turn_deg, separation_arcsec

Note = Callable[[EntryKind, str, Mapping[str, object]], Awaitable[None]]

_LOOK = "let it look (sync; first light if it is new or far off; recover if it is lost)"
_ADVICE: Mapping[SyncDoubt, str] = {
    SyncDoubt.MOVED: "wait until it is at rest",
    SyncDoubt.NOT_TRACKING: "let it track, then sync",
    SyncDoubt.TOO_FAR: f"{_LOOK}; or raise sync.told_max_arcsec",
    SyncDoubt.NOT_EXPECTED: f"{_LOOK}: a frame is believed, not a statement; is that the star it points at?",
    SyncDoubt.TOO_LOW: "sync on a place that stands higher",
    SyncDoubt.NEAR_POLE: f"sync further from the pole; or {_LOOK}",
    SyncDoubt.TOLD_TOO_MUCH: f"{_LOOK}; or let it find its home; or, if you have seen that it points where "
    "it says, let a user with the role configure say trust: from then on it is counted again",
    SyncDoubt.NEAR_MERIDIAN: "sync further east or west",
    SyncDoubt.TOO_MANY: f"{_LOOK}; why does the mount need so many? backlash, slip, flexure?",
}


@dataclass(frozen=True, slots=True)
class Seen:
    """What a frame showed last of the mount's zero points.

    Attributes
    ----------
    offset : Offset
        Seen minus believed there, as it was then; 0 after a sync.
    """

    place: Icrs
    offset: Offset
    sigma_arcsec: float = 0.0
    side: PierSide = PierSide.UNKNOWN


@dataclass(frozen=True, slots=True)
class CoordinateSyncTotals:
    """What words have done to the belief since a frame, a home or an operator proved it, or since noon.

    Attributes
    ----------
    turned_deg, raised_deg : float
        Of the hour angle axis (west positive) and the declination: the sum, with its sign.
    seen : Seen or None
        What was seen last, before all of them.
    night : str
        Of the last one.
    """

    count: int = 0
    turned_deg: float = 0.0
    raised_deg: float = 0.0
    seen: Seen | None = None
    night: str = ""

    def and_by(self, turned_deg: float, raised_deg: float) -> CoordinateSyncTotals:
        """With one more."""
        return replace(
            self,
            count=self.count + 1,
            turned_deg=self.turned_deg + turned_deg,
            raised_deg=self.raised_deg + raised_deg,
        )


@dataclass(slots=True)
class CoordinateSyncs:
    """The syncs on given coordinates of one telescope, by all faces.

    Attributes
    ----------
    note : callable
        Writes down what has happened.
    listen : callable
        Hears what happens, for the event stream.
    totals : CoordinateSyncTotals
        Of the present night.
    """

    judge: Judge
    note: Note
    listen: Listener
    totals: CoordinateSyncTotals = field(default_factory=CoordinateSyncTotals)
    _late: Claim | None = None
    _sending: bool = False

    async def sync_to(self, place: Icrs) -> CoordinateSyncReport:
        """Sync the mount to `place`, which nobody has seen, and read it back.

        Raises
        ------
        SyncRefused
            What stands against it, and the way out; nothing was sent. `SyncUndone` if the mount took it for
            the other side of the pier.
        DeviceRefused
            It is parked, its position can't be trusted (nothing was sent), or it said no.
        SyncIgnored
            It accepted and ignored it.
        SyncElsewhere
            It took another place; its position counts no more.
        OutsideLimits, DeviceError, JournalFailed
        """
        judge, mount = self.judge, self.judge.mount
        before = await mount.reading()
        claim = Claim(place, from_mount(before.place), judge.clock.utc(), told=True)
        refusal = self._unfit(before) or self._doubted(before, claim)
        facts: dict[str, object] = {
            "told": True,
            "place": place_facts(place),
            "believed": place_facts(claim.believed),
            "off_arcsec": finite_or_none(claim.offset.total_arcsec),
        }
        if refusal is not None:
            doubts = [str(doubt) for doubt in getattr(refusal, "doubts", ())]
            self.listen("sync-refused", {"told": True, "doubts": doubts, "why": refusal.what})
            await self.note(EntryKind.REFUSAL, refusal.what, {**facts, "order": "sync", "doubts": doubts})
            raise refusal
        self.listen("syncing", {"told": True, "off_arcsec": claim.offset.total_arcsec})
        self._sending = True
        try:
            sent = await self._sent(claim, before)
        finally:
            self._sending = False
        self.taken(claim)
        facts |= read_back_facts(sent) | {"outcome": str(SyncEnd.COMMITTED)} | self._as_facts()
        await self.note(EntryKind.SYNC, "sync on told coordinates committed", facts)
        return CoordinateSyncReport(
            outcome=sent.outcome,
            place=place,
            offset=claim.offset,
            read_back=sent.place,
            read_back_miss_arcsec=sent.miss_arcsec,
        )

    async def _sent(self, claim: Claim, before: MountReading) -> ReadBack:
        judge, mount = self.judge, self.judge.mount
        self._late = claim
        sent = await send_sync(mount, claim.seen, claim.offset.total_arcsec, judge.policy, judge.clock)
        self.listen("synced", {"outcome": str(sent.outcome), "told": True, "miss_arcsec": sent.miss_arcsec})
        if sent.outcome is SyncOutcome.IGNORED:
            raise SyncIgnored(
                f"it accepted the sync, and still reads {sent.miss_arcsec:.0f}″ from there",
                device=mount.name,
                advice="correct by offsets or by a pointing model; see `mountnav docs syncing`",
            )
        if sent.outcome is SyncOutcome.ELSEWHERE:
            raise went_elsewhere(sent.miss_arcsec, mount.name)
        self._late = None
        words = turned_over(before, sent.reading)
        if words is not None:
            try:
                await undo(mount, claim.believed, sent, judge.policy, judge.clock)
            except BaseException as error:
                mount.distrust(str(error) or "a contradicted sync was being undone when that was interrupted")
                raise
            raise undone(words, mount.name, SyncDoubt.WRONG_SIDE)
        return sent

    # -- what is known -----------------------------------------------------------------------------

    def looked(self, found: Look) -> None:
        """A look that counts has shown where the tube points: words are measured by it from now on."""
        if found.segment_id not in ("", self.judge.mount.segment_id):
            # of other zero points
            return
        sigma = found.sigma_arcsec
        sigma = sigma if math.isfinite(sigma) else 0.0
        self.proven(Seen(found.seen, found.offset, sigma, found.after.side))

    def proven(self, seen: Seen | None = None) -> None:
        """The belief was proven, by a frame or by an operator: what words did before counts no more."""
        self.totals = CoordinateSyncTotals(seen=seen, night=self._night())

    def taken(self, claim: Claim) -> None:
        """The mount believes these words: its two axes have other zeros from now on."""
        judge = self.judge
        seen = icrs_to_hour_angle(claim.seen, claim.utc, judge.site, judge.air)
        believed = icrs_to_hour_angle(claim.believed, claim.utc, judge.site, judge.air)
        turned_deg = half_turn_deg(seen.ha_deg - believed.ha_deg)
        self.totals = replace(
            self.totals.and_by(turned_deg, seen.dec_deg - believed.dec_deg), night=self._night()
        )

    def new_segment(self, why: str) -> None:
        """The zero points are others; those that words gave are counted."""
        if self._sending:
            return
        late, self._late = self._late, None
        if why == SEEN_LATE and late is not None:
            self.taken(late)
        else:
            self.proven()

    def restore_proof(self, place: Icrs, utc: datetime) -> None:
        """A sync on a frame that stands in the journal."""
        self.totals = CoordinateSyncTotals(
            seen=Seen(place, Offset(0.0, 0.0)), night=night_of(utc, self.judge.site)
        )

    def restore(self, facts: Mapping[str, Any]) -> None:
        """Take over the totals of its night from a row of the journal; an older row has none."""
        seen, since = facts.get("since_seen"), facts.get("words")
        if not isinstance(since, Mapping):
            return
        known = None
        if isinstance(seen, Mapping):
            known = Seen(
                Icrs(float(seen["ra_deg"]), float(seen["dec_deg"])),
                Offset(float(seen["east_arcsec"]), float(seen["north_arcsec"])),
                float(seen["sigma_arcsec"]),
                PierSide(seen["side"]),
            )
        self.totals = CoordinateSyncTotals(
            int(since["count"]),
            float(since["turned_deg"]),
            float(since["raised_deg"]),
            known,
            str(since["night"]),
        )

    def _as_facts(self) -> dict[str, object]:
        words, seen = self.totals, self.totals.seen
        since = None
        if seen is not None:
            since = {
                **place_facts(seen.place),
                "east_arcsec": seen.offset.east_arcsec,
                "north_arcsec": seen.offset.north_arcsec,
                "sigma_arcsec": seen.sigma_arcsec,
                "side": str(seen.side),
            }
        told = {
            "count": words.count,
            "turned_deg": words.turned_deg,
            "raised_deg": words.raised_deg,
            "night": words.night,
        }
        return {"words": told, "since_seen": since}

    def _night(self) -> str:
        return night_of(self.judge.clock.utc(), self.judge.site)

    # -- what stands against it --------------------------------------------------------------------

    def _unfit(self, before: MountReading) -> MountnavError | None:
        """What speaks against any sync on coordinates, as the mount stands."""
        mount = self.judge.mount
        parked = mount.unfit("sync", before, needs_trust=False)
        if parked is None and not mount.trusted:
            # with an advice of its own: near to where it believes to be means nothing then, and after a sync
            # it would slew again
            return DeviceRefused(
                "the sync refused: its position can't be trusted, and there was no look",
                device=mount.name,
                advice="solve a frame and sync (recover), let it find its home, or say trust",
                reason=Refusal.UNTRUSTED,
            )
        return parked

    def _doubted(self, before: MountReading, claim: Claim) -> SyncRefused | None:
        doubts = in_order(self.vetoes(before, claim))
        if not doubts:
            return None
        gravest = next(iter(doubts))
        return SyncRefused(
            f"the sync refused: {'; '.join(doubts.values())}",
            device=self.judge.mount.name,
            advice=f"nothing was synced; {_ADVICE[gravest]}",
            doubts=tuple(doubts),
        )

    def vetoes(self, before: MountReading, claim: Claim) -> Vetoes:
        """All that stands against a given place; nothing that is no number passes."""
        judge = self.judge
        policy = judge.policy
        night = self._night()
        if self.totals.night != night:
            self.totals = CoordinateSyncTotals(night=night)
        vetoes: Vetoes = {}
        if before.slewing:
            vetoes[SyncDoubt.MOVED] = "it is moving"
        if before.tracking is False:
            vetoes[SyncDoubt.NOT_TRACKING] = "it does not follow the sky"
        context = replace(judge.surroundings(claim), expected=self._by_model(before, claim))
        vetoes |= place_vetoes(claim, policy, context)
        if math.isfinite(claim.offset.total_arcsec):
            vetoes |= self._all_together(before, claim, vetoes)
        count = context.counts.tonight + self.totals.count
        if policy.max_per_night is not None and count >= policy.max_per_night:
            vetoes[SyncDoubt.TOO_MANY] = f"{count} sync(s) in this night (allowed {policy.max_per_night})"
        return vetoes

    def _all_together(self, before: MountReading, claim: Claim, alone: Vetoes) -> Vetoes:
        """All words since the belief was proven last, this one among them, taken as one sync."""
        judge, words = self.judge, self.totals
        whole = replace(claim, believed=self._without_these_syncs(claim))
        expected = self._as_seen(before, claim.seen)
        context = replace(
            judge.surroundings(claim), expected=expected, modeled=False, expected_by="what was seen last"
        )
        found = place_vetoes(whole, judge.policy, context)
        vetoes = {kind: found[kind] for kind in (SyncDoubt.NOT_EXPECTED,) if kind in found}
        caps = (SyncDoubt.TOO_FAR, SyncDoubt.NEAR_POLE)
        too_much = [found[kind] for kind in caps if kind in found and kind not in alone]
        if words.count and too_much:
            vetoes[SyncDoubt.TOLD_TOO_MUCH] = (
                f"with the {words.count} told before it in this night: {'; '.join(too_much)}"
            )
        return vetoes

    def _without_these_syncs(self, claim: Claim) -> Icrs:
        """Where the mount would believe itself without the syncs on coordinates since it was proven."""
        judge, words = self.judge, self.totals
        if not words.count:
            return claim.believed
        now = icrs_to_hour_angle(claim.believed, claim.utc, judge.site, judge.air)
        dec_deg = max(-90.0, min(90.0, now.dec_deg - words.raised_deg))
        untold = HourAngle(half_turn_deg(now.ha_deg - words.turned_deg), dec_deg, claim.utc)
        return hour_angle_to_icrs(untold, judge.site, judge.air)

    def _as_seen(self, before: MountReading, place: Icrs) -> Expected | None:
        """What the last frame lets expect; nothing on the other side of the pier."""
        seen = self.totals.seen
        if seen is None or {seen.side, before.side} == {PierSide.EAST, PierSide.WEST}:
            return None
        away_deg = separation_arcsec(seen.place, place) / 3600.0
        sigma = math.hypot(seen.sigma_arcsec, one_point_sigma_arcsec(away_deg))
        return Expected(seen.offset, sigma)

    def _by_model(self, before: MountReading, claim: Claim) -> Expected | None:
        """What the pointing model lets expect, if there is one."""
        pointing = self.judge.pointing
        if pointing.model_id is None:
            return None
        try:
            return pointing.expected(claim.believed, claim.utc, before.side)
        except ModelRefused:
            return None


__all__ = ["CoordinateSyncTotals", "CoordinateSyncs", "Seen"]
