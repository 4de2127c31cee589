"""The face of the one way to a mount: what it is, what is known of it, and what may be ordered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from typing import Any

from mountnav.clock import Clock, SystemClock
from mountnav.devices import (
    ConnectReport,
    Direction,
    Epoch,
    Mount,
    MountAxis,
    MountReading,
    MovesAxes,
    OffsetRates,
    PierSide,
    RateSpan,
    Skill,
    SlewOutcome,
    SyncResult,
    TakesOffsetRates,
    TrackingRate,
    skills_of,
)
from mountnav.errors import Busy, MountnavError
from mountnav.journal.records import CommandRecord, EntryKind, Journal, Order, Outcome, Unwritten, because
from mountnav.mount.dead_man import Armed, Deadman, LeftGoing, NoGuard, SelfActing
from mountnav.mount.following_policy import FollowingPolicy, OnLoss
from mountnav.mount.kill_points import kill_point
from mountnav.mount.limits_guard import LimitsGuard
from mountnav.mount.mount_state import Listener, MountState, SegmentListener
from mountnav.mount.moved_axes import AxisOrders
from mountnav.mount.offset_rates import RateOrders, RatesInForce
from mountnav.mount.order_book import OrderBook, outcome_of
from mountnav.mount.order_rooms import OrderRooms
from mountnav.mount.orders import BriefOrders, MotionOrders, SlewPlanner, SyncOrders
from mountnav.mount.pier_side import SIDE_PROVEN, SideProof
from mountnav.mount.sending import Admission, Sender
from mountnav.mount.tracking_watch import TrackingWatch
from mountnav.mount.trust import LastSeen, PositionMemory, SiteTimeAgreement
from mountnav.pointing.limits import Limits, Mounting, Reached
from mountnav.pointing.limits.along import Path
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site

_CLOSES_WITHIN_S = 6.0
"""So long a mount that is let go is waited for to end what goes on by itself, s; then it is left to the
guard. Chosen by hand: three tries and a stop. Doubled, a service with an unplugged mount takes longer to
end."""


class CheckedMount:
    """A mount behind its limits and its journal; a `Mount`, `Skilled`, `Trusts` and `Announces` itself.

    Parameters
    ----------
    mount : Mount
        The driver. It must not be used by anybody else from now on.
    mounting : {"german", "fork", "altaz"}, optional
        None: not known.
    following : FollowingPolicy, optional
        Bounds of rates beside the stars' and of axes moved by hand.
    dead_man : Deadman, optional
        Who ends them when the service is dead; nobody, if left out.
    """

    def __init__(
        self,
        mount: Mount,
        *,
        telescope: str,
        limits: Limits,
        site: Site,
        air: Air,
        journal: Journal | None = None,
        clock: Clock | None = None,
        mounting: Mounting | None = None,
        following: FollowingPolicy | None = None,
        dead_man: Deadman | None = None,
    ) -> None:
        self._mount = mount
        self._clock = clock or SystemClock()
        self._rate: TrackingRate | None = None
        stated = getattr(mount, "sides_stated", False) is True
        self._guard = guard = LimitsGuard(
            limits, site, air, mounting, SideProof(stated=stated, tell=self._side_proven)
        )
        self._book = book = OrderBook(journal or Unwritten(), self._clock, telescope)
        self._state = state = MountState(mount, book, self._clock)
        self._sender = sender = Sender(mount, book, state)
        self._watch = watch = TrackingWatch(self, guard, book, self._clock, state.tell)
        self._agreement = agreement = SiteTimeAgreement(mount, state, book, guard)
        self._admission = Admission(mount, guard, state, sender, self._clock, agreement)
        self._policy = following or FollowingPolicy()
        self._armed = Armed(dead_man or NoGuard())
        rooms = OrderRooms(
            mount, guard, state, sender, book, self._admission, watch, self._clock, self._policy, self._armed
        )
        self._plans = plans = SlewPlanner(rooms)
        self._motions = MotionOrders(rooms, plans)
        self._syncs = SyncOrders(rooms)
        self._memory = PositionMemory(state, guard, book, self._clock)
        self._limits = limits
        self._wider_deg = self._off_deg = 0.0
        state.segments.listen(self._usual_again)
        state.on_reading(guard.saw)
        state.listen(self._not_followed)
        self._brief = BriefOrders(rooms)
        self._rates = RateOrders(
            rooms,
            stop=self._stop_and_rest,
            rest=lambda: self._tracking_off("it rested before its rates were ended"),
            axes_move=lambda: self._axes.owed,
        )
        self._axes = AxisOrders(rooms, stop=self._stop_for, follows=lambda: self._rates.owed)
        self._motions.before_moving(self._ended_before)

    # -- what it is --------------------------------------------------------------------------------

    @property
    def segment_id(self) -> str:
        """Which segment this is: it changes with each sync that was seen, home, reboot or lost link."""
        return self._state.segments.segment_id

    @property
    def side_of_last_sync(self) -> PierSide | None:
        """On which side of the pier this segment's zero points were synced; None if they weren't."""
        return self._state.segments.side_of_last_sync

    @property
    def last_motion_utc(self) -> datetime | None:
        """End of the last order that moved the mount or gave it other zero points, or may have.

        A frame exposed before it says nothing of where the mount is now.
        """
        return self._state.last_motion_utc

    @property
    def limits(self) -> Limits:
        """What it is checked against."""
        return self._guard.limits

    @contextmanager
    def wider_margin(self, by_deg: float) -> Iterator[None]:
        """Keep so much more away from all limits meanwhile: it is known to point so far elsewhere."""
        self._wider_deg += by_deg
        self._keep_away()
        try:
            yield
        finally:
            self._wider_deg -= by_deg
            self._keep_away()

    def _keep_away(self) -> None:
        margin_deg = max(self._limits.margin_deg, self._off_deg) + self._wider_deg
        self._guard.limits = replace(self._limits, margin_deg=margin_deg)

    @property
    def mounting(self) -> Mounting | None:
        """How it is mounted, as far as it is known."""
        return self._guard.mounting

    @property
    def site(self) -> Site:
        """Where it stands."""
        return self._guard.site

    @property
    def air(self) -> Air:
        """The air there."""
        return self._guard.air

    @property
    def name(self) -> str:
        """Name and address."""
        return self._mount.name

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it speaks."""
        return self._mount.epoch

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported place."""
        return self._mount.resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do besides."""
        return skills_of(self._mount)

    @property
    def trusted(self) -> bool:
        """Whether its own position counts."""
        return self._state.trusted

    @property
    def moving(self) -> str | None:
        """Which order holds the mount: ``slew``, ``park``, ``home``, ``sync``; None if none."""
        return self._admission.job

    @property
    def contradiction(self) -> str | None:
        """In what mount and settings differ on site and time; None if in nothing, or if that is accepted."""
        return self._agreement.contradiction

    async def require_agreement(self, order: str = "slew") -> None:
        """Refuse an order while mount and settings contradict each other. Raises `DeviceRefused`."""
        await self._agreement.require(order)

    @property
    def turned_deg(self) -> float | None:
        """By how much its sky was turned when its site and clock were set to ours, degrees to the west.

        None where they weren't, and since the sky has shown that it was right.
        """
        return self._agreement.turned_deg

    def sky_agrees(self) -> None:
        """A look has shown that its site and clock were set right."""
        self._agreement.turned_deg = None

    def restore_side_proof(self, facts: Mapping[str, Any]) -> None:
        """Take over from the journal that this mount was seen to report the right side of the pier."""
        if facts.get("mount") == self.name:
            self._guard.proof.restore()

    def _side_proven(self, how: str) -> None:
        facts = {"about": SIDE_PROVEN, "mount": self.name, "why": how}
        self._book.note_now(EntryKind.SETTINGS, f"it tells the right side of the pier: {how}", facts)

    def restore_agreement(self, facts: Mapping[str, Any]) -> None:
        """Take over from the journal that a contradiction was accepted."""
        self._agreement.restore(facts)

    def accept_site_and_time(self) -> str | None:
        """Accept the contradiction until it changes: the word of one who may configure; what was accepted."""
        return self._agreement.accept()

    async def set_site_and_time(self) -> ConnectReport:
        """Set the mount's site and clock to ours, as far as it takes them. Moves nothing.

        Raises
        ------
        DeviceRefused
            It takes neither.
        Busy, JournalFailed, DeviceError
        """
        reports: list[ConnectReport] = []

        async def send(_: object) -> None:
            reports.append(await self._agreement.set_right())

        site = {"latitude_deg": self.site.latitude_deg, "longitude_deg": self.site.longitude_deg}
        await self._brief.give("set-site", send, facts={**site, "clock": True})
        self._state.new_segment("its site and clock were set")
        return reports[-1]

    @property
    def why_untrusted(self) -> str:
        """Why it doesn't; empty while it does."""
        return self._state.why_untrusted

    async def take_up(
        self,
        last: LastSeen | None,
        in_flight: Sequence[CommandRecord],
        left: Mapping[SelfActing, LeftGoing] | None = None,
    ) -> str | None:
        """Take it up as an earlier run of the service left it; from now on what is seen is written down.

        Parameters
        ----------
        last : LastSeen or None
            As it was seen last; None if nothing is known.
        in_flight : sequence of CommandRecord
            Orders of earlier runs that were begun and never closed.
        left : mapping, optional
            What an earlier run has left going: it is ended first thing, and that is told.

        Returns
        -------
        str or None
            Why it isn't trusted from now on, if that has come out.

        Raises
        ------
        DeviceError
            It can't be read: to be called again.
        """
        for what, one in (left or {}).items():
            words = one.words
            facts: dict[str, object] = {"what": what, "why": words}
            self._book.note_now(EntryKind.FAULT, f"the service ended without having ended it: {words}", facts)
            self._state.tell("left-going", facts)
            room = self._rates if what == "offset-rates" else self._axes
            # what can't be ended at once is tried on
            with suppress(MountnavError):
                await room.take_up(f"left by an earlier run of the service: {words}")
        fastest_deg_s = max((one.speed_deg_s for one in (left or {}).values()), default=0.0)
        return self._memory.take_up(last, in_flight, await self.reading(), fastest_deg_s)

    def trust(self) -> None:
        """An operator's word that the position is right."""
        self._state.trust()

    def trust_by_sight(self, off_deg: float, why: str) -> None:
        """Let the position count since the sky has shown how far it is off.

        Parameters
        ----------
        off_deg : float
            All limits are kept away from as far as that, if it is more than their margin, until a new segment
            begins.
        """
        self._state.trust(why)
        self._off_deg = off_deg
        self._keep_away()

    def _usual_again(self, segment_id: str, why: str) -> None:
        """Other zero points: what was known of the old ones is over."""
        self._off_deg = 0.0
        self._keep_away()

    def _not_followed(self, what: str, facts: Mapping[str, object]) -> None:
        """A mount that was switched off, or out of sight, may stand on either side of the pier."""
        if what == "untrusted":
            self._guard.lost_sight()

    def distrust(self, why: str) -> None:
        """Let its position not count until a sync is seen, its home is found, or an operator says so."""
        self._state.distrust(why)

    def new_segment(self, why: str) -> str:
        """Its zero points are others from now on, say after a slip; the new segment's id."""
        self._state.new_segment(why)
        return self.segment_id

    def listen(self, listener: Listener) -> None:
        """Call `listener(what, facts)` on events of the link, the position, and the limits."""
        self._state.listen(listener)

    def on_reading(self, listener: Callable[[MountReading], None]) -> None:
        """Call `listener` with each reading, for whatever purpose it was taken."""
        self._state.on_reading(listener)

    def on_segment(self, listener: SegmentListener) -> None:
        """Tell `listener(segment_id, why)` of each new segment."""
        self._state.segments.listen(listener)

    @property
    def tracking_rate(self) -> TrackingRate | None:
        """At which rate it was last ordered to track, by us; None where it wasn't yet."""
        return self._rate

    def reached(self, reading: MountReading, *, within_s: float = 43200.0) -> Reached | None:
        """Which limit tracking from where the mount stands reaches first, and when.

        Parameters
        ----------
        within_s : float
            How far ahead is looked.
        """
        return self._guard.reached(reading, within_s=within_s)

    # -- what only some mounts report: None where the driver has no such property ------------------

    @property
    def link(self) -> str | None:
        """How its link is: "up", "silent", "lost", ...; None of a mount without one."""
        link = getattr(self._mount, "link", None)
        return None if link is None else str(link)

    @property
    def slew_state(self) -> str | None:
        """What the last order to move has come to, as `SlewState`; None where it doesn't report that."""
        state = getattr(self._mount, "slew_state", None)
        return None if state is None else str(state)

    @property
    def report(self) -> ConnectReport | None:
        """What connecting has found; None where it hasn't yet, or doesn't report that."""
        report = getattr(self._mount, "report", None)
        return report if isinstance(report, ConnectReport) else None

    @property
    def wire_log(self) -> object | None:
        """The log of its messages (`drivers.wire.wire_log.WireLog`); None of a mount without a wire."""
        log: object | None = getattr(self._mount, "wire_log", None)
        return log

    @property
    def tracking_rates(self) -> frozenset[TrackingRate] | None:
        """At which rates it can track; None where it doesn't report that."""
        rates = getattr(self._mount, "tracking_rates", None)
        return rates if isinstance(rates, frozenset) else None

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """Rates of a guide pulse in right ascension and in declination; None where it doesn't report that."""
        match getattr(self._mount, "guide_rates_deg_s", None):
            case (float(ra_deg_s), float(dec_deg_s)):
                return ra_deg_s, dec_deg_s
        return None

    @property
    def tells_trust(self) -> bool:
        """Whether the driver knows by itself if its position counts."""
        return getattr(self._mount, "trusted", None) is not None

    # -- its life ----------------------------------------------------------------------------------

    async def open(self) -> None:
        """Connect, and begin to watch the limits. Moves nothing."""
        await self._mount.open()
        await self._agreement.opened()
        self._watch.start()

    async def close(self) -> None:
        """Release; what is still to be written is written first, what still moves by itself ended."""
        await self._watch.end()
        await self._axes.close(_CLOSES_WITHIN_S)
        await self._rates.close(_CLOSES_WITHIN_S)
        # only what its driver doesn't end either is the guard's; a driver that hangs holds it up no longer
        hangs = asyncio.get_running_loop().call_later(_CLOSES_WITHIN_S, self._armed.let_go)
        try:
            await self._mount.close()
            self._rates.driver_closed()
        finally:
            hangs.cancel()
            self._armed.let_go()
            await self._book.settle()

    async def reading(self) -> MountReading:
        """Where the mount believes it points."""
        return await self._state.reading()

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side of the pier the tube would hang after a slew there; None if it can't tell."""
        return await self._plans.destination_side(place)

    # -- orders to move ----------------------------------------------------------------------------

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go there, if the place and every way that the mount may take are allowed.

        If the direct way isn't, it goes by way of one or two other places; each leg is an order of its own.

        Parameters
        ----------
        place : Apparent or Icrs
            Of the kind that `epoch` says.

        Returns
        -------
        SlewOutcome
            ``STOPPED`` also when a stop came before it was sent.

        Raises
        ------
        OutsideLimits
            With the limit, where and when; nothing was sent. Or the mount went another way than it should
            have, and was stopped.
        DeviceRefused
            It is parked, its position can't be trusted (nothing was sent), or it said no.
        Busy, BadRequest, JournalFailed
            Nothing was sent.
        DeviceError
            The outcome isn't known, and the journal says so.
        """
        return await self._motions.slew(place)

    async def would_slew(self, place: Apparent | Icrs, *, after_stop: bool = False) -> None:
        """Tell what a slew there would be refused for now; nothing is sent, nothing written down.

        Parameters
        ----------
        after_stop : bool
            As if what runs now had been stopped: it is no reason then.

        Raises
        ------
        OutsideLimits, DeviceRefused, Busy, BadRequest, DeviceError
        """
        if self._admission.job is not None and not after_stop:
            raise self._admission.busy()
        before = await self.reading()
        if self.trusted:
            self._guard.stood(before)
        if (refusal := self._admission.unfit("slew", before)) is not None:
            raise refusal
        await self._agreement.require("slew")
        await self._plans.found(before, place)

    async def park(self) -> SlewOutcome:
        """Go to the park position. Where that is the mount doesn't say: the way is watched, not predicted.

        Raises
        ------
        DeviceRefused
            It can't, its position can't be trusted, or it said no.
        Busy, JournalFailed, DeviceError
        """
        return await self._motions.station("park", lambda mount: mount.park(), needs_trust=True)

    async def home(self) -> SlewOutcome:
        """Go home; a mount that finds its home by sensors may do so without being trusted.

        Raises
        ------
        DeviceRefused
            It can't, is parked, would go by a position that can't be trusted, or said no.
        OutsideLimits
            By day, where that is refused.
        Busy, JournalFailed, DeviceError
        """
        finds = Skill.FIND_HOME in self.skills
        why = "its home was found" if finds else ""
        return await self._motions.station(
            "home", lambda mount: mount.home(), needs_trust=not finds, new_segment=why
        )

    # -- other orders ------------------------------------------------------------------------------

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Tell the mount that it points there. Whether a look may be synced on `GuardedSync` decides.

        Raises
        ------
        OutsideLimits
            The place is below the ground: no telescope here can point there; nothing was sent.
        DeviceRefused
            It said no.
        Busy, BadRequest, Cancelled, JournalFailed
            Nothing was sent.
        DeviceError
            Whether it was carried out isn't known: a new segment begins.
        """
        self._require_no_axis("sync")
        return await self._syncs.sync(place)

    def _require_no_axis(self, order: str) -> None:
        if self._axes.owed:
            raise Busy(
                f"the {order} refused: an axis is moved by hand",
                device=self.name,
                advice="end that motion first",
            )

    async def stop(self) -> None:
        """Stop all motion now; waits for no check and no disk.

        Raises
        ------
        DeviceError
            It can't be sent, or it still moves.
        """
        try:
            await self._stop()
        finally:
            # some mounts track on at the rates they have, or stop slews alone
            await self._axes.stopped()
            await self._rates.stopped()

    async def _stop(self) -> None:
        # no `Admission`, no `Sender.send`: both may wait, for an order under way or for the disk
        with self._sender.stopping():
            row = self._book.begin_now("stop", self.segment_id)
            try:
                await self._mount.stop()
            except BaseException as error:
                detail = str(error) or "cancelled: whether it was heard isn't known"
                self._book.end_soon(row, outcome_of(error, on_wire=True), detail)
                raise
            finally:
                self._state.moved()
                kill_point("stop sent")
            self._book.end_soon(row, Outcome.DONE)

    async def unpark(self) -> None:
        """Be ready to move again: an order of its own, never given by itself. Raises as `park`."""
        await self._brief.give("unpark", lambda mount: mount.unpark())

    async def set_park(self) -> None:
        """Take the present place for the park position. Raises `DeviceRefused` where it can't."""
        await self._brief.set_park()

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow the sky, or rest. To begin is refused where it would lead out of the limits at once.

        Raises
        ------
        OutsideLimits, DeviceRefused, Busy, Cancelled, JournalFailed, DeviceError
        """
        facts: dict[str, object] = {"on": on, "rate": str(rate)}
        await self._axes.before("track")
        if on:
            await self._rates.before("track")
        else:
            self._rates.rests = True
            # it may be to stop at a limit: what can't be ended is tried on meanwhile
            with suppress(MountnavError):
                await self._rates.end("its tracking is switched off")
        await self._brief.give("track", lambda mount: mount.set_tracking(on, rate), facts=facts, follows=on)
        if on:
            self._rate = rate

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for a moment.

        Raises
        ------
        OutsideLimits, DeviceRefused, Busy, Cancelled, JournalFailed, DeviceError
        """
        self._require_no_axis("guide pulse")
        facts: dict[str, object] = {"direction": str(direction), "duration_s": duration_s}
        await self._brief.give(
            "guide", lambda mount: mount.guide(direction, duration_s), facts=facts, follows=True, moves=True
        )

    # -- beside the stars --------------------------------------------------------------------------

    @property
    def on_loss(self) -> OnLoss:
        """What is left when rates end by themselves, or the program that ordered them is gone."""
        return self._policy.on_loss

    @property
    def following_policy(self) -> FollowingPolicy:
        """Bounds of rates and of moved axes."""
        return self._policy

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """The largest rates that it takes; None where it takes none, or doesn't say."""
        return self._mount.most_offset_arcsec_s if isinstance(self._mount, TakesOffsetRates) else None

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """At which speeds its axes can be moved by hand; empty where they can't."""
        return self._mount.axis_rates_deg_s if isinstance(self._mount, MovesAxes) else {}

    @property
    def offset_rates_in_force(self) -> RatesInForce | None:
        """The rates at which it follows a moving target; None if it follows the stars, as far as is known."""
        return self._rates.in_force

    @property
    def offset_rates_told(self) -> OffsetRates | None:
        """The rates in force as the mount was told them: rounded by its protocol. None if none are."""
        in_force = self._rates.in_force
        if in_force is None:
            return None
        known: OffsetRates | None = getattr(self._mount, "rates_known", None)
        return in_force.rates if known is None else known

    @property
    def axis_moving(self) -> bool:
        """Whether an axis moves by an order to move it, or may."""
        return self._axes.owed

    @property
    def following_problem(self) -> str | None:
        """What goes on by itself and could not be ended yet, in words; None if nothing does."""
        return self._rates.ending.problem or self._axes.ending.problem

    async def set_offset_rates(
        self, rates: OffsetRates, *, ends_utc: datetime, path: Path | None = None
    ) -> None:
        """Track at rates beside the stars', up to an end; again before it, to change or to prolong them.

        At the end at the latest the mount goes back to sidereal tracking, or stops, as `on_loss` says. They
        are ended before a slew, park or home and by a stop, by `set_tracking`, by a link that was lost or
        a position that doesn't count any more, by `close`, and, if the service dies, by its guard. A sync
        and guide pulses leave them in force.

        Parameters
        ----------
        rates : OffsetRates
            In the mount's own coordinates; `STARS_RATES` ends them.
        ends_utc : datetime
            Aware.
        path : callable, optional
            ``path(utc)``: where the target will be, up to `ends_utc`. Limits are checked along it, once for
            one callable: give the same one again when the rates change. None: along what the rates lead to.

        Raises
        ------
        BadRequest
            Not finite, no end to come or one too far, faster than the settings allow, a path of something
            else; nothing was sent.
        OutsideLimits
            A limit is reached before the end, with when and where; nothing was sent.
        DeviceRefused
            It can't, it is parked, doesn't track, can't be trusted, contradicts the settings on site or time,
            or said no: it tracks as before.
        Busy, Cancelled, JournalFailed
            Nothing is in force that wasn't before; after a stop, nothing at all.
        DeviceError
            Whether it took them isn't known: they are being ended.
        """
        await self._rates.set(rates, ends_utc=ends_utc, path=path)

    async def end_offset_rates(self) -> None:
        """Track as for a star again; where no rates are in force nothing is sent.

        Raises
        ------
        DeviceError
            They could not be ended, or were not seen to have ended: it is tried on by itself, and the mount
            stopped if that doesn't help.
        """
        await self._rates.end("ordered")

    async def move_axis(self, axis: MountAxis, rate_deg_s: float, *, for_s: float) -> None:
        """Move an axis on for a moment, beside tracking; ordered again it goes on, else it ends by itself.

        It is ended before it comes to a limit, its way of braking included, and by whatever ends rates; a
        sync and guide pulses are refused meanwhile.

        Parameters
        ----------
        rate_deg_s : float
            Positive to greater right ascension (azimuth) or declination (altitude). 0 ends it, and returns
            when it is seen at rest.
        for_s : float
            Above 0.

        Raises
        ------
        BadRequest
            Not finite, too fast, too long, or a speed that the mount doesn't have; nothing was sent.
        OutsideLimits
            It would come to a limit in that time, or braking after it; nothing was sent, and if it moves
            already it was ended.
        DeviceRefused, Busy, Cancelled, JournalFailed
            Nothing was sent.
        DeviceError
            Whether it moves isn't known: it is being ended.
        """
        await self._axes.move(axis, rate_deg_s, for_s=for_s)

    async def _ended_before(self, order: str) -> None:
        await self._axes.before(order)
        await self._rates.before(order)

    async def _stop_for(self, why: str) -> None:
        with because(why=why):
            await self._stop()

    async def _stop_and_rest(self, why: str) -> None:
        """Stop it, and end its tracking: what goes on by itself moves nothing then."""
        self._rates.rests = True
        with because(why=why):
            await self.stop()
            await self._tracking_off(why)

    async def _tracking_off(self, why: str) -> None:
        if Skill.TRACK not in self.skills:
            return
        with because(why=why):
            await self._brief.give(
                "track", lambda mount: mount.set_tracking(False), facts={"on": False, "why": why}
            )

    # -- before an order ---------------------------------------------------------------------------

    def unfit(self, order: Order, before: MountReading, *, needs_trust: bool = True) -> MountnavError | None:
        """What speaks against an order to a mount that stands as `before`: parked, or lost; None: nothing."""
        return self._admission.unfit(order, before, needs_trust=needs_trust)

    async def require_unparked(self, order: Order) -> MountReading:
        """Read the mount, and refuse an order to a parked one before anything is done for it.

        Raises
        ------
        DeviceRefused, DeviceError, JournalFailed
        """
        return await self._admission.ready(order, needs_trust=False)
