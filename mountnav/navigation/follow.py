"""Following a target that moves: centered, then tracked until an end, with looks that judge its rates.

::

    plan: fast enough? limits ahead? -> centered, or waited for ahead on its path -> followed -> ended
                                                                    |  ^
                            rates renewed as they change, looks, corrections by what they show

Between looks the tube is where the last ones saw it, moved on by what the mount was told (`tube_estimate`). A
look says how far it is off, and with those before it which rates the mount truly keeps (`rates_seen`); a
fault that is named is made good (`rates_kept`), one that isn't is not: the target is followed by other means
then. Whatever its end, the mount follows the stars again afterwards, or stands still.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import datetime, timedelta

from mountnav.devices import (
    STARS_RATES,
    Direction,
    OffsetRates,
    PierSide,
    Skill,
    for_mount,
    from_mount,
    offset_speed_arcsec_s,
)
from mountnav.ephemeris import Ephemeris
from mountnav.errors import (
    BadFrame,
    BadRequest,
    Cancelled,
    DeviceGarbled,
    DeviceRefused,
    DeviceSilent,
    LimitKind,
    ModelRefused,
    MountMoved,
    MountnavError,
    NotReached,
    OutsideLimits,
    Refusal,
    SolveFailed,
    SyncDoubt,
    SyncRefused,
    TargetNotReached,
)
from mountnav.journal.records import EntryKind
from mountnav.navigation.beside import Aim, Beside
from mountnav.navigation.centering import center_in_time
from mountnav.navigation.derotating import Derotation
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.follow_plan import (
    LEFT_SHARE,
    PULSE_EVERY_S,
    SHORTEST_S,
    FollowBy,
    FollowPlan,
    Means,
    mount_rates,
    plan_follow,
)
from mountnav.navigation.follow_report import FollowEnd, FollowProgress, FollowReport, progress_facts
from mountnav.navigation.look import LookOptions, expose_and_solve
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.rates_kept import RATES_KEPT
from mountnav.navigation.rates_measured import TIME_SIGMA_S, OrderedRates, RateLook, trail_of
from mountnav.navigation.rates_seen import (
    MOST_PLAY_ARCSEC,
    RateCorrection,
    RateFault,
    RatesJudgement,
    judge_rates,
)
from mountnav.navigation.reports import CenterReport, Look
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.sync_trigger import SyncTrigger
from mountnav.navigation.tube_estimate import TubeEstimate, rates_on_sky
from mountnav.pointing.limits.along import Path, SkyEvent, SkyEventKind, forecast
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.sky.sphere import Offset, offset_arcsec, separation_arcsec
from mountnav.solution import Reason
from mountnav.tasks import first_of, together, waited_for

__all__ = ["Following"]

LOOK_EVERY_S = 60.0
"""Between two looks while all is well, s, where nobody says. Chosen by hand: what the camera is there for
needs most of the time. Doubled, a fault of the rates shows a minute later."""
FIRST_LOOKS = 4
"""So many looks are taken one after the other, until one can tell whether the rates are kept. Doubled, a slow
target has four more exposures taken before it is left alone."""
LONGEST = timedelta(hours=24)
"""No target is followed for longer by one order."""
MOST_TRAIL_PX = 5.0
"""Stars may be drawn out so far in a look, pixels; else it is exposed for less. Doubled, centers are
worse."""
SHORTEST_LOOK_S = 0.3
"""Looks are not exposed for less, s: there are no stars then. What is too fast for that is not looked at."""
CATCH_UP_S = 8.0
"""What a look shows to be off is made good in so much time, s, by rates. Doubled, pictures are drawn out half
as fast, for twice as long."""
MOST_CATCH_UP_ARCSEC_S = 15.0
"""... and no faster, ″/s: the sky's own speed. Doubled, it takes half the time."""
FAST_CATCH_UP_S, FAST_CATCH_UP_SHARE = 3.0, 0.5
"""The same of a fast target: in so much time, and no faster than this share of its own speed. Doubled, a
pass is half over before it is caught."""
DEAD_SHARE = 0.1
"""What is off by less than this share of the tolerance is left. Doubled, less is corrected, and less
disturbed."""
CENTERED_WITHIN_S = 8.0
"""A target is centered before it is followed to as much as it goes in so much time, s, or to the tolerance if
that is more: slews arrive some seconds early or late. Halved, fast NEOs are centered in vain."""
HOP_ARCSEC, HOP_TOLERANCES = 120.0, 12.0
"""From so far off, ″ or tolerances, whichever is more, it is slewed back: rates would take too long. Doubled,
large errors are crept back from."""
HELD_S = 90.0
"""Rates are ordered for so long at once, s, and renewed before: who dies leaves them for no longer. Doubled,
a mount that nobody renews goes on for three minutes."""
ALARM_FACTOR, ALARM_ARCSEC_S = 3.0, 10.0
"""The mount's own readings alarm when they show rates wrong by so many times what was ordered, and by so
much: before a look is taken the tube may be degrees away. Doubled, a factor of 5 waits for the looks."""
ALARM_AFTER_S = 3.0
"""So long after the first rates the mount is read for that, s. Doubled, a factor of 220 leads twice as
far."""
READ_EVERY_S = 10.0
"""The mount is read so often for that while it follows by rates, s: what goes wrong later, by a hand control
or a change of sides, is seen then. Doubled, a factor of 220 leads twice as far."""
TOO_COARSE = 0.3
"""Rates that make a fault good and are left wrong by this share, when the mount's steps have rounded them,
aren't used. Chosen by hand: looks make less good. Doubled, steps as large as its way lead it to and fro."""
MOST_TRAILED = 2
"""So many looks in a row show stars that are drawn out, while nothing has shown that the rates are kept:
then they aren't. Doubled, a wrong rate goes on for two minutes more."""
MOST_WITHDRAWN = 2
"""A fault whose correction looks have contradicted so often isn't corrected any more: the mount can't say
such rates, or keeps slow ones otherwise than fast ones. Doubled, it is led to and fro for minutes more."""
BEFORE_LIMIT_S = 20.0
"""So long before a limit following ends, s: before the watch over the limits would stop the mount. Doubled,
so much of the path is lost."""
BEYOND_S = 2.0
"""Rates are ordered for so much longer than the end, s: this job ends them itself, by an order. Doubled, a
job that dies at its end leaves them for 4 s."""
AMBIGUOUS_LOOKS = 7
"""After so many looks of rates that are wrong, without a name, it is followed by other means. Doubled, that
is seen later."""
LEG_LOOKS = 12
"""Rates are judged by so many of the last looks. Doubled, rates that are lost meanwhile are seen later."""
ENOUGH_TO_CONFIRM = 3
"""So many looks must agree with a correction before it is kept for good. Doubled, it takes as many more."""
MOST_STREAK_PX, SHORTEST_STREAK_S = 40.0, 0.02
"""On a fast pass stars may be drawn out so far, pixels: the middle of an even streak is a place; and it is
exposed for no less, s. Doubled, fewer streaks end within the frame, and they are fainter."""
STREAK_EVERY_S = 4.0
"""Between the beginnings of two looks on a fast pass, s. Doubled, one look fewer in each ten seconds."""
SOLVED_S = 5.0
"""From the end of an exposure to what it says, s: reading out and solving, at most as a rule. Doubled, a pass
that has just time for a look ahead has none."""
LOOKS_AHEAD = 3
"""So many looks are taken where a fast target is waited for, while there is time. Doubled, none is taken
more as a rule: one shows how far off it points, the next that it was made good."""
ODD_SIGMAS = 5.0
"""A look so many sigmas from what was known counts only when the next one agrees with it. Doubled, a false
solution moves the tube on a pass."""
READY_S, READY_ARCSEC_S, READY_ARCSEC = 4.0, 0.05, 4.0 * 3600.0
"""So long before a fast target comes, s, a rate of next to nothing is ordered, ″/s, if it is so near, ″: the
guard is started and the path is looked at by then. Halved, a slow machine begins a pass late."""
SLIPS = 3
"""So many readings in a row must show that a fast target's rates are not kept. Doubled, a mount goes the
wrong way for twice as long; at 1, one late reading is an alarm."""
WAIT_AHEAD_S = 10.0
"""A fast target is waited for so long before it comes, s, at least. Halved, some are missed."""
SHORTEST_PULSE_S = 0.02
"""Shorter guide pulses are left, s: most mounts make nothing of them, or 0.1 s. Doubled, 0.3″ is left."""
MOST_TOLD = 1000
"""So many looks of one job are kept with it; more are told as events alone. Doubled, a job of a night that
looks every few seconds is a row of 2 MB."""
SLIP_SHARE, SLIP_S = 0.4, 0.1
"""A fast target's rates are not kept where a reading is off by this share of its way since the one before,
and what it goes in so much time, s. Doubled, rates that are ignored may pass for kept ones."""
JITTER_S = 0.01
"""The instants of mid-exposures vary by so much from one look to the next, s. Tenfold, looks on a pass count
for too little to keep up with what its way makes of a polar axis."""
CREEP_SHARE, LEAST_SPAN_S = 0.4, 0.3
"""How fast a fast target's mount goes beside what it was ordered is learned from one reading to the next, by
this share each time, if they lie so far apart, s. Doubled, a reading that is late throws it off."""
MOST_VAGUE_ARCSEC = 600.0
"""A fast pass of which is known no better how the mount points, one sigma, ″, is told so: it would be
outside of most frames. And so far no look moves the tube alone: two must agree. Doubled, 20′."""
OF_A_MOVING_TUBE = frozenset(
    {SyncDoubt.MOVED, SyncDoubt.OLDER_THAN_MOVE, SyncDoubt.NOT_FRESH, SyncDoubt.NOT_TRACKING}
)
"""Doubts about a look that are none on a pass: there the tube moves among the stars, as it was told."""
LEAST_STREAK_ARCSEC = 2.0
"""The middle of a streak is no better known than that, ″: atmosphere and optics. Doubled, changes of how a
mount points are learned from more looks."""
WORST_CENTER_ARCSEC = 30.0
"""A center whose error isn't known is taken to be so far off, ″. Doubled, such looks count for less."""
MISSES = 6
"""Looks in a row that weren't solved, after which that is told once more."""


def _unlike(sent: OffsetRates, before: OffsetRates) -> bool:
    """Whether an order differs from the one before by more than the target's own motion changes."""
    change = math.hypot(sent.ra_arcsec_s - before.ra_arcsec_s, sent.dec_arcsec_s - before.dec_arcsec_s)
    return change > max(0.5, 0.1 * math.hypot(before.ra_arcsec_s, before.dec_arcsec_s))


def _clipped(target: Ephemeris, site: Site) -> Path:
    """A target's path that goes on at its end as a star would: rates are looked at a little beyond it."""
    ends = target.ends_utc

    def path(utc: datetime) -> Icrs:
        return target.icrs(utc if ends is None else min(utc, ends), site)

    return path


def _rms(values: list[float]) -> float | None:
    return math.sqrt(sum(one**2 for one in values) / len(values)) if values else None


class Following:
    """One run.

    Parameters
    ----------
    until_utc : datetime
        Aware.
    policy : CenteringPolicy
        With the tolerance and the exposure of the order.
    look_every_s : float, optional
        Between the beginnings of two looks.
    heard : callable, optional
        Told how it goes.
    halt : callable
        Stops the mount.
    """

    def __init__(
        self,
        equipment: Equipment,
        slewing: Slewing,
        target: Ephemeris,
        until_utc: datetime,
        policy: CenteringPolicy,
        *,
        look_every_s: float | None,
        heard: Callable[[FollowProgress], None] | None,
        key: str | None,
        halt: Callable[[], Awaitable[None]],
    ) -> None:
        self._equipment, self._slewing, self._target = equipment, slewing, target
        self._mount, self._clock = equipment.mount, equipment.clock
        self._derotation: Derotation | None = None
        self._policy, self._key, self._halt = policy, key, halt
        self._look_every_s = LOOK_EVERY_S if look_every_s is None else look_every_s
        self._heard = heard
        self._until = until_utc
        # one callable for the whole run: limits along it are looked at once
        self._path = _clipped(target, equipment.site)
        self._tolerance = max(policy.tolerance_arcsec, 0.75 * self._mount.resolution_arcsec)
        self._rates = equipment.rates
        self._hand = asyncio.Lock()
        self._wake = asyncio.Event()
        self._stopped = False
        self._end = FollowEnd.TIME
        self._by = FollowBy.RATES
        self._side = PierSide.UNKNOWN
        self._tube: TubeEstimate | None = None
        self._beside = self._beside_by(None, 0.0)
        self._odd: Look | None = None
        self._phase = "centering"
        self._played: tuple[float, datetime] | None = None
        self._slips = 0
        self._creep, self._by_reading = Offset(0.0, 0.0), False
        self._anchor: RateLook | None = None
        self._withdrawn: Counter[str] = Counter()
        """How often corrections for a fault were contradicted, by its name."""
        self._changed: RateLook | None = None
        """Where the mount said to be as what it is sent changed by more than the target asks for."""
        self._read: RateLook | None = None
        """Where the mount said to be at its last reading."""
        self._catch_until_s = math.inf
        """Until when what is off may be made good before rates are judged; monotonic."""
        self._slewed = False
        """Whether it said there that it slews."""
        self._renew_at_s = -math.inf
        self._trailed = 0
        self._stated: list[float] = []
        self._kept: list[OrderedRates] = []
        self._sent: list[OrderedRates] = []
        self._leg: list[RateLook] = []
        self._leg_side = PierSide.UNKNOWN
        self._in_force = False
        self._kept_before = False
        # until looks have shown that its rates are kept they are sent steadily: nothing is made good by them
        self._verified = self._rates.confirmed
        self._leg_from: datetime | None = None
        self._offs: list[float] = []
        self._looks = self._unsolved = self._missed = self._renewed = 0
        self._judgement: RatesJudgement | None = None
        self._fault: RateFault | None = None
        self._off: tuple[float, float] | None = None
        self._order_s, self._alarms, self._wrong, self._tried = 0.1, 0, 0, False
        self._trial: RateCorrection | None = None
        self._events: tuple[SkyEvent, ...] = ()
        self.notes: list[str] = []
        self.plan: FollowPlan | None = None

    # -- the whole -----------------------------------------------------------------------------------

    async def run(self) -> FollowReport:
        """Follow. See `Navigator.follow`."""
        began_s = self._clock.monotonic_s()
        self.plan = plan = await self._planned()
        self._by = plan.by
        await self._equipment.note(EntryKind.DECISION, f"follows {self._target.name} {plan.words}", {})
        centered: CenterReport | None = None
        try:
            if plan.fast:
                await self._wait_ahead()
            else:
                self._tell("centering", plan.words)
                centered = await self._centered()
            began = self._clock.utc()
            self._tell("following", plan.words)
            self._derotation = Derotation(self._equipment, self._path, self._until)
            self._derotation.begin()
            await together(self._steer(), self._look_on())
        finally:
            if self._derotation is not None:
                self._derotation.cease()
            try:
                await self._over()
            finally:
                if self._derotation is not None:
                    await self._derotation.end()
                    self.notes += [note for note in self._derotation.notes if note not in self.notes]
        return self._report(began, centered, self._clock.monotonic_s() - began_s)

    def stopped(self) -> None:
        """A stop was ordered: nothing more is sent."""
        self._stopped = True
        if self._derotation is not None:
            self._derotation.cease()
        self._wake.set()

    async def _over(self) -> None:
        """End the rates: also when this is cancelled; the mount's own ending goes on trying if it fails."""
        if self._mount.offset_rates_in_force is None and not self._in_force:
            return
        self._in_force = False
        ending = waited_for(self._mount.end_offset_rates())
        try:
            await asyncio.shield(ending)
        except asyncio.CancelledError:
            with contextlib.suppress(MountnavError):
                await ending
            raise

    # -- before anything moves -----------------------------------------------------------------------

    async def _planned(self) -> FollowPlan:
        equipment, mount, target = self._equipment, self._mount, self._target
        now = self._clock.utc()
        if self._until <= now:
            raise BadRequest(f"following until {self._until:%Y-%m-%d %H:%M:%S} UTC: that time is over")
        if self._until - now > LONGEST:
            raise BadRequest(
                "following for more than a day", advice="order a shorter time, then order it again"
            )
        if target.begins_utc is not None and target.begins_utc > self._until:
            raise BadRequest(f"{target.name} has no place before {target.begins_utc:%Y-%m-%d %H:%M:%S} UTC")
        if target.ends_utc is not None and target.ends_utc < self._until:
            self._end, self._until = FollowEnd.EPHEMERIS, target.ends_utc
            self._note(f"its ephemeris ends at {target.ends_utc:%H:%M:%S} UTC, before the time is up")
        if self._until <= now:
            raise BadRequest(f"the ephemeris of {target.name} has ended", advice="give one that goes on")
        await mount.require_agreement()
        await mount.require_unparked("offset-rates")
        self._side = await self._slewing.side_at(self._path(now))
        self._events = await asyncio.to_thread(self._foretold, now)
        for event in self._events:
            if event.kind is not SkyEventKind.LIMIT:
                continue
            ends = event.utc - timedelta(seconds=BEFORE_LIMIT_S)
            if ends <= now:
                raise OutsideLimits(
                    f"{target.name} {event.words}",
                    device=equipment.name,
                    limit=event.limit or LimitKind.UNREACHABLE,
                    advice="nothing was moved; follow it when it is within the limits",
                )
            if ends < self._until:
                self._end, self._until = FollowEnd.LIMIT, ends
                self._note(f"it will be followed until {ends:%H:%M:%S} UTC: {target.name} {event.words}")
            break
        if self._until - now < timedelta(seconds=2.0):
            raise BadRequest(f"fewer than 2 s are left to follow {target.name}")
        return await asyncio.to_thread(
            plan_follow, self._path, now, self._until, mount.epoch, self._means(), self._tolerance
        )

    def _foretold(self, now: datetime) -> tuple[SkyEvent, ...]:
        equipment, mount = self._equipment, self._mount
        return forecast(
            mount.limits,
            self._path,
            now,
            self._until,
            equipment.site,
            equipment.air,
            mounting=mount.mounting,
            side=None if self._side is PierSide.UNKNOWN else self._side,
        )

    def _means(self) -> Means:
        mount = self._mount
        takes = Skill.OFFSET_RATES in mount.skills
        pulses = Skill.GUIDE in mount.skills
        pace = self._slewing.pace
        return Means(
            takes_rates=takes,
            most=mount.most_offset_arcsec_s if takes else None,
            most_arcsec_s=mount.following_policy.most_arcsec_s,
            order_s=self._order_s,
            guide_deg_s=mount.guide_rates_deg_s if pulses else None,
            slew_s=pace.slew_s(60.0) + pace.until_exposed_s(self._policy.settle_s),
            device=mount.name,
            step_arcsec=mount.resolution_arcsec,
        )

    # -- getting there -------------------------------------------------------------------------------

    async def _centered(self) -> CenterReport:
        plan = self.plan
        assert plan is not None
        # what is left of it is caught up with afterwards
        left_s = (self._until - self._clock.utc()).total_seconds()
        near = max(self._policy.tolerance_arcsec, CENTERED_WITHIN_S * plan.fastest_arcsec_s)
        report = await center_in_time(
            self._equipment,
            self._slewing,
            self._target,
            replace(
                self._policy, tolerance_arcsec=near, timeout_s=max(1.0, min(self._policy.timeout_s, left_s))
            ),
            halt=self._halt,
            planned_s=(self._until - self._clock.utc()).total_seconds(),
            key=self._key,
        )
        self._require_wanted()
        self._side = report.side
        utc = report.target_utc or self._clock.utc()
        place = for_mount(report.tries[-1].seen, self._mount.epoch, utc)
        self._tube = TubeEstimate.of(place, utc, max(report.error_sigma_arcsec, 0.1))
        reading = await self._mount.reading()
        # it has tracked as for a star since
        sigma = report.error_sigma_arcsec
        sigma = max(sigma, 0.1) if math.isfinite(sigma) else WORST_CENTER_ARCSEC
        believed = from_mount(reading.place)
        self._beside = self._beside.anew(report.tries[-1].seen, believed, reading.utc, sigma)
        self.notes += [note for note in report.notes if note not in self.notes]
        return report

    def _beside_by(self, aim: Aim | None, sigma_arcsec: float) -> Beside:
        equipment = self._equipment
        return Beside.nothing_seen(equipment.site, equipment.air, self._mount.mounting, aim, sigma_arcsec)

    def _beside_before(self, ahead: Icrs, side: PierSide) -> Beside:
        """What is known before a look of how far beside its belief the tube looks, there, on that side."""
        equipment = self._equipment
        pointing = equipment.pointing

        def by_model(place: Icrs, utc: datetime) -> Icrs:
            try:
                return pointing.aim(place, utc, side)
            except ModelRefused:
                return place

        aim = by_model if equipment.apply_model and pointing.model_id is not None else None

        expected = self._slewing.expected(ahead, side)
        sigma = self._policy.search_radius_deg * 3600.0 if expected is None else expected.sigma_arcsec
        known = self._beside_by(aim, sigma)
        seen = self._slewing.seen
        if seen is None or seen.segment_id != self._mount.segment_id:
            return known
        if {seen.after.side, side} == {PierSide.EAST, PierSide.WEST}:
            return known  # on the other side of the pier it says nothing
        self._note(
            f"aimed by the look of {seen.mid_exposure_utc:%H:%M:%S} UTC, which saw the tube "
            f"{seen.offset.total_arcsec:.0f}″ beside where the mount believed it pointed"
        )
        own = seen.solution.center_sigma_arcsec
        return known.anew(
            seen.seen,
            seen.believed,
            seen.mid_exposure_utc,
            own if math.isfinite(own) else WORST_CENTER_ARCSEC,
        )

    async def _wait_ahead(self) -> None:
        """Slew to where the target will come by, look how far off that is, and wait for it there."""
        clock, policy, pace = self._clock, self._policy, self._slewing.pace
        here = from_mount((await self._mount.reading()).place)
        look_s = pace.until_exposed_s(policy.settle_s) + policy.exposure_s + SOLVED_S
        # the look, and a small slew by what it shows
        comes = self._comes(here, look_s + pace.slew_s(3600.0))
        if comes >= self._until:
            comes = self._comes(here, 0.0)
        if comes >= self._until:
            lead_s = (comes - clock.utc()).total_seconds()
            raise BadRequest(
                f"{self._target.name} ends before the telescope could reach its path ({lead_s:.0f} s)",
                advice="nothing was moved; order it earlier, to wait for it",
            )
        ahead = self._path(comes)
        self._side = await self._slewing.side_at(ahead)
        self._beside = self._beside_before(ahead, self._side)
        self._tell("waiting", f"slews ahead of it, to wait for {comes:%H:%M:%S} UTC")
        await self._slewing.slew(ahead, self._beside.aim(ahead, comes))
        self._require_wanted()
        comes = await self._look_ahead(comes, look_s)
        reading = await self._mount.reading()
        self._side = reading.side
        seen = self._beside.looks(from_mount(reading.place), reading.utc)
        self._tube = TubeEstimate.of(for_mount(seen, self._mount.epoch, reading.utc), reading.utc, 5.0)
        stated = math.sqrt(2.0) * self._beside.sigma_arcsec(seen, reading.utc)
        if stated > max(MOST_VAGUE_ARCSEC, self._tolerance):
            self._note(
                f"no look shows how it points there: it may be {stated / 60.0:.0f}′ off (one sigma); "
                "center a place on the path before the pass"
            )
        await self._pause_unwoken((comes - clock.utc()).total_seconds() - READY_S)
        await self._get_ready()
        await self._pause_unwoken((comes - clock.utc()).total_seconds())

    async def _get_ready(self) -> None:
        """Order a rate that is next to none: what a first order takes is over when the target comes."""
        now = self._clock.utc()
        ends = min(now + timedelta(seconds=HELD_S), self._until + timedelta(seconds=BEYOND_S))
        ahead = separation_arcsec(from_mount((await self._mount.reading()).place), self._path(now))
        if ahead > READY_ARCSEC:
            return  # so far from its path the mount takes no rates along it: the first order begins them
        rates = OffsetRates(
            0.0,
            math.copysign(READY_ARCSEC_S, mount_rates(self._path, now, self._mount.epoch, 1.0).dec_arcsec_s),
        )
        await self._mount.set_offset_rates(rates, ends_utc=ends, path=self._path)
        self._in_force = True
        self._order_s = max(0.05, min(self._order_s, (self._clock.utc() - now).total_seconds()))

    def _comes(self, here: Icrs, more_s: float) -> datetime:
        """When the target comes by a place that can be reached before it, with so much time besides."""
        lead_s = WAIT_AHEAD_S
        for _ in range(4):
            comes = self._clock.utc() + timedelta(seconds=lead_s)
            way = separation_arcsec(here, self._path(min(comes, self._until)))
            lead_s = 1.2 * self._slewing.pace.slew_s(way) + WAIT_AHEAD_S + more_s
        return self._clock.utc() + timedelta(seconds=lead_s)

    async def _look_ahead(self, comes: datetime, look_s: float) -> datetime:
        """Look where the tube waits, and put right what that shows; when the target comes there at last."""
        clock, policy = self._clock, self._policy
        for _ in range(LOOKS_AHEAD):
            if (comes - clock.utc()).total_seconds() < look_s:
                return comes
            await self._pause_unwoken(policy.settle_s)
            found = await self._looked(policy.exposure_s)
            if found is None:
                continue
            sigma = found.solution.center_sigma_arcsec
            if not self._weighed(found, sigma if math.isfinite(sigma) else WORST_CENTER_ARCSEC, 0.0):
                continue
            off = separation_arcsec(found.seen, self._path(comes))
            if off <= self._tolerance:
                return comes
            # what is left of the time is for the slew; the target comes by later, if it takes longer
            earliest = clock.utc() + timedelta(seconds=self._slewing.pace.slew_s(off) + 0.5 * WAIT_AHEAD_S)
            comes = max(comes, earliest)
            if comes >= self._until:
                raise BadRequest(
                    f"{self._target.name} ends before the telescope could reach its path",
                    advice="order it earlier, to wait for it",
                )
            ahead = self._path(comes)
            self._tell("waiting", f"seen {off:.0f}″ off: put right, to wait for {comes:%H:%M:%S} UTC")
            await self._slewing.slew(ahead, self._beside.aim(ahead, comes))
            self._require_wanted()
        return comes

    def _weighed(self, found: Look, sigma_arcsec: float, along_arcsec: float) -> bool:
        """Take in how far beside its belief a look saw the tube; whether it counts yet.

        Parameters
        ----------
        sigma_arcsec : float
            Of the look.
        along_arcsec : float
            What it is off by besides along the target's way, one sigma: its instant. 0 of a tube that waits.
        """
        decision = self._equipment.guard.consider(found, SyncTrigger.CENTERING, target=self._key)
        against = [doubt for doubt in decision.against_the_sky if doubt not in OF_A_MOVING_TUBE]
        if against:
            self._miss(f"it is doubted: {'; '.join(decision.words[doubt] for doubt in against)}")
            return False
        utc, before = found.mid_exposure_utc, self._odd
        thought = self._beside.looks(found.believed, utc)
        total = math.hypot(sigma_arcsec, along_arcsec)
        allowed = math.hypot(self._beside.sigma_arcsec(thought, utc), total)
        off = separation_arcsec(thought, found.seen)
        if off <= min(ODD_SIGMAS * math.sqrt(2.0) * allowed, max(MOST_VAGUE_ARCSEC, 3.0 * total)):
            if along_arcsec > 0.0:
                ahead = self._path(min(utc + timedelta(seconds=1.0), self._until))
                self._beside = self._beside.seen_on_the_way(
                    found.seen, found.believed, utc, sigma_arcsec, along_arcsec, ahead
                )
            else:
                self._beside = self._beside.seen(found.seen, found.believed, utc, sigma_arcsec)
        elif before is not None:
            alone = self._beside.anew(before.seen, before.believed, before.mid_exposure_utc, total)
            again = separation_arcsec(alone.looks(found.believed, utc), found.seen)
            if again > ODD_SIGMAS * math.hypot(alone.sigma_arcsec(found.seen, utc), total):
                self._odd = found
                return False
            self._beside = self._beside.anew(found.seen, found.believed, utc, total)
        else:
            self._odd = found
            return False
        self._odd, self._slewing.seen = None, found
        return True

    # -- steering ------------------------------------------------------------------------------------

    async def _steer(self) -> None:
        """Send what the mount needs, again and again, until the end."""
        while True:
            self._require_wanted()
            woken = self._wake.is_set()
            self._wake.clear()
            left_s = (self._until - self._clock.utc()).total_seconds()
            if left_s <= 0.0:
                async with self._hand:
                    await self._over()
                return
            async with self._hand:
                match self._by:
                    case FollowBy.RATES:
                        wait_s = await self._renew(woken)
                    case FollowBy.PULSES:
                        wait_s = await self._pulse()
                    case FollowBy.SLEWS:
                        wait_s = await self._slew_on()
            left_s = (self._until - self._clock.utc()).total_seconds()
            await self._pause(max(0.0, min(wait_s, left_s)))

    async def _renew(self, woken: bool) -> float:
        """Read the mount, and order the rates for the next while if it is time; how long to wait.

        Parameters
        ----------
        woken : bool
            Whether something is new: then it is time.
        """
        plan, mount, clock = self.plan, self._mount, self._clock
        assert plan is not None
        if self._in_force and mount.offset_rates_in_force is None:
            self._in_force = False
            raise Cancelled(
                "the rates were ended by something else: a stop, a limit, a lost link",
                device=mount.name,
                advice="see the journal for what; order it again when it is safe",
            )
        await self._read_on(plan)
        if self._by is not FollowBy.RATES:
            # its readings have shown that it keeps none: nothing goes out any more
            return 0.0
        left_s = self._renew_at_s - clock.monotonic_s()
        if self._in_force and not woken and not plan.fast and left_s > SHORTEST_S:
            return min(left_s, self._read_in_s)
        now = clock.utc()
        # they take effect about in the middle of the order: what counts is where both are then
        takes = now + timedelta(seconds=0.5 * self._order_s)
        off = self._off_at(takes, self._path(min(takes, self._until)))
        span_s, catch = plan.renew_s, Offset(0.0, 0.0)
        steady = self._steady
        # once: where wrong rates lead away, each look would ask for more of them, and nothing be judged
        begun = self._leg_from is not None or clock.monotonic_s() > self._catch_until_s
        if off.total_arcsec > DEAD_SHARE * self._tolerance and not (steady and begun):
            if plan.fast:
                most = max(MOST_CATCH_UP_ARCSEC_S, FAST_CATCH_UP_SHARE * self._speed(now))
                within_s = max(FAST_CATCH_UP_S, off.total_arcsec / most)
                span_s = min(span_s, 0.5 * FAST_CATCH_UP_S)
            else:
                span_s = within_s = max(CATCH_UP_S, off.total_arcsec / MOST_CATCH_UP_ARCSEC_S)
            catch = Offset(-off.east_arcsec / within_s, -off.north_arcsec / within_s)
            self._catch_until_s = min(self._catch_until_s, clock.monotonic_s() + 0.5 * within_s)
        span_s = max(SHORTEST_S, 2.0 * self._order_s, min(span_s, (self._until - now).total_seconds()))
        wanted = mount_rates(self._path, takes, mount.epoch, span_s)
        assert self._tube is not None
        drift_east, drift_north = self._tube.drift_arcsec_s
        dec_deg = for_mount(self._path(now), mount.epoch, now).dec_deg
        if steady:
            drift_east = drift_north = 0.0
        if plan.fast:
            drift_east, drift_north = self._creep.east_arcsec, self._creep.north_arcsec
        more = rates_on_sky(catch.east_arcsec - drift_east, catch.north_arcsec - drift_north, dec_deg)
        wanted = OffsetRates(wanted.ra_arcsec_s + more.ra_arcsec_s, wanted.dec_arcsec_s + more.dec_arcsec_s)
        wanted = self._bounded(wanted)
        sent = self._rates.sent(wanted, dec_deg, self._side)
        ends = now + timedelta(seconds=max(HELD_S, 3.0 * span_s))
        ends = min(self._until + timedelta(seconds=BEYOND_S), ends)
        try:
            await mount.set_offset_rates(sent, ends_utc=ends, path=self._path)
        except DeviceRefused as error:
            self._require_wanted()
            if error.reason is Refusal.UNTRUSTED or plan.instead is None:
                raise
            await self._fall_back(f"the mount refused the rates: {error.what}")
            return 0.0
        done = clock.utc()
        # its steps may have rounded them
        sent = sent if sent.none else mount.offset_rates_told or sent
        kept = self._rates.kept(sent, dec_deg, self._side)
        wrong = OffsetRates(kept.ra_arcsec_s - wanted.ra_arcsec_s, kept.dec_arcsec_s - wanted.dec_arcsec_s)
        left_arcsec_s = offset_speed_arcsec_s(wrong, dec_deg)
        if self._corrects and left_arcsec_s > TOO_COARSE * offset_speed_arcsec_s(wanted, dec_deg):
            await self._fall_back(f"the mount's steps are too coarse to make this good: {self._rates.words}")
            await self._hop()
            return 0.0
        if not steady and left_arcsec_s > 0.0:
            # what its steps leave is made good by the next order
            span_s = min(span_s, max(CATCH_UP_S, LEFT_SHARE * self._tolerance / left_arcsec_s))
        otherwise = bool(self._sent) and _unlike(sent, self._sent[-1].rates)
        if otherwise and not plan.fast:
            # caught up, tried, withdrawn: its readings are the first to tell what comes of it
            reading = await mount.reading()
            place = for_mount(from_mount(reading.place), mount.epoch, reading.utc)
            sigma = max(2.0, mount.resolution_arcsec)
            self._changed = RateLook(reading.utc, place, sigma, reading.side)
        at = now + 0.5 * (done - now)
        self._order_s += 0.3 * ((done - now).total_seconds() - self._order_s)
        self._in_force = not sent.none
        self._sent.append(OrderedRates(at, sent))
        self._kept.append(OrderedRates(at, kept))
        self._renewed += 1
        if self._leg_from is None and (not steady or catch.total_arcsec == 0.0):
            self._leg_from = at
        self._prune(at)
        self._renew_at_s = clock.monotonic_s() + span_s
        return span_s if plan.fast else min(span_s, self._read_in_s)

    @property
    def _corrects(self) -> bool:
        """Whether something else is sent than what the mount is to keep."""
        correction = self._rates.correction
        return correction is not None and correction.holds(self._side)

    @property
    def _read_in_s(self) -> float:
        """How long until the mount is read: soon after its rates have changed."""
        since_s = (self._clock.utc() - self._sent[0].since_utc).total_seconds() if self._sent else 0.0
        blind = self.plan is not None and self._blind(self.plan)
        early = blind or self._changed is not None or since_s < 4.0 * ALARM_AFTER_S
        return ALARM_AFTER_S if early else READ_EVERY_S

    @property
    def _steady(self) -> bool:
        """Whether rates are to be judged before anything else is done by them."""
        plan = self.plan
        if self._verified or (plan is not None and (plan.fast or self._blind(plan))):
            return False
        early = self._judgement is None or self._judgement.verdict == "too-early"
        return not (early and len(self._leg) >= FIRST_LOOKS)

    def _bounded(self, wanted: OffsetRates) -> OffsetRates:
        most = self._mount.most_offset_arcsec_s
        if most is None:
            return wanted
        return OffsetRates(
            max(-most.ra_arcsec_s, min(most.ra_arcsec_s, wanted.ra_arcsec_s)),
            max(-most.dec_arcsec_s, min(most.dec_arcsec_s, wanted.dec_arcsec_s)),
        )

    async def _read_on(self, plan: FollowPlan) -> None:
        """What the mount's own readings show: where it is by a fast target, else whether all goes wrong."""
        if not self._sent or not self._in_force:
            return
        if not plan.fast and self._changed is not None and not self._blind(plan):
            await self._read_on_changed(self._changed)
            return
        since_s = (self._clock.utc() - self._sent[0].since_utc).total_seconds()
        if not plan.fast and self._blind(plan):
            await self._read_on_blind()
            return
        if not plan.fast and since_s > 4.0 * ALARM_AFTER_S:
            await self._read_on_later()
            return
        reading = await self._mount.reading()
        self._side = reading.side
        seen = self._beside.looks(from_mount(reading.place), reading.utc)
        place = for_mount(seen, self._mount.epoch, reading.utc)
        if plan.fast:
            await self._read_on_fast(place, seen, reading.utc)
            return
        assert self._tube is not None
        thought = self._tube.at(reading.utc, self._kept)
        led_s = max((reading.utc - self._sent[0].since_utc).total_seconds(), 1e-3)
        rates = self._sent[-1].rates
        cosine = math.cos(math.radians(place.dec_deg))
        speed = math.hypot(rates.ra_arcsec_s * cosine, rates.dec_arcsec_s)
        wrong = separation_arcsec(from_mount(place), from_mount(thought))
        if since_s >= 0.5 * ALARM_AFTER_S and wrong > ALARM_FACTOR * speed * led_s + ALARM_ARCSEC_S * led_s:
            await self._alarm(place, reading.utc, wrong, led_s)

    def _blind(self, plan: FollowPlan) -> bool:
        """Whether no look can be taken: the stars would be drawn out however short it is."""
        return self._exposure_s(plan) < min(SHORTEST_LOOK_S, self._policy.exposure_s)

    async def _read_on_blind(self) -> None:
        """Where the mount is, and whether it goes as it was ordered: no look will say so."""
        assert self._tube is not None
        reading = await self._mount.reading()
        self._side = reading.side
        sigma = max(2.0, self._mount.resolution_arcsec)
        place = for_mount(from_mount(reading.place), self._mount.epoch, reading.utc)
        then, now = self._read, RateLook(reading.utc, place, sigma, reading.side)
        self._read = now
        if self._anchor is None or self._anchor.utc < self._kept[0].since_utc:
            self._anchor, self._slips = now, 0
        if then is not None and then.utc >= self._kept[0].since_utc:
            led_s = (now.utc - then.utc).total_seconds()
            thought = TubeEstimate.of(then.place, then.utc, sigma).at(now.utc, self._kept)
            wrong = separation_arcsec(from_mount(place), from_mount(thought))
            rates = self._kept[-1].rates
            speed = offset_speed_arcsec_s(rates, place.dec_deg)
            slips = wrong > SLIP_SHARE * speed * led_s + SLIP_S * speed + 2.0 * sigma
            self._slips = self._slips + 1 if slips else 0
            if self._slips >= SLIPS:
                await self._alarm(place, now.utc, wrong, led_s)
                return
        seen = self._beside.looks(from_mount(reading.place), reading.utc)
        here = for_mount(seen, self._mount.epoch, reading.utc)
        self._tube = self._tube.moved_to(here, reading.utc, sigma)

    async def _read_on_later(self) -> None:
        """Whether since the last reading the mount went as it was told."""
        try:
            reading = await self._mount.reading()
        except (DeviceSilent, DeviceGarbled):
            return  # one answer that was lost ends nothing: the next reading, or the next order, says more
        self._side = reading.side
        then, sigma = self._read, max(2.0, self._mount.resolution_arcsec)
        place = for_mount(from_mount(reading.place), self._mount.epoch, reading.utc)
        now = self._read = RateLook(reading.utc, place, sigma, reading.side)
        slewed, self._slewed = self._slewed, bool(reading.slewing)
        if then is None or then.utc < self._kept[0].since_utc:
            return
        led_s = (now.utc - then.utc).total_seconds()
        thought = TubeEstimate.of(then.place, then.utc, sigma).at(now.utc, self._kept)
        cosine = math.cos(math.radians(place.dec_deg))
        speed = max(
            math.hypot(one.rates.ra_arcsec_s * cosine, one.rates.dec_arcsec_s) for one in self._kept[-2:]
        )
        wrong = separation_arcsec(from_mount(place), from_mount(thought))
        if wrong > (ALARM_FACTOR * speed + ALARM_ARCSEC_S) * led_s + 2.0 * sigma:
            # some say that they slew as long as they track at rates of their own
            sets_out = reading.slewing and not slewed
            if sets_out or {then.side, now.side} == {PierSide.EAST, PierSide.WEST}:
                await self._set_out_by_itself()
                return
            self._anchor = then
            await self._alarm(place, now.utc, wrong, led_s)
            self._anchor = None

    async def _set_out_by_itself(self) -> None:
        """It slews or has changed sides by itself, rates in force: that says nothing of them. Slew back."""
        await self._mount.end_offset_rates()
        self._in_force = False
        self._note(
            "the mount slewed by itself, as it does to change sides of the pier: its rates were ended, and "
            "it was slewed back to the target"
        )
        await self._hop()

    async def _read_on_changed(self, then: RateLook) -> None:
        """Whether what it is sent otherwise than before leads it away."""
        led_s = (self._clock.utc() - then.utc).total_seconds()
        if led_s < 0.5 * ALARM_AFTER_S:
            return
        self._changed = None
        if led_s > 4.0 * ALARM_AFTER_S:
            return
        reading = await self._mount.reading()
        self._side = reading.side
        place = for_mount(from_mount(reading.place), self._mount.epoch, reading.utc)
        thought = TubeEstimate.of(then.place, then.utc, then.sigma_arcsec).at(reading.utc, self._kept)
        rates = self._kept[-1].rates
        speed = math.hypot(rates.ra_arcsec_s * math.cos(math.radians(place.dec_deg)), rates.dec_arcsec_s)
        wrong = separation_arcsec(from_mount(place), from_mount(thought))
        led_s = max((reading.utc - then.utc).total_seconds(), 1e-3)
        if wrong > (ALARM_FACTOR * speed + ALARM_ARCSEC_S) * led_s + 2.0 * then.sigma_arcsec:
            self._anchor = then
            await self._alarm(place, reading.utc, wrong, led_s)
            self._anchor = None

    async def _read_on_fast(self, place: Apparent | Icrs, seen: Icrs, utc: datetime) -> None:
        """Where the mount is by a fast target; whether it goes as it was ordered."""
        assert self._tube is not None
        speed, resolution = self._speed(utc), self._mount.resolution_arcsec
        self._stated.append(self._stated_arcsec(seen, utc, speed))
        if self._anchor is None:
            self._anchor = RateLook(utc, place, max(2.0, resolution), self._side)
        thought = self._tube.at(utc, self._kept)
        went = offset_arcsec(from_mount(place), from_mount(thought))
        wrong = went.total_arcsec
        since_s = max((utc - self._tube.utc).total_seconds(), 0.0)
        if self._by_reading and since_s > LEAST_SPAN_S and wrong <= SLIP_SHARE * speed * since_s:
            # axes that aren't the sky's turn what rates come to, and orders take effect late
            keep = 1.0 - CREEP_SHARE
            self._creep = Offset(
                keep * self._creep.east_arcsec + CREEP_SHARE * went.east_arcsec / since_s,
                keep * self._creep.north_arcsec + CREEP_SHARE * went.north_arcsec / since_s,
            )
        self._by_reading = True
        slack = (SLIP_SHARE * speed + ALARM_ARCSEC_S) * since_s + SLIP_S * speed + 2.0 * resolution
        self._slips = self._slips + 1 if wrong > slack else 0
        if self._slips >= SLIPS:
            self._slips = 0
            led_s = max((utc - self._anchor.utc).total_seconds(), 1e-3)
            await self._alarm(place, utc, wrong, led_s)
            return
        # orders take effect late by what nobody knows: at such speeds the reading says more than the count
        self._tube = self._tube.moved_to(place, utc, max(1.0, 0.5 * resolution, 0.02 * speed))

    def _speed(self, utc: datetime) -> float:
        """How fast the target moves over the sky then, ″/s."""
        first = self._path(utc)
        return separation_arcsec(first, self._path(utc + timedelta(seconds=1.0)))

    def _stated_arcsec(self, seen: Icrs, utc: datetime, speed: float) -> float:
        """How far a tube that follows by its readings may be off, one sigma: all that is known of it."""
        plan = self.plan
        left = 0.0 if plan is None else plan.left_arcsec
        ends = self._target.ends_utc
        own = self._target.sigma_arcsec(utc if ends is None else min(utc, ends))
        return math.hypot(
            math.sqrt(2.0) * self._beside.sigma_arcsec(seen, utc), TIME_SIGMA_S * speed, own, left
        )

    async def _alarm(self, place: Apparent | Icrs, utc: datetime, wrong_arcsec: float, led_s: float) -> None:
        """The mount says itself that it goes elsewhere: end that, and name what it is if that can be."""
        begin, ordered = self._sent[0].since_utc, list(self._sent)
        assert self._tube is not None
        sigma = max(2.0, self._mount.resolution_arcsec)
        first = self._anchor
        if first is None:
            from_here = self._tube.at(begin, self._kept)
            if isinstance(from_here, Apparent):
                from_here = replace(from_here, utc=begin)
            first = RateLook(begin, from_here, sigma, self._side)
        judged = judge_rates(
            ordered, [first, RateLook(utc, place, sigma, self._side)], doubts=self._rates.doubts
        )
        words = (
            f"the mount itself says that it is {wrong_arcsec:.0f}″ from where {led_s:.1f} s of its rates lead"
        )
        await self._mount.end_offset_rates()
        self._in_force = False
        self._note(f"{words}; {judged.words}")
        self._alarms += 1
        known = self._rates.correction
        await self._judged(judged)
        corrected = self._rates.correction not in (None, known)
        if self._alarms > 1 and self._by is FollowBy.RATES and not corrected:
            await self._fall_back(words)
        await self._hop()

    async def _pulse(self) -> float:
        plan, mount = self.plan, self._mount
        assert plan is not None
        guide = mount.guide_rates_deg_s
        assert guide is not None
        now = self._clock.utc()
        ahead = now + timedelta(seconds=0.5 * plan.renew_s)
        off = self._off_at(ahead, self._path(min(ahead, self._until)))
        dec_deg = for_mount(self._path(now), mount.epoch, now).dec_deg
        cosine = max(0.01, math.cos(math.radians(dec_deg)))
        ways = (
            (Direction.EAST, Direction.WEST, off.east_arcsec / cosine, guide[0]),
            (Direction.NORTH, Direction.SOUTH, off.north_arcsec, guide[1]),
        )
        for ahead_of, behind, off_arcsec, rate_deg_s in ways:
            direction = ahead_of if off_arcsec < 0.0 else behind
            seconds = min(abs(off_arcsec) / (3600.0 * rate_deg_s), 0.5 * plan.renew_s)
            if seconds < SHORTEST_PULSE_S:
                continue
            began = self._clock.utc()
            await mount.guide(direction, seconds)
            self._renewed += 1
            sign = 1.0 if direction in (Direction.EAST, Direction.NORTH) else -1.0
            rate = sign * 3600.0 * rate_deg_s
            primary = ahead_of is Direction.EAST
            moved = OffsetRates(rate, 0.0) if primary else OffsetRates(0.0, rate)
            self._kept += [
                OrderedRates(began, moved),
                OrderedRates(began + timedelta(seconds=seconds), STARS_RATES),
            ]
        self._prune(now)
        return max(0.0, plan.renew_s - (self._clock.utc() - now).total_seconds())

    async def _slew_on(self) -> float:
        plan = self.plan
        assert plan is not None
        now = self._clock.utc()
        if self._off_now(now).total_arcsec > 0.5 * self._tolerance:
            # a little ahead of it, so that it passes
            await self._hop(min(plan.renew_s, 0.4 * self._tolerance / max(plan.fastest_arcsec_s, 1e-6)))
        return max(1.0, min(plan.renew_s, 0.5 * self._tolerance / max(plan.fastest_arcsec_s, 1e-6)))

    async def _hop(self, ahead_s: float = 0.0) -> None:
        """Slew back to the target, by how far beside the mount's belief the tube was seen to look.

        Parameters
        ----------
        ahead_s : float
            To where it will be so long after the slew.
        """
        pace = self._slewing.pace
        ahead = self._clock.utc() + timedelta(seconds=pace.slew_s(60.0) + ahead_s)
        place = self._path(min(ahead, self._until))
        aim = self._beside.aim(place, ahead)
        self._in_force = False
        await self._slewing.slew(place, aim)
        self._require_wanted()
        self._renewed += 1
        reading = await self._mount.reading()
        self._side = reading.side
        seen = self._beside.looks(from_mount(reading.place), reading.utc)
        assert self._tube is not None
        sigma = max(2.0, self._mount.resolution_arcsec)
        self._tube = self._tube.moved_to(for_mount(seen, self._mount.epoch, reading.utc), reading.utc, sigma)
        self._begin_leg()

    def _begin_leg(self) -> None:
        """What was seen before says nothing of the rates any more."""
        self._sent, self._kept, self._leg, self._leg_from = [], [], [], None
        self._catch_until_s = math.inf
        self._anchor, self._slips, self._played = None, 0, None
        self._changed = self._read = None
        self._creep, self._by_reading = Offset(0.0, 0.0), False

    def _prune(self, utc: datetime) -> None:
        """Forget what was ordered long before the first look that counts."""
        first = self._leg[0].utc if self._leg else utc - timedelta(seconds=300.0)
        if self._tube is not None:
            first = min(first, self._tube.utc)
        for orders in (self._sent, self._kept):
            while len(orders) > 2 and orders[1].since_utc < first:
                orders.pop(0)

    # -- where it is ---------------------------------------------------------------------------------

    def _off_now(self, now: datetime) -> Offset:
        return self._off_at(now, self._path(now))

    def _off_at(self, utc: datetime, target: Icrs) -> Offset:
        """How far the tube looks from the target, as far as is known."""
        assert self._tube is not None
        return offset_arcsec(from_mount(self._tube.at(utc, self._kept)), target)

    # -- looking -------------------------------------------------------------------------------------

    async def _look_on(self) -> None:
        """Look, and judge, until the end."""
        plan = self.plan
        assert plan is not None
        if plan.fast:
            await self._look_on_streaks()
            return
        await self._pause_unwoken(CATCH_UP_S + ALARM_AFTER_S)
        while True:
            began_s = self._clock.monotonic_s()
            exposure_s = self._exposure_s(plan)
            left_s = (self._until - self._clock.utc()).total_seconds()
            if left_s <= exposure_s + 1.0 or exposure_s < min(SHORTEST_LOOK_S, self._policy.exposure_s):
                await self._until_the_end()
                return
            if self._by is FollowBy.RATES:
                found = await self._looked(exposure_s)
            else:
                # neither pulses nor slews while it is exposed
                async with self._hand:
                    found = await self._looked(exposure_s)
            if found is not None:
                await self._took(found)
                await self._stands(found)
            else:
                await self._doubt_trial()
                await self._doubt_rates()
            judged = self._judgement is not None and self._judgement.verdict == "right"
            soon = self._looks < FIRST_LOOKS and not judged
            every_s = min(self._look_every_s, 15.0) if soon else self._look_every_s
            spent_s = self._clock.monotonic_s() - began_s
            await self._pause_unwoken(
                min(max(0.0, every_s - spent_s), (self._until - self._clock.utc()).total_seconds())
            )

    async def _look_on_streaks(self) -> None:
        """Look on a fast pass, by the middle of streaks: each look says how far beside the readings it is."""
        await self._pause_unwoken(FAST_CATCH_UP_S)
        while True:
            began = self._clock.monotonic_s()
            scale = self._scale_arcsec_px()
            speed = self._speed(min(self._clock.utc(), self._until))
            exposure_s = self._policy.exposure_s
            if scale is not None and speed > 0.0:
                exposure_s = min(exposure_s, max(SHORTEST_STREAK_S, MOST_STREAK_PX * scale / speed))
            left_s = (self._until - self._clock.utc()).total_seconds()
            if scale is None or left_s <= exposure_s + 1.0:
                await self._until_the_end()
                return
            found = await self._looked(exposure_s)
            if found is not None:
                await self._took_streak(found, speed)
                await self._stands(found)
            spent_s = self._clock.monotonic_s() - began
            left_s = (self._until - self._clock.utc()).total_seconds()
            await self._pause_unwoken(min(max(0.0, STREAK_EVERY_S - spent_s), max(0.0, left_s)))

    async def _stands(self, found: Look) -> None:
        """How the image of a look stands: where the mount turns the field, a rotator turns with it."""
        if self._derotation is not None:
            await self._derotation.seen(found)

    async def _took_streak(self, found: Look, speed: float) -> None:
        """What a look on a fast pass shows; along its way no better than its instant is known."""
        self._missed = 0
        utc, own = found.mid_exposure_utc, found.solution.center_sigma_arcsec
        sigma = math.hypot(own if math.isfinite(own) else WORST_CENTER_ARCSEC, TIME_SIGMA_S * speed)
        off = separation_arcsec(found.seen, self._path(min(utc, self._until)))
        async with self._hand:
            self._require_wanted()
            if not self._kept or utc < self._kept[0].since_utc:
                return
            # a clock that is off is off for each look: it hides from all of them, and none counts less for it
            own = max(own, LEAST_STREAK_ARCSEC) if math.isfinite(own) else WORST_CENTER_ARCSEC
            if not self._weighed(found, own, JITTER_S * speed):
                self._tell("following", "a look is far from what was known: the next one decides")
                return
            self._looks += 1
            self._off = (off, sigma)
            if self._looks > 1:
                self._offs.append(off)
            assert self._tube is not None
            # the next reading says where it is by that; how fast it goes, the one after it
            self._by_reading = False
            self._tell("following", f"{off:.0f}″ off", found)
        self._wake.set()

    def _scale_arcsec_px(self) -> float | None:
        normal = self._equipment.guard.learned.normal
        return self._policy.scale_arcsec_px if normal is None else normal.scale_arcsec_px

    def _exposure_s(self, plan: FollowPlan) -> float:
        """As long as stars are not drawn out too far."""
        scale = self._scale_arcsec_px()
        if scale is None or plan.fastest_arcsec_s <= 0.0:
            return self._policy.exposure_s
        return min(self._policy.exposure_s, MOST_TRAIL_PX * scale / plan.fastest_arcsec_s)

    async def _looked(self, exposure_s: float) -> Look | None:
        """One look; None if it can't be used, which is told and does no harm."""
        plan = self.plan
        speed = 0.0 if plan is None else plan.fastest_arcsec_s
        shot = LookOptions(
            exposure_s,
            self._policy.search_radius_deg,
            used="following",
            teaches=False,
            following_arcsec=2.0 * (speed + MOST_CATCH_UP_ARCSEC_S) * (exposure_s + 5.0),
        )
        try:
            taken = await expose_and_solve(self._equipment, self._policy, shot)
        except (BadFrame, MountMoved, SolveFailed, SyncRefused) as error:
            self._miss(error.what)
            return None
        if taken.look is None:
            self._trailed += taken.verdict.reason is Reason.TRAILED
            self._miss(taken.verdict.detail or str(taken.verdict.reason))
            return None
        return taken.look

    def _miss(self, why: str) -> None:
        self._unsolved += 1
        self._missed += 1
        if self._missed in (1, MISSES):
            self._note(f"{self._missed} look(s) in a row could not be used: {why}")
        self._tell(self._phase, f"a look could not be used: {why}")

    @property
    def _on_trial(self) -> bool:
        """Whether rates are sent by a guess that no look has confirmed yet."""
        trial = self._trial
        return trial is not None and self._rates.correction is trial and not self._rates.confirmed

    async def _doubt_trial(self) -> None:
        """Give a guess up since which a look showed nothing: it may lead away, and draw the stars out.

        A mount that takes fast rates rightly, and slow ones not at all, went on so at 15 times the target's.
        """
        if not self._on_trial:
            return
        async with self._hand:
            self._require_wanted()
            trial = self._trial
            assert trial is not None
            why = f"a look showed nothing while it was tried whether {trial.words}"
            await self._learned(lambda: self._rates.withdraw(f"withdrawn: {why}"))
            self._kept = list(self._sent)
            await self._fall_back(why)
            await self._hop()
        self._wake.set()

    async def _doubt_rates(self) -> None:
        """Give up rates that no look has confirmed while stars are drawn out, look after look."""
        unproven = self._by is FollowBy.RATES and not self._verified
        if self._trailed < MOST_TRAILED or not (unproven and self._in_force):
            return
        async with self._hand:
            self._require_wanted()
            await self._fall_back(
                f"{self._trailed} looks in a row show stars that are drawn out, and none has shown that the "
                "mount keeps its rates"
            )
            await self._hop()
        self._wake.set()

    async def _took(self, found: Look) -> None:
        """What a look shows: how far off it is, and at which rates the mount went."""
        mount, utc = self._mount, found.mid_exposure_utc
        self._missed = self._trailed = 0
        sigma = found.solution.center_sigma_arcsec
        off = offset_arcsec(found.seen, self._path(min(utc, self._until)))
        far = max(HOP_ARCSEC, HOP_TOLERANCES * self._tolerance)
        async with self._hand:
            self._require_wanted()
            if self._kept and utc < self._kept[0].since_utc and self._sent:
                return  # exposed before the last slew
            self._looks += 1
            self._off = (off.total_arcsec, sigma)
            if self._looks > 1:
                self._offs.append(off.total_arcsec)
            self._side = found.after.side
            self._beside = self._beside.anew(found.seen, found.believed, utc, max(min(sigma, 5.0), 0.05))
            self._slewing.seen = found
            place = for_mount(found.seen, mount.epoch, utc)
            assert self._tube is not None
            if self._steady:
                self._tube = TubeEstimate.of(place, utc, max(sigma, 0.05))
            else:
                self._tube = self._tube.seen(place, utc, max(sigma, 0.05), self._kept)
            words = f"{off.total_arcsec:.1f}″ off"
            begun = utc - timedelta(seconds=0.5 * (found.exposure_s or self._policy.exposure_s))
            if self._by is FollowBy.RATES and self._leg_from is not None and begun >= self._leg_from:
                words = await self._judge(found, place, sigma, words)
            self._tell("following", words, found)
            if self._may_hop(off.total_arcsec, far):
                self._note(f"{off.total_arcsec:.0f}″ off: slewed back to the target")
                await self._hop()
        self._wake.set()

    def _may_hop(self, off_arcsec: float, far_arcsec: float) -> bool:
        """Whether to slew back: not while the rates are still to be judged by the looks that follow."""
        left_s = (self._until - self._clock.utc()).total_seconds()
        if off_arcsec <= far_arcsec or self._by is FollowBy.SLEWS or left_s < 2.0 * WAIT_AHEAD_S:
            return False
        known = self._judgement is not None and self._judgement.verdict == "right"
        return self._by is not FollowBy.RATES or known or off_arcsec > 10.0 * far_arcsec

    async def _judge(self, found: Look, place: Apparent | Icrs, sigma: float, words: str) -> str:
        solution = found.solution
        trail = trail_of(
            found.verdict.quality,
            scale_arcsec_px=solution.scale_arcsec_px,
            rotation_deg=solution.rotation_deg,
            parity=solution.parity,
            exposure_s=found.exposure_s or self._policy.exposure_s,
        )
        if self._leg and self._leg_side is not self._side:
            # it changed sides while it tracked: from here on it may keep other rates
            self._leg = []
        self._leg_side = self._side
        # wind and optics draw stars out, too: a trail speaks where there are no two centers yet, and moves
        # nothing
        self._leg.append(
            RateLook(found.mid_exposure_utc, place, sigma, self._side, None if self._leg else trail)
        )
        del self._leg[:-LEG_LOOKS]
        # held against what the mount makes of what it was sent, by the correction in force
        judged = self._judgement_of()
        if judged.verdict not in ("right", "too-early"):
            out = self._out_of_play(found.mid_exposure_utc)
            if out is None:
                judged = self._judgement_of(in_play=True)
            elif self._leg[0].utc < out and self._judgement_of(in_play=True).verdict == "too-early":
                # those before tell of the play, too
                self._leg = [one for one in self._leg if one.utc >= out] or self._leg[-1:]
                judged = self._judgement_of()
        await self._judged(judged)
        return f"{words}; {judged.words}"

    def _judgement_of(self, *, in_play: bool = False) -> RatesJudgement:
        return judge_rates(
            self._kept,
            self._leg_looks(),
            doubts=self._rates.doubts,
            kept_before=self._kept_before,
            in_play=in_play,
            since="begin",
        )

    def _out_of_play(self, utc: datetime) -> datetime | None:
        """When the declination's gear had turned one way for longer than any play; None: it hasn't."""
        way, sign = 0.0, 0.0
        out: datetime | None = None
        if self._played is not None:
            (sign, out), way = self._played, MOST_PLAY_ARCSEC
        for number, one in enumerate(self._kept):
            if one.since_utc >= utc:
                break
            rate = one.rates.dec_arcsec_s
            if rate == 0.0:
                continue
            if math.copysign(1.0, rate) != sign:
                way, sign, out = 0.0, math.copysign(1.0, rate), None
            later = self._kept[number + 1].since_utc if number + 1 < len(self._kept) else utc
            before, way = way, way + abs(rate) * (min(later, utc) - one.since_utc).total_seconds()
            if before < MOST_PLAY_ARCSEC <= way:
                out = one.since_utc + timedelta(seconds=(MOST_PLAY_ARCSEC - before) / abs(rate))
        # orders of long ago are forgotten, that isn't
        self._played = None if out is None else (sign, out)
        return out

    def _leg_looks(self) -> list[RateLook]:
        """The looks that count; with their trails as long as there are no two."""
        return self._leg if len(self._leg) == 1 else [replace(one, trail=None) for one in self._leg]

    async def _judged(self, judged: RatesJudgement) -> None:
        """Do what a judgement asks for."""
        self._judgement = judged
        rates, plan = self._rates, self.plan
        assert plan is not None
        if judged.verdict == "right":
            self._kept_before = self._verified = True
            if rates.correction is None:
                rates.words = f"seen to keep its rates: {judged.words}"
            elif not rates.confirmed and len(self._leg) >= ENOUGH_TO_CONFIRM:
                self._fault = rates.correction.fault
                self._note(f"confirmed: {rates.correction.words}")
                await self._learned(rates.confirm)
            return
        if judged.verdict == "too-early" or judged.measured is None:
            return
        if rates.correction is not None and rates.correction.holds(self._side):
            was = rates.correction.words
            self._withdrawn[str(rates.correction.fault)] += 1
            self._note(f"the correction is withdrawn, looks contradict it: {judged.words}")
            await self._learned(lambda: rates.withdraw(f"withdrawn ({was}): {judged.words}"))
            # what it made of the numbers that it was sent tells more than what was to come out
            self._kept = list(self._sent)
            raw = judge_rates(self._sent, self._leg_looks(), doubts=rates.doubts)
            if raw.verdict in ("right", "fault") and raw.measured is not None:
                await self._judged(raw)
            if raw.verdict != "right" and self._by is FollowBy.RATES:
                self._begin_anew()
            return
        if judged.verdict == "fault":
            self._fault = judged.fault
            self._note(judged.words)
            if judged.correction is not None and self._withdrawn[str(judged.fault)] < MOST_WITHDRAWN:
                correction = judged.correction
                await self._learned(lambda: rates.try_on(correction))
                self._begin_anew()
                return
            if judged.fault in (RateFault.FORGOTTEN, RateFault.LOST_AT_FLIP):
                self._begin_anew()
                return
            await self._fall_back(judged.words)
            return
        self._wrong += 1
        if judged.trial is not None and not self._tried:
            self._tried = True
            trial = self._trial = judged.trial
            self._missed = 0
            self._note(f"{judged.words}; to tell, it is tried whether {trial.words}")
            await self._learned(lambda: rates.try_on(trial))
            self._begin_anew()
            return
        if self._wrong >= (AMBIGUOUS_LOOKS if judged.verdict == "ambiguous" else ENOUGH_TO_CONFIRM):
            if judged.fault is not None:
                self._fault = judged.fault
            self._note(judged.words)
            await self._fall_back(judged.words)

    def _begin_anew(self) -> None:
        """Rates are ordered otherwise from now on: the looks before say nothing of them."""
        self._leg, self._leg_from, self._verified = [], None, False
        self._catch_until_s = math.inf
        self._wake.set()

    async def _learned(self, change: Callable[[], None]) -> None:
        """Change what is known of the mount's rates, and write it down."""
        was = self._rates.as_dict()
        change()
        now = self._rates.as_dict()
        if now != was:
            facts = {RATES_KEPT: now}
            self._equipment.listen("rates-learned", dict(now))
            await self._equipment.note(EntryKind.LEARNED, self._rates.words, facts)

    async def _fall_back(self, why: str) -> None:
        """Follow by other means: the mount doesn't keep rates, and no order would make that good.

        Raises
        ------
        TargetNotReached
            There are none.
        """
        plan = self.plan
        assert plan is not None
        if self._mount.offset_rates_in_force is not None:
            await self._mount.end_offset_rates()
            self._kept.append(OrderedRates(self._clock.utc(), STARS_RATES))
        self._in_force = False
        if plan.instead is None:
            raise TargetNotReached(
                f"{self._target.name} can't be followed: {why}",
                device=self._equipment.name,
                advice="the mount tracks the stars again; check what its driver does with rates",
                reason=NotReached.OTHER,
            )
        self._by = plan.instead
        last = plan.instead is FollowBy.SLEWS
        self.plan = replace(
            plan, by=plan.instead, instead=None if last else FollowBy.SLEWS, renew_s=PULSE_EVERY_S
        )
        self._leg = []
        self._note(f"followed by {self._by} from here on: {why}")
        self._wake.set()

    # -- small things --------------------------------------------------------------------------------

    def _require_wanted(self) -> None:
        if self._stopped:
            raise Cancelled(
                "following was stopped", device=self._mount.name, advice="order it again when it is safe"
            )

    async def _until_the_end(self) -> None:
        while (left_s := (self._until - self._clock.utc()).total_seconds()) > 0.0:
            await self._clock.sleep(left_s)

    async def _pause_unwoken(self, seconds: float) -> None:
        if seconds > 0.0:
            await self._clock.sleep(seconds)
        self._require_wanted()

    async def _pause(self, seconds: float) -> None:
        """Wait so long, or until something is new."""
        if seconds <= 0.0:
            return
        await first_of(self._clock.sleep(seconds), self._wake.wait())

    def _note(self, words: str) -> None:
        if words not in self.notes:
            self.notes.append(words)
            self._equipment.note_now(EntryKind.DECISION, words, {"target": self._target.name})

    def _tell(self, phase: str, words: str, looked: Look | None = None) -> None:
        self._phase = phase
        now = self._clock.utc()
        event = next((one for one in self._events if one.utc > now), None)
        off, sigma = self._off if self._off is not None else (None, None)
        progress = FollowProgress(
            utc=now,
            phase=phase,
            by=self._by,
            off_arcsec=off,
            off_sigma_arcsec=sigma,
            judgement=self._judgement,
            ordered=self._kept[-1].rates if self._kept else None,
            sent=self._sent[-1].rates if self._sent else None,
            left_s=max(0.0, (self._until - now).total_seconds()),
            next_event="" if event is None else event.words,
            words=words,
        )
        self._equipment.listen("following", progress_facts(progress))
        if looked is not None and self._looks <= MOST_TOLD:
            facts = {"kind": "follow-look", "number": self._looks, **progress_facts(progress)}
            facts |= {"look_id": looked.look_id, "mid_exposure_utc": looked.mid_exposure_utc.isoformat()}
            self._equipment.listen("attempt", facts)
        if self._heard is not None:
            self._heard(progress)

    def _report(self, began: datetime, centered: CenterReport | None, elapsed_s: float) -> FollowReport:
        plan = self.plan
        assert plan is not None
        offs, correction = self._offs, self._rates.correction
        return FollowReport(
            end=self._end,
            target_name=self._target.name,
            began_utc=began,
            ended_utc=self._clock.utc(),
            plan=plan,
            by=self._by,
            centered=centered,
            looks=self._looks,
            unsolved=self._unsolved,
            worst_arcsec=max(offs) if offs else None,
            rms_arcsec=_rms(offs),
            last_arcsec=offs[-1] if offs else None,
            within=sum(one <= self._tolerance for one in offs),
            stated_arcsec=_rms(self._stated),
            tolerance_arcsec=self._tolerance,
            renewed=self._renewed,
            judgement=self._judgement,
            fault=self._fault,
            correction="" if correction is None else correction.words,
            events=self._events,
            notes=tuple(self.notes),
            elapsed_s=elapsed_s,
        )
