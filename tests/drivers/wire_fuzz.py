"""One mount and its fake in memory, with faults at random, kept busy; all that it must never do is noted."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

from drivers.fakes.faults import Fault, Kind, RandomFaults
from drivers.fakes.wire_fake import WireFake
from drivers.generic.language import Language, Sent
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import (
    FREE_ARCSEC,
    STARS_RATES,
    Direction,
    MountReading,
    OffsetRates,
    Skill,
    SlewOutcome,
    SlewState,
    SyncOutcome,
    TrackingRate,
)
from mountnav.errors import DeviceError, DeviceRefused, MountnavError, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors, SyncBehavior
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.virtual_wire import HandClock, MemoryLine

HERE = Site(49.6, 36.9)
LONGEST_S = 1500.0
"""No order may take longer: the longest slew with its time-out, all deadlines in between."""
STOP_S = 0.1
RIGHT_WITHIN_S = 1.0
"""A reading is right when the mount was there so long before or after its instant, or nearly so."""
WRONG_BELIEF_ARCSEC = 12.0 * 3600.0
"""So far a hand at the keys may have moved it between two looks: less is no proof of another belief."""
SYNCS: tuple[SyncBehavior, ...] = ("normal", "normal", "ignore", "half", "dec-only", "elsewhere", "reverse")
ALIGNED_ARCSEC = 3600.0
"""So near to the truth is a mount aligned by its marks: refraction, which it doesn't know, is less."""
SLACK_ARCSEC = 5.0
"""What the clock's steps and a belief's own rounding come to."""
_RESTS_ARCSEC_S = 15.041
"""So fast the right ascension grows of one that rests."""
_LATER = timedelta(seconds=3.0)
"""After so long all ramps are over."""
_OFFSET_DEG_S = 50.0 / 3600.0
"""As fast as the fastest rates that are ordered here, tracking included."""
UNSEEN_ARCSEC = 30.0
"""What no reader can tell from a little motion: flipped bits in last digits, without check sums."""


@dataclass
class Family:
    """What the fuzz must know of a family."""

    protocol: str
    dialect: str | None
    language: Callable[[Link], Language]
    moves: tuple[bytes, ...]
    stops: tuple[bytes, ...]
    machine: Machine | None = None
    syncs: bool = True
    """Whether a sync reaches the fake; not where the driver keeps its offsets to itself."""
    reads_rates: bool = True
    """Whether it says which offset rates it has; else one that was deaf to an order is not found out."""
    recover: Callable[[Any], None] = lambda fake: None
    """What a person does at the mount after its power was off."""

    def __str__(self) -> str:
        return f"{self.protocol}-{self.dialect}" if self.dialect else self.protocol


@dataclass
class Findings:
    """What a run came to."""

    exchanges: int = 0
    readings: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    struck: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    off_arcsec: list[float] = field(default_factory=list)


class _Counted:
    """The language, with a note of which moving orders each call to it may send."""

    def __init__(self, language: Language, rig: Rig) -> None:
        self._language = language
        self._rig = rig

    def __getattr__(self, name: str) -> Any:
        told = getattr(self._language, name)
        if name not in ("send_slew", "send_sync", "send_park", "send_home", "next_leg"):
            return told

        async def counted(*given: Any) -> Any:
            before = len(self._rig.fake.obeyed)
            if name in ("send_slew", "send_park", "send_home"):
                self._rig.check_belief(name)
            if name == "send_sync":
                self._rig.synced_from = self._rig.now()
            went_out = True
            try:
                answer = await told(*given)
                # one that didn't go out may be told again
                went_out = not isinstance(answer, Sent) or answer.wire or bool(self._rig.moved_since(before))
                return answer
            finally:
                self._rig.sent[name] += went_out
                self._rig.check_once(name, before)

        return counted


class Rig:
    """A mount, its fake, and the clock of both."""

    def __init__(
        self,
        family: Family,
        make: Callable[..., WireFake],
        clock: HandClock,
        seed: int,
        rate: float,
        kinds: tuple[Kind, ...],
        *,
        contradicts: bool = False,
        follows: bool = False,
    ) -> None:
        self.family, self.clock = family, clock
        self.follows = follows
        """Whether it is also ordered rates of its own, and its axes are moved by hand."""
        self.contradicts = contradicts
        """Whether it says no and goes, takes syncs for other places, and is switched off and on in slews."""
        self.chances = random.Random(seed)
        self.findings = Findings()
        self.sent: Counter[str] = Counter()
        self.synced_from: Apparent | Icrs | None = None
        """Where it believed to be as the last sync was sent: an earlier one may show late just before."""
        self.unsure = self.moved_before = False
        self.mechanics = Mechanics(
            HERE,
            Air(),
            PointingErrors(),
            machine=family.machine,
            slew_rate_deg_s=4.0,
            clock=clock,
        )
        self.fake = make(
            family.protocol, family.dialect, self.mechanics, clock=clock, monotonic=clock.monotonic
        )
        self.faulty = RandomFaults(seed, rate, kinds, longest_s=4.0)
        log = WireLog(monotonic=clock.monotonic)
        self.line = MemoryLine(self.fake, clock, log)
        language = _Counted(family.language(Link(self.line, Patience(), log)), self)
        timing = Timing(longest_backoff_s=4.0)
        self.nearest_arcsec = timing.near_arcsec
        self.mount = GenericMount(language, timing=timing, site=HERE)
        self.mount.listen(self.hear)

    def hear(self, what: str, facts: object) -> None:
        if what == "untrusted" and not self.family.syncs and self.fake.chance is not None:
            # the place that the driver reckons is said not to count, and only a sync ends that
            self.unsure = True

    # -- what must never be --------------------------------------------------------------------------

    def note(self, what: str) -> None:
        self.findings.wrong.append(f"at {self.clock.now_s:.3f} s, after {len(self.fake.heard)}: {what}")

    def moved_since(self, before: int) -> list[bytes]:
        """Which of the commands that were obeyed since then move it."""
        return [one for one in self.fake.obeyed[before:] if one.startswith(self.family.moves)]

    def check_once(self, order: str, before: int) -> None:
        sent = self.moved_since(before)
        twice = [one for one, count in Counter(sent).items() if count > 1]
        if twice:
            self.note(f"{order} was carried out twice: {twice}")

    def astray_arcsec(self) -> float:
        """How far the tube is from where the mount believes."""
        return separation_arcsec(self.mechanics.truth(), apparent_to_icrs(self.mechanics.reported()))

    def check_belief(self, order: str) -> None:
        """No order to move goes out by a place at which it woke up, or that a sync gave it wrongly."""
        self.moved_before, astray = self.moves(), self.astray_arcsec()
        if self.contradicts and astray > WRONG_BELIEF_ARCSEC:
            self.note(f"{order} by a belief that is {astray / 3600.0:.1f} degrees off")

    def check_reading(self, reading: MountReading, began_s: float) -> None:
        self.findings.readings += 1
        if self.unsure:
            return
        span_s = min(self.clock.now_s - began_s, 5.0)
        around = [self.belief(reading, step * span_s) for step in (-1.0, -0.5, 0.0, 0.5, 1.0)]
        near = [self.belief(reading, shift_s) for shift_s in (-RIGHT_WITHIN_S, 0.0, RIGHT_WITHIN_S)]
        travel = max(_apart(one, two) for one in near for two in near)
        pace = max(_apart(one, two) for one, two in itertools.pairwise(around))
        off = min(_apart(reading.place, one) for one in (*around, *near))
        free = 1.5 * self.mount.resolution_arcsec + 1.0 + pace + travel
        if off > free:
            self.findings.off_arcsec.append(off)
            if off > free + UNSEEN_ARCSEC:
                self.note(f"a reading is {off:.0f} arcsec off (free: {free:.0f}): {reading}")

    def check_sync(self, outcome: SyncOutcome, *, off: float, moved: float) -> None:
        """What a sync is said to have come to, by how far (arcsec) the belief is off, and has moved.

        The driver sees both through the steps of the wire.
        """
        step = self.mount.resolution_arcsec
        if outcome.seen and off > max(self.nearest_arcsec, step + FREE_ARCSEC) + 1.5 * step + SLACK_ARCSEC:
            self.note(f"sync {outcome}, {off:.0f} arcsec off")
        if not outcome.seen and off < 0.5 * step + SLACK_ARCSEC:
            self.note(f"sync {outcome}, and it was taken: {off:.0f} arcsec off")
        if outcome is SyncOutcome.IGNORED and moved > FREE_ARCSEC + 3.0 * step + SLACK_ARCSEC:
            self.note(f"sync {outcome}, and it believes something else: {moved:.0f}")
        if outcome is SyncOutcome.ELSEWHERE and moved < SLACK_ARCSEC:
            self.note(f"sync {outcome}, and it believes what it did: {moved:.0f}")

    def belief(self, reading: MountReading, shift_s: float) -> Apparent | Icrs:
        utc = min(reading.utc + timedelta(seconds=shift_s), self.clock())
        place = self.mechanics.reported(utc)
        return apparent_to_icrs(place) if isinstance(reading.place, Icrs) else place

    def now(self) -> Apparent | Icrs:
        place = self.mechanics.reported()
        return apparent_to_icrs(place) if self.mount.epoch == "icrs" else place

    # -- a life --------------------------------------------------------------------------------------

    async def live(self, exchanges: int) -> Findings:
        await self.mount.open()
        self.fake.chance = self.faulty
        try:
            while len(self.fake.heard) < exchanges:
                before = len(self.fake.heard)
                await self.step()
                if len(self.fake.heard) == before:
                    await asyncio.sleep(1.0)
        finally:
            self.findings.exchanges = len(self.fake.heard)
            self.findings.struck = Counter(strike.fault.kind for strike in self.fake.strikes)
            await self.mount.close()
        return self.findings

    async def step(self) -> None:
        roll = self.chances.random()
        if self.follows and self.chances.random() < 0.3:
            await self.told("rates", self.rates)
            if self.chances.random() < 0.4:
                await self.told("move", self.move)
        if self.mechanics.parked and self.chances.random() < 0.3:
            # somebody at its buttons
            self.mechanics.unpark()
        if not self.mount.trusted and roll < 0.5:
            if self.mechanics.boots:
                self.family.recover(self.fake)
            if self.contradicts:
                # it is aligned again before that is said: by the marks of its axes, since a place alone
                # tells it no posture, and at the pole no hour angle
                self.mechanics.unpark()
                self.mechanics.stop()
                self.mechanics.sync_behavior = "normal"
                await asyncio.sleep(5.0)
                self.mechanics.align()
                await asyncio.sleep(2.0)
                if self.astray_arcsec() > ALIGNED_ARCSEC:
                    return  # it was switched off just now: next time
            self.mount.trust()
        if roll < 0.70:
            await self.told("read", self.read)
        elif roll < 0.82:
            await self.told("slew", self.slew)
        elif roll < 0.87 or (self.unsure and roll < 0.95):
            await self.told("sync", self.sync)
        elif roll < 0.90:
            await self.told("stop", self.stop)
        elif roll < 0.93:
            await self.told("track", self.track)
        elif roll < 0.96:
            await self.told("guide", self.guide)
        elif roll < 0.98:
            await self.told("park", self.park)
        else:
            await asyncio.sleep(self.chances.uniform(0.0, 5.0))

    async def told(self, what: str, order: Callable[[], Awaitable[str]]) -> None:
        ordered = sum(self.sent.values())
        try:
            async with asyncio.timeout(LONGEST_S):
                came = await order()
        except TimeoutError:
            self.note(f"{what} hangs")
            came = "hangs"
        except DeviceRefused as refusal:
            came = f"refused ({refusal.reason})"
            # what a task of the driver's own does meanwhile (tracking taken up again) is no answer to it
            if sum(self.sent.values()) > ordered and refusal.reason is Refusal.UNTRUSTED:
                self.note(f"{what} refused, but sent")
        except MountnavError as error:
            came = type(error).__name__
        self.findings.outcomes[f"{what}: {came}"] += 1

    async def read(self) -> str:
        began_s = self.clock.now_s
        reading = await self.mount.reading()
        self.check_reading(reading, began_s)
        await asyncio.sleep(self.chances.choice((0.0, 0.0, 0.01, 0.3)))
        return "done"

    async def watch(self) -> None:
        """Somebody else reads while the mount slews."""
        while True:
            with contextlib.suppress(DeviceError):
                began_s = self.clock.now_s
                self.check_reading(await self.mount.reading(), began_s)
            await asyncio.sleep(self.chances.uniform(0.1, 1.0))

    def target(self) -> Apparent | Icrs | None:
        here = self.mechanics.reported()
        for _ in range(30):
            ra_deg = (here.ra_deg + self.chances.uniform(-25.0, 25.0)) % 360.0
            dec_deg = here.dec_deg + self.chances.uniform(-25.0, 25.0)
            if not -20.0 < dec_deg < 85.0:
                continue
            place = Apparent(ra_deg, dec_deg, self.clock())
            if self.mechanics.believed_altitude_deg(place) > 25.0 and self.mechanics.refusal(place) is None:
                return apparent_to_icrs(place) if self.mount.epoch == "icrs" else place
        return None

    async def slew(self) -> str:
        place = self.target()
        if place is None:
            return "nowhere"
        sent = self.sent["send_slew"]
        if self.contradicts and self.chances.random() < 0.2:
            for on in self.family.moves:
                self.fake.add_fault(Fault("deny", on=on))
        if self.contradicts and self.chances.random() < 0.15:
            mute_s = self.chances.uniform(0.8, 7.0)
            asyncio.get_running_loop().call_later(
                self.chances.uniform(0.1, 5.0), lambda: self.fake.add_fault(Fault("reboot", for_s=mute_s))
            )
        slew = asyncio.ensure_future(self.mount.slew(place))
        watch = asyncio.ensure_future(self.watch())
        if self.chances.random() < 0.3:
            await asyncio.wait({slew}, timeout=self.chances.uniform(0.0, 6.0))
            if self.chances.random() < 0.3:
                slew.cancel()
            else:
                with contextlib.suppress(DeviceError):
                    await self.stop()
        try:
            outcome = await slew
        except asyncio.CancelledError:
            return "cancelled"
        except DeviceRefused:
            # one that was refused before it was sent tells nothing of what moves since before
            went_out = self.sent["send_slew"] > sent and not self.moved_before
            if went_out and self.moves() and self.mount.slew_state is SlewState.REFUSED:
                self.note("refused, and the mount slews")
            raise
        finally:
            self.fake.faults = [one for one in self.fake.faults if one.kind != "deny"]
            watch.cancel()
            await asyncio.wait({watch})
            if self.sent["send_slew"] > sent + 1:
                self.note("a slew was ordered twice")
        if outcome is SlewOutcome.ARRIVED and not self.unsure:
            off = _apart(self.now(), place)
            if off > 30.0 + 3.0 * self.mount.resolution_arcsec:
                self.note(f"arrived, {off:.0f} arcsec off")
        if self.moves():
            self.note(f"{outcome}, and the mount slews")
        return outcome

    def moves(self) -> bool:
        """Whether an axis runs faster than any tracking."""
        return any(abs(self.mechanics.axis_velocity(axis)) > 0.01 for axis in ("ha", "dec"))

    async def stop(self) -> str:
        began_s, could = self.clock.now_s, self.line.usable
        stopping = asyncio.ensure_future(self.mount.stop())
        await asyncio.wait({stopping}, timeout=STOP_S)
        if could and not any(
            began_s <= at_s <= began_s + STOP_S and any(stop in data for stop in self.family.stops)
            for at_s, data in self.line.now_writes[-20:]
        ):
            self.note("a stop was not on the wire within a tenth of a second")
        await stopping
        if self.moves():
            self.note("stopped, and the mount slews")
        return "stopped"

    async def sync(self) -> str:
        if not self.family.syncs:
            place = self.now()
            if abs(place.dec_deg) > 75.0:
                # beside the pole a place tells little of the hour angle: 0.1 arcsec turn it by 1 arcmin
                return "too near the pole"
            result = await self.mount.sync(place)
            # a mount that moved on meanwhile was told a place of the past: by us, not by its driver
            stayed = _apart(self.now(), place) < 1.0
            # one that was taken elsewhere leaves the driver, who alone knows of it, with a place that is off
            self.unsure = not stayed or not result.outcome.seen
            return result.outcome
        here = self.now()
        if self.contradicts and abs(here.dec_deg) > 75.0:
            return "too near the pole"
        ra_deg = (here.ra_deg + self.chances.uniform(-0.3, 0.3)) % 360.0
        dec_deg = max(-80.0, min(80.0, here.dec_deg + self.chances.uniform(-0.3, 0.3)))
        place = (
            Icrs(ra_deg, dec_deg) if self.mount.epoch == "icrs" else Apparent(ra_deg, dec_deg, self.clock())
        )
        sent, self.synced_from = self.sent["send_sync"], here
        if self.contradicts:
            self.mechanics.sync_behavior = self.chances.choice(SYNCS)
        try:
            result = await self.mount.sync(place)
        finally:
            self.mechanics.sync_behavior = "normal"
            if self.sent["send_sync"] > sent + 1:
                self.note("a sync was ordered twice")
        if self.mechanics.tracking:
            moved = _apart(self.now(), self.synced_from)
            self.check_sync(result.outcome, off=_apart(self.now(), place), moved=moved)
        return result.outcome

    async def track(self) -> str:
        if Skill.TRACK not in self.mount.skills:
            return "can't"
        await self.mount.set_tracking(self.chances.random() < 0.8, TrackingRate.SIDEREAL)
        return "done"

    async def guide(self) -> str:
        if Skill.GUIDE not in self.mount.skills:
            return "can't"
        await self.mount.guide(self.chances.choice(list(Direction)), self.chances.uniform(0.05, 1.5))
        return "done"

    def kept(self) -> OffsetRates:
        """The rates beside the sidereal one at which its belief goes on if nothing else comes."""
        begin = self.clock() + timedelta(seconds=3.0)
        one, two = (self.mechanics.reported(begin + timedelta(seconds=after)) for after in (0.0, 5.0))
        ra_deg = (two.ra_deg - one.ra_deg + 180.0) % 360.0 - 180.0
        return OffsetRates(ra_deg * 720.0, (two.dec_deg - one.dec_deg) * 720.0)

    async def rates(self) -> str:
        if Skill.OFFSET_RATES not in self.mount.skills:
            return "can't"
        most = self.mount.most_offset_arcsec_s or OffsetRates(30.0, 30.0)
        some = [min(one, 30.0) for one in (most.ra_arcsec_s, most.dec_arcsec_s)]
        rates = OffsetRates(*(self.chances.uniform(-one, one) for one in some))
        if self.chances.random() < 0.3:
            rates = STARS_RATES
        boots = self.mechanics.boots
        if not rates.none and (await self.mount.reading()).tracking is False:
            await self.mount.set_tracking(True, TrackingRate.SIDEREAL)
        await self.mount.set_offset_rates(rates)
        sure = self.family.reads_rates and not self.unsure and self.mechanics.boots == boots
        # over the pole north is south within the time of a look
        sure = sure and abs(self.mechanics.reported().dec_deg) < 85.0
        # those of a star may be ordered of one that rests
        if sure and not (rates.none and abs(self.kept().ra_arcsec_s - _RESTS_ARCSEC_S) < 0.1):
            step = self.mount.offset_step_arcsec_s
            kept = self.kept()
            for told, went in (
                (rates.ra_arcsec_s, kept.ra_arcsec_s),
                (rates.dec_arcsec_s, kept.dec_arcsec_s),
            ):
                if abs(told - went) > 1.1 * step + 0.002 * abs(told) + 0.02:
                    self.note(f"ordered {rates}, it goes at {kept}")
        return "done"

    async def move(self) -> str:
        if Skill.MOVE_AXIS not in self.mount.skills:
            return "can't"
        spans = self.mount.axis_rates_deg_s
        axis = self.chances.choice(sorted(spans))
        span = self.chances.choice(spans[axis])
        speed = min(self.chances.uniform(span.least_deg_s, span.most_deg_s), 0.3)
        speed = min(max(speed, span.least_deg_s), span.most_deg_s)
        try:
            await self.mount.move_axis(axis, self.chances.choice((1.0, -1.0)) * speed)
            await asyncio.sleep(self.chances.uniform(0.0, 3.0))
            await self.mount.move_axis(axis, 0.0)
        except DeviceRefused:
            raise
        except DeviceError:
            # whoever moves an axis by hand and isn't answered stops it
            await self.stop()
            raise
        goes_on = [self.mechanics.axis_velocity(one, self.clock() + _LATER) for one in ("ha", "dec")]
        if any(abs(one) > span.least_deg_s + _OFFSET_DEG_S for one in goes_on):
            self.note(f"its {axis} axis was told to end, and moves on: {goes_on}")
        return "done"

    async def park(self) -> str:
        if not {Skill.PARK, Skill.UNPARK} <= self.mount.skills:
            return "can't"
        outcome = await self.mount.park()
        await asyncio.sleep(self.chances.uniform(0.0, 3.0))
        await self.mount.unpark()
        return outcome


def _apart(one: Apparent | Icrs, two: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(one.ra_deg, one.dec_deg), Icrs(two.ra_deg, two.dec_deg))
