"""Holding a telescope still by what its solves show: looks in, guide pulses or rates out, never a sync.

A hold keeps the telescope for itself until its end: its time is over, it is cancelled or stopped, or
something speaks against going on. Whatever ends it, rates beside the sidereal one are ended, and the mount is
left tracking as for a star. What is corrected is decided in `mountnav.guiding`; here is what the mount can
do, what the looks are, and what is told.

Looks come from the telescope's own camera, every so many seconds, or from frames that another program exposes
(`Holding.outside`). In the first case frames of another program show how the guiding and the main camera bend
apart.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Literal

from mountnav.devices import (
    STARS_RATES,
    Direction,
    OffsetRates,
    PierSide,
    Skill,
    from_mount,
)
from mountnav.errors import (
    BadFrame,
    BadRequest,
    Busy,
    Cancelled,
    DeviceRefused,
    MountMoved,
    NotReached,
    Refusal,
    SolveFailed,
    SyncRefused,
    TargetNotReached,
)
from mountnav.guiding.actuator import Actuator, ActuatorKind
from mountnav.guiding.dither import DitherPlan, Settle
from mountnav.guiding.guider import Correction, Guider, LookFate
from mountnav.guiding.trends import Bending, BendingSeen, Trend, TrendSeen
from mountnav.journal.records import EntryKind
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.derotating import Derotation
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.look_retries import PersistentLook, cheap
from mountnav.navigation.reports import Look
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.tasks import first_of, waited_for

GUIDE_SHARE = 0.5
"""Share of the sidereal rate that a mount is taken to guide at where it doesn't say: the usual setting. It is
only where learning begins."""
LEAST_PULSE_S = 0.02
"""Pulses are made of such steps, s: the grain of most mounts' timers. Doubled, corrections below 0.3″ are
left out."""
LONGEST_PULSE_S = 8.0
"""Longest pulse at once, s; protocols carry up to 9.999. Doubled, some refuse it."""
PULSE_ERROR_S = 0.005
"""One sigma of when a pulse ends, s."""
ERROR_SHARE = 0.05
"""One sigma of what a correction misses by, as a share of it: motors' and gears' errors over arc seconds."""
MOST_RATE_ARCSEC_S = 5.0
"""Largest rate beside the sidereal one that holding asks for, ″/s: a third of the sidereal one. Doubled, a
wrong look does twice the harm until the next."""
BLIND_LOOKS = 5
"""Looks that may fail in a row before nothing more is corrected by what is known; twice as many only where
the sky is known so long to be cloudy."""
GIVEN_UP_S = 1800.0
"""So long without a solved look, and a hold ends. Doubled, it stands under cloud for an hour."""
MOVED_ARCSEC = 180.0
"""The mount's own reading that leaves its place by more than this, beside what was corrected, was slewed by
somebody."""
NEAR_POLE_COS = 0.05
"""Least cos δ (2.9° from the pole) at which right ascension is corrected: nearer, seconds of pulses move
arcseconds of sky."""
START_SIGMA_ARCSEC = 2.0
"""How far from its target a telescope is taken to begin that was just centered there or holds where it is."""
_RECENT = 20
"""Looks that the recent residual is taken over."""
_RATES_LAST = 3.0
"""Rates are ordered for so many intervals ahead: if no look comes they end by themselves."""
_RATES_LEAST_S = 30.0
"""And for no less, s."""

HoldBy = Literal["pulses", "rates", "both"]
HoldLooks = Literal["camera", "frames"]


@dataclass(frozen=True, slots=True)
class HoldPlan:
    """What a hold is asked for.

    Attributes
    ----------
    target : Icrs or None
        Where the frame's center should look; None: where the first look finds it.
    for_s : float or None
        How long; None: until it is ended.
    every_s : float
        From a look's beginning to the next, at least.
    exposure_s : float or None
        None: as the policy says.
    by : {"pulses", "rates", "both"} or None
        None: pulses where the mount takes them, else rates.
    looks : {"camera", "frames"}
        Its own camera's, or those of frames from outside.
    period_s : float or None
        Known period of the worm.
    play_arcsec : float or None
        Declared play of the declination axis; None: not known.
    """

    target: Icrs | None = None
    for_s: float | None = None
    every_s: float = 20.0
    exposure_s: float | None = None
    by: HoldBy | None = None
    looks: HoldLooks = "camera"
    period_s: float | None = None
    play_arcsec: float | None = None

    def __post_init__(self) -> None:
        spans = (
            ("for_s", self.for_s, 1.0, 86_400.0),
            ("every_s", self.every_s, 0.5, 3600.0),
            ("exposure_s", self.exposure_s, 1e-4, 3600.0),
            ("period_s", self.period_s, 10.0, 7200.0),
            ("play_arcsec", self.play_arcsec, 0.0, 600.0),
        )
        for name, value, least, most in spans:
            if value is not None and not (math.isfinite(value) and least <= value <= most):
                raise BadRequest(f"{name} lies between {least:g} and {most:g}", advice=f"got {value}")


@dataclass(frozen=True, slots=True)
class HoldKnown:
    """What a hold has found out so far; rates and amplitudes are on the sky.

    Attributes
    ----------
    drift_east_arcsec_min, drift_north_arcsec_min : float or None
        What the mount does by itself, without the periodic part. None where nobody knows how much its guide
        pulses do: twice the drift and twice the effect look alike while it is held.
    drift_east_sigma_arcsec_min, drift_north_sigma_arcsec_min : float or None
        One sigma; None: not known yet.
    period_s : float or None
        Of the worm; None: not found.
    amplitudes_arcsec : tuple of float
        Of each harmonic; empty where the drift is None, for the same reason.
    amplitude_sigma_arcsec : float or None
        One sigma; None: not known yet.
    noise_arcsec : float
        Scatter of a look, seeing included.
    gain, play_arcsec : float
        Share of a correction in declination that arrives, and that axis' play.
    rotation : Trend or None
        Of the field, deg.
    bending : Bending or None
        Main camera's center minus the guiding one's, ″.
    """

    drift_east_arcsec_min: float | None
    drift_east_sigma_arcsec_min: float | None
    drift_north_arcsec_min: float | None
    drift_north_sigma_arcsec_min: float | None
    period_s: float | None
    amplitudes_arcsec: tuple[float, ...]
    amplitude_sigma_arcsec: float | None
    noise_arcsec: float
    gain: float
    gain_sigma: float
    play_arcsec: float
    play_sigma_arcsec: float
    rotation: Trend | None
    bending: Bending | None


@dataclass(frozen=True, slots=True)
class HoldProgress:
    """One step of a hold.

    Attributes
    ----------
    number : int
        Of the look.
    fate : str
        "taken", "gated", "jump", "stale", or "not-solved".
    east_arcsec, north_arcsec : float or None
        Seen minus wanted.
    sigma_arcsec : float or None
        None: not known.
    step_east_arcsec, step_north_arcsec : float
        Corrected by steps.
    rate_east_arcsec_s, rate_north_arcsec_s : float
        Rates in force since.
    rms_arcsec : float or None
        Residual of the last looks, both coordinates together, the looks' own noise included.
    dithered : tuple of float
        Where it should look beside where the hold began, ″ east and north.
    settled : bool or None
        After a dither; None: none is under way.
    problem : str or None
        Why a look wasn't solved, or what is wrong with the mount.
    known : HoldKnown or None
        None: nothing yet.
    """

    number: int
    utc: datetime
    fate: str
    east_arcsec: float | None = None
    north_arcsec: float | None = None
    sigma_arcsec: float | None = None
    step_east_arcsec: float = 0.0
    step_north_arcsec: float = 0.0
    rate_east_arcsec_s: float = 0.0
    rate_north_arcsec_s: float = 0.0
    rms_arcsec: float | None = None
    dithered: tuple[float, float] = (0.0, 0.0)
    settled: bool | None = None
    problem: str | None = None
    known: HoldKnown | None = None


@dataclass(frozen=True, slots=True)
class HoldReport:
    """How a hold ended by its time.

    Attributes
    ----------
    target : Icrs
        Where it held the frame's center, dithers not counted.
    corrections : int
        Pulses, or changes of rates.
    rms_arcsec : float
        Residual of all looks that were taken, both coordinates together, the looks' own noise included.
    """

    target: Icrs
    looks: int
    solved: int
    gated: int
    jumps: int
    corrections: int
    rms_arcsec: float
    began_utc: datetime
    ended_utc: datetime
    by: str
    known: HoldKnown


@dataclass(frozen=True, slots=True)
class DitherReport:
    """How a dither ended: settled, as looks show.

    Attributes
    ----------
    number : int
        Of the step in its pattern.
    east_arcsec, north_arcsec : float
        Where it should look now, beside where the series began.
    off_arcsec : float
        The last look from there.
    looks : int
        That it took.
    """

    number: int
    east_arcsec: float
    north_arcsec: float
    off_arcsec: float
    looks: int
    elapsed_s: float


@dataclass(frozen=True, slots=True)
class DitherWish:
    """A dither that is asked for.

    Attributes
    ----------
    unit : {"arcsec", "px"}
        Of the plan's bound and of `settle_within`.
    number : int or None
        Which step; None: the one after the last.
    settle_within : float
        So near looks must be.
    settle_looks : int
        So many in a row.
    """

    plan: DitherPlan
    unit: Literal["arcsec", "px"] = "arcsec"
    number: int | None = None
    settle_within: float = 1.5
    settle_looks: int = 2
    timeout_s: float = 300.0


@dataclass
class _Dithering:
    """A dither under way."""

    wish: DitherWish
    number: int
    settle: Settle
    began_s: float
    ended: asyncio.Future[DitherReport]
    looks: int = 0


@dataclass
class _Counts:
    looks: int = 0
    solved: int = 0
    gated: int = 0
    jumps: int = 0
    corrections: int = 0
    squares: float = 0.0
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT))


class Holding:
    """One hold of one telescope.

    Parameters
    ----------
    heard : callable, optional
        Told of each step; it never steers.
    """

    def __init__(
        self,
        equipment: Equipment,
        plan: HoldPlan,
        heard: Callable[[HoldProgress], None] | None = None,
    ) -> None:
        self._equipment = equipment
        self._plan = plan
        self._heard = heard or (lambda _: None)
        self._by: HoldBy = _means(equipment, plan.by)
        self._origin: Icrs | None = plan.target
        self._wanted: Icrs | None = plan.target
        self._dithered = (0.0, 0.0)
        self._number = 0
        self._believed: Icrs | None = None
        self._side = PierSide.UNKNOWN
        self._guider: Guider | None = None
        self._sigma = 1.0
        self._scale: float | None = None
        self._counts = _Counts()
        self._rotation = TrendSeen(360.0)
        self._derotation: Derotation | None = None
        self._bending = BendingSeen()
        self._rates = STARS_RATES
        self._told_fault = ""
        self._turned: tuple[float, float] = (0.0, 1.0)
        self._frames: asyncio.Queue[Look] = asyncio.Queue(maxsize=32)
        self._asked: asyncio.Queue[tuple[DitherWish, asyncio.Future[DitherReport]]] = asyncio.Queue(maxsize=1)
        self._dithering: _Dithering | None = None
        self._wake = asyncio.Event()
        self._over = False
        self._backed_off = (False, False)
        self._began_s = equipment.clock.monotonic_s()
        self._epoch_utc = equipment.clock.utc()

    # -- from outside --------------------------------------------------------------------------------

    def outside(self, look: Look) -> None:
        """Take in a frame of another program that was solved: it guides, or shows how cameras bend apart."""
        if self._plan.looks == "frames":
            if not self._frames.full():
                self._frames.put_nowait(look)
            self._wake.set()
        elif self._origin is not None:
            off = offset_arcsec(look.seen, self._origin)
            self._bending.main_frame(self._seconds(look.mid_exposure_utc), off.east_arcsec, off.north_arcsec)

    async def dither(self, wish: DitherWish) -> DitherReport:
        """Look elsewhere from now on, by a pattern, and return when looks show that it has settled there.

        Raises
        ------
        Busy
            Another dither is under way.
        TargetNotReached
            It didn't settle in time; the hold goes on at the new place.
        Cancelled
            The hold ended before.
        """
        if self._over or self._dithering is not None or self._asked.full():
            raise Busy(
                "the hold has ended" if self._over else "a dither is under way",
                device=self._equipment.name,
                advice="wait for its end",
            )
        answered: asyncio.Future[DitherReport] = asyncio.get_running_loop().create_future()
        self._asked.put_nowait((wish, answered))
        self._wake.set()
        return await answered

    # -- the hold itself -----------------------------------------------------------------------------

    async def run(self, *, only: DitherWish | None = None) -> HoldReport | DitherReport:
        """Hold until its time is over.

        Parameters
        ----------
        only : DitherWish, optional
            Dither once, from where it looks now, and end when that has settled.

        Raises
        ------
        SolveFailed
            Nothing was solved for half an hour, or not the first look.
        MountMoved
            Somebody slewed the mount.
        DeviceRefused
            It doesn't track, takes neither pulses nor rates, or does the contrary of what it is told.
        OutsideLimits, DeviceError, JournalFailed
        """
        clock = self._equipment.clock
        began_utc = clock.utc()
        reading = await self._equipment.mount.reading()
        if reading.tracking is False:
            raise DeviceRefused(
                "the mount doesn't track: there is nothing to hold",
                device=self._equipment.name,
                advice="switch tracking on, center the target, then hold",
                reason=Refusal.NOT_TRACKING,
            )
        ends_s = math.inf if self._plan.for_s is None else clock.monotonic_s() + self._plan.for_s
        asked = None if only is None else waited_for(self._once(only))
        try:
            solved_s = clock.monotonic_s()
            while clock.monotonic_s() < ends_s and not (asked is not None and asked.done()):
                look_began_s = clock.monotonic_s()
                look, problem = await self._look(ends_s)
                if look is not None:
                    solved_s = clock.monotonic_s()
                    fate = await self._saw(look)
                elif problem is None:
                    continue
                else:
                    fate = None
                    if clock.monotonic_s() - solved_s > GIVEN_UP_S or self._origin is None:
                        raise SolveFailed(
                            f"no look was solved for {(clock.monotonic_s() - solved_s) / 60.0:.0f} minutes: "
                            f"{problem}",
                            device=self._equipment.name,
                            advice="check for clouds, dew and focus; it tracks on uncorrected",
                            reason="given up",
                        )
                self._begin_dither()
                blind = clock.monotonic_s() - solved_s > BLIND_LOOKS * self._plan.every_s
                done = await self._correct(idle=blind)
                self._tell(look, fate, problem, done)
                kill_point("hold corrected")
                if fate is LookFate.GATED or self._dithering is not None:
                    continue  # the next look decides: as soon as it can be
                await self._wait(look_began_s, ends_s)
            if asked is not None:
                return await asked
            return HoldReport(
                target=self._origin or from_mount(reading.place),
                looks=self._counts.looks,
                solved=self._counts.solved,
                gated=self._counts.gated,
                jumps=self._counts.jumps,
                corrections=self._counts.corrections,
                rms_arcsec=math.sqrt(self._counts.squares / max(self._counts.solved, 1)),
                began_utc=began_utc,
                ended_utc=clock.utc(),
                by=self._by,
                known=self._known(),
            )
        finally:
            self._over = True
            if self._derotation is not None:
                self._derotation.cease()
            if asked is not None:
                asked.cancel()
            self._end_dithers()
            try:
                await asyncio.shield(self._let_go())
            finally:
                if self._derotation is not None:
                    await self._derotation.end()

    async def _once(self, wish: DitherWish) -> DitherReport:
        return await self.dither(wish)

    def _end_dithers(self) -> None:
        ended = Cancelled("the hold ended before the dither had settled", device=self._equipment.name)
        if self._dithering is not None and not self._dithering.ended.done():
            self._dithering.ended.set_exception(ended)
        while not self._asked.empty():
            _, answered = self._asked.get_nowait()
            if not answered.done():
                answered.set_exception(ended)

    async def _let_go(self) -> None:
        """Plain sidereal tracking: no rates beside it. Pulses end by themselves."""
        if self._by != "pulses":
            await self._equipment.mount.end_offset_rates()

    async def _wait(self, began_s: float, ends_s: float) -> None:
        """Until the next look is due, a dither is asked for, or the hold's end."""
        clock = self._equipment.clock
        if self._plan.looks == "frames":
            return
        left_s = min(began_s + self._plan.every_s, ends_s) - clock.monotonic_s()
        if left_s <= 0.0 or not self._asked.empty():
            return
        self._wake.clear()
        await first_of(self._wake.wait(), clock.sleep(left_s))

    # -- looks ---------------------------------------------------------------------------------------

    async def _look(self, ends_s: float) -> tuple[Look | None, str | None]:
        """The next look, or why there is none; neither: its time is over, or a dither was asked for."""
        equipment = self._equipment
        if self._plan.looks == "frames":
            return await self._next_frame(ends_s)
        policy = equipment.policy
        persistence = cheap(policy.persistence, 1)
        self._counts.looks += 1
        try:
            looking = PersistentLook(equipment, policy, persistence, used="hold", teaches=False)
            return (await looking.look(self._plan.exposure_s)).look, None
        except (SolveFailed, MountMoved, BadFrame, SyncRefused) as error:
            return None, error.what

    async def _next_frame(self, ends_s: float) -> tuple[Look | None, str | None]:
        clock = self._equipment.clock
        limit_s = min(max(4.0 * self._plan.every_s, 60.0), ends_s - clock.monotonic_s())
        began_s = clock.monotonic_s()
        while self._frames.empty():
            left_s = limit_s - (clock.monotonic_s() - began_s)
            if left_s <= 0.0:
                self._counts.looks += 1
                return None, f"no frame came for {limit_s:.0f} s"
            self._wake.clear()
            await first_of(self._wake.wait(), clock.sleep(left_s))
            if self._frames.empty() and not self._asked.empty() and self._origin is not None:
                return None, None if self._dithering is not None else "a dither is asked for"
        self._counts.looks += 1
        return self._frames.get_nowait(), None

    async def _saw(self, look: Look) -> LookFate:
        """Take in a look."""
        self._require_unmoved(look)
        utc_s = self._seconds(look.mid_exposure_utc)
        sigma = look.solution.center_sigma_arcsec
        self._sigma = sigma if math.isfinite(sigma) and sigma > 0.0 else 1.0
        self._scale = look.solution.scale_arcsec_px
        if self._origin is None:
            self._origin = self._wanted = look.seen
        assert self._wanted is not None
        if self._guider is None:
            self._guider = self._new_guider(look)
        side = look.after.side
        if side is not PierSide.UNKNOWN and self._side is not PierSide.UNKNOWN and side is not self._side:
            # the same place from the other side: the worm, the play and the flexure begin anew
            self._guider.another_field(START_SIGMA_ARCSEC)
            self._bending.clear()
            self._rotation.clear()
            self._rates = STARS_RATES
            await self._note("the tube has changed sides: what is known of drift begins again", {})
        self._side = side
        off = offset_arcsec(look.seen, self._wanted)
        if self._plan.looks == "camera":
            from_origin = offset_arcsec(look.seen, self._origin)
            self._bending.guide_look(utc_s, from_origin.east_arcsec, from_origin.north_arcsec)
        self._rotation.add(utc_s, look.solution.rotation_deg)
        if self._derotation is None:
            held = self._origin
            self._derotation = Derotation(self._equipment, lambda _: held, self._ends_utc())
            self._derotation.begin()
        await self._derotation.seen(look)
        self._turned = self._axes_turn(look.mid_exposure_utc)
        primary, secondary = self._to_axes(off.east_arcsec, off.north_arcsec)
        # a search for a period takes up to seconds: a stop must not wait for that
        seen = await asyncio.to_thread(self._guider.look, utc_s, primary, secondary, self._sigma)
        counts = self._counts
        match seen.fate:
            case LookFate.GATED:
                counts.gated += 1
                facts: dict[str, object] = {
                    "east_arcsec": off.east_arcsec,
                    "north_arcsec": off.north_arcsec,
                    "look_id": look.look_id,
                }
                await self._note(f"a look {off.total_arcsec:.0f}″ off is not believed by itself", facts)
            case LookFate.JUMP:
                counts.jumps += 1
                await self._note(f"the telescope was moved by something, {off.total_arcsec:.0f}″", {})
        await self._tell_backed_off()
        if seen.fate in (LookFate.TAKEN, LookFate.JUMP):
            counts.solved += 1
            counts.squares += off.total_arcsec**2
            counts.recent.append(off.total_arcsec**2)
            self._judge_dither(off.total_arcsec)
        elif self._dithering is not None:
            self._dithering.settle.missed()
        return seen.fate

    async def _tell_backed_off(self) -> None:
        """Tell when an axis is left alone since its corrections did harm, and when it is corrected again."""
        assert self._guider is not None
        now, was = self._guider.backed_off, self._backed_off
        self._backed_off = now
        for name, left, before in zip(("primary", "secondary"), now, was, strict=True):
            if left and not before:
                words = (
                    f"the {name} axis was off more by its corrections than it would have been without: they "
                    "are taken back, and none are made until looks show that they would help"
                )
                await self._note(words, {"axis": name})
            elif before and not left:
                await self._note(
                    f"the {name} axis is corrected again: looks show that it helps", {"axis": name}
                )

    def _require_unmoved(self, look: Look) -> None:
        if self._believed is None:
            self._believed = look.believed
        moved = separation_arcsec(look.believed, self._believed)
        if moved > MOVED_ARCSEC and look.after.side is self._side:
            raise MountMoved(
                f"the mount has moved by {moved / 60.0:.1f}′ without a correction: the hold ends",
                device=self._equipment.name,
                advice="somebody slewed or synced it: center the target, then hold again",
            )
        # what is corrected shows in its readings, and adds up over a night
        self._believed = look.believed

    def _new_guider(self, look: Look) -> Guider:
        mount, plan = self._equipment.mount, self._plan
        rates = mount.guide_rates_deg_s
        known = rates is not None and all(math.isfinite(rate) and rate > 0.0 for rate in rates)
        both = rates if known and rates is not None else (GUIDE_SHARE * SIDEREAL_DEG_S,) * 2
        cosine = max(math.cos(math.radians(look.seen.dec_deg)), NEAR_POLE_COS)
        self._guide_arcsec_s = (3600.0 * both[0] * cosine, 3600.0 * both[1])
        kind: ActuatorKind = self._by
        steps = [0.0 if kind == "rates" else LEAST_PULSE_S * rate for rate in self._guide_arcsec_s]
        altaz = mount.mounting == "altaz"

        def actuator(axis: int) -> Actuator:
            play = plan.play_arcsec if axis == 1 else 0.0
            return Actuator(
                kind=kind,
                step_arcsec=steps[axis],
                error_share=ERROR_SHARE,
                error_arcsec=0.0 if kind == "rates" else PULSE_ERROR_S * self._guide_arcsec_s[axis],
                most_arcsec=LONGEST_PULSE_S * self._guide_arcsec_s[axis],
                most_arcsec_s=MOST_RATE_ARCSEC_S,
                play_arcsec=0.0 if altaz else play,
                rate_known=known or kind == "rates",
            )

        return Guider(
            actuator(0),
            actuator(1),
            start_sigma_arcsec=START_SIGMA_ARCSEC,
            period_s=plan.period_s,
            both_swing=altaz,
        )

    # -- corrections ---------------------------------------------------------------------------------

    async def _correct(self, *, idle: bool) -> Correction:
        guider = self._guider
        if guider is None:
            return Correction()
        fault = guider.fault()
        if fault is not None and fault[1] == "reversed":
            axis = "right ascension" if fault[0] == "primary" else "declination"
            raise DeviceRefused(
                f"the mount does the opposite of what it is told in {axis}: corrections make it worse",
                device=self._equipment.name,
                advice="look at the mount's setting for guiding after a flip, or at its guide cable's",
                reason=Refusal.OTHER,
            )
        now_s = self._seconds(self._equipment.clock.utc())
        interval_s = self._plan.every_s
        done = Correction() if idle else guider.correction(now_s, interval_s)
        await self._send(done)
        guider.corrected(done, self._seconds(self._equipment.clock.utc()))
        return done

    async def _send(self, done: Correction) -> None:
        east, north = self._to_sky(done.primary.step_arcsec, done.secondary.step_arcsec)
        for size, rate, plus, minus in (
            (east, 0, Direction.EAST, Direction.WEST),
            (north, 1, Direction.NORTH, Direction.SOUTH),
        ):
            duration_s = round(abs(size) / self._guide_arcsec_s[rate] / 0.001) * 0.001
            if duration_s >= 0.5 * LEAST_PULSE_S:
                await self._equipment.mount.guide(
                    plus if size > 0.0 else minus, min(duration_s, LONGEST_PULSE_S)
                )
                self._counts.corrections += 1
                kill_point("hold pulse")
        if self._by == "pulses":
            return
        east_s, north_s = self._to_sky(done.primary.rate_arcsec_s, done.secondary.rate_arcsec_s)
        assert self._wanted is not None
        cosine = max(math.cos(math.radians(self._wanted.dec_deg)), NEAR_POLE_COS)
        rates = OffsetRates(east_s / cosine, north_s)
        if rates.none and self._rates.none:
            return
        if not rates.none:
            lasts_s = max(_RATES_LAST * self._plan.every_s, _RATES_LEAST_S)
            ends_utc = self._equipment.clock.utc() + timedelta(seconds=lasts_s)
            await self._equipment.mount.set_offset_rates(rates, ends_utc=ends_utc)
        else:
            await self._equipment.mount.end_offset_rates()
        self._counts.corrections += 1
        self._rates = rates
        kill_point("hold rates")

    def _axes_turn(self, utc: datetime) -> tuple[float, float]:
        """Sine and cosine of the zenith's position angle; of an equatorial mount none is wanted."""
        if self._equipment.mount.mounting != "altaz":
            return 0.0, 1.0
        assert self._wanted is not None
        site = self._equipment.site
        angle = icrs_to_hour_angle(self._wanted, utc, site, self._equipment.air)
        h, d, latitude = (math.radians(one) for one in (angle.ha_deg, angle.dec_deg, site.latitude_deg))
        up = math.atan2(
            math.sin(h) * math.cos(latitude),
            math.cos(d) * math.sin(latitude) - math.sin(d) * math.cos(latitude) * math.cos(h),
        )
        return math.sin(up), math.cos(up)

    def _to_axes(self, east: float, north: float) -> tuple[float, float]:
        """Along the axes: for an alt-azimuth mount azimuth, which grows to the right, and altitude."""
        if self._equipment.mount.mounting != "altaz":
            return east, north
        sine, cosine = self._turned
        return -east * cosine + north * sine, east * sine + north * cosine

    def _to_sky(self, primary: float, secondary: float) -> tuple[float, float]:
        # along the axes is a mirrored frame, and mirroring undoes itself
        return self._to_axes(primary, secondary)

    # -- dithers -------------------------------------------------------------------------------------

    def _begin_dither(self) -> None:
        if self._asked.empty() or self._guider is None or self._origin is None:
            return
        wish, answered = self._asked.get_nowait()
        if answered.done():
            return
        factor = 1.0 if wish.unit == "arcsec" else self._scale or 1.0
        number = self._number + 1 if wish.number is None else wish.number
        try:
            east, north = (factor * part for part in wish.plan.step(number))
            settle = Settle(wish.settle_within * factor, wish.settle_looks)
        except BadRequest as wrong:
            answered.set_exception(wrong)
            return
        primary, secondary = self._to_axes(east - self._dithered[0], north - self._dithered[1])
        self._guider.wanted_elsewhere(primary, secondary)
        self._dithered, self._number = (east, north), number
        self._wanted = displaced(self._origin, east, north)
        self._counts.recent.clear()
        self._dithering = _Dithering(wish, number, settle, self._equipment.clock.monotonic_s(), answered)
        self._equipment.listen("dithering", {"number": number, "east_arcsec": east, "north_arcsec": north})

    def _judge_dither(self, off_arcsec: float) -> None:
        under_way = self._dithering
        if under_way is None:
            return
        under_way.looks += 1
        elapsed_s = self._equipment.clock.monotonic_s() - under_way.began_s
        if under_way.ended.done():
            self._dithering = None  # who asked for it has gone
        elif under_way.settle.saw(off_arcsec):
            report = DitherReport(under_way.number, *self._dithered, off_arcsec, under_way.looks, elapsed_s)
            under_way.ended.set_result(report)
            self._dithering = None
            self._equipment.listen("settled", {"number": report.number, "off_arcsec": off_arcsec})
        elif elapsed_s > under_way.wish.timeout_s:
            under_way.ended.set_exception(
                TargetNotReached(
                    f"the dither did not settle in {elapsed_s:.0f} s: the last look is {off_arcsec:.1f}″ off",
                    device=self._equipment.name,
                    advice="allow a wider settle_within, or check the noise that the hold reports",
                    reason=NotReached.RESTLESS,
                )
            )
            self._dithering = None

    # -- what is told --------------------------------------------------------------------------------

    def _tell(self, look: Look | None, fate: LookFate | None, problem: str | None, done: Correction) -> None:
        counts = self._counts
        wanted = self._wanted
        off = None if look is None or wanted is None else offset_arcsec(look.seen, wanted)
        step = self._to_sky(done.primary.step_arcsec, done.secondary.step_arcsec)
        rate = self._to_sky(done.primary.rate_arcsec_s, done.secondary.rate_arcsec_s)
        fault = None if self._guider is None else self._guider.fault()
        if problem is None and fault is not None:
            axis = "right ascension" if fault[0] == "primary" else "declination"
            problem = f"corrections in {axis} are {fault[1]}: it is left alone"
        progress = HoldProgress(
            number=counts.looks,
            utc=self._equipment.clock.utc() if look is None else look.mid_exposure_utc,
            fate="not-solved" if fate is None else str(fate),
            east_arcsec=None if off is None else off.east_arcsec,
            north_arcsec=None if off is None else off.north_arcsec,
            sigma_arcsec=None if look is None else self._sigma,
            step_east_arcsec=step[0],
            step_north_arcsec=step[1],
            rate_east_arcsec_s=rate[0],
            rate_north_arcsec_s=rate[1],
            rms_arcsec=math.sqrt(sum(counts.recent) / len(counts.recent)) if counts.recent else None,
            dithered=self._dithered,
            settled=None if self._dithering is None else self._dithering.settle.settled,
            problem=problem,
            known=None if self._guider is None else self._known(),
        )
        self._heard(progress)

    def _known(self) -> HoldKnown:
        if self._guider is None:
            raise SolveFailed(
                "no look was solved while it held",
                device=self._equipment.name,
                advice="check for clouds, dew and focus",
                reason="none",
            )
        primary, secondary = self._guider.state(self._sigma)
        east, north = self._to_sky(primary.rate_arcsec_s, secondary.rate_arcsec_s)
        gain, gain_sigma, play, play_sigma = self._guider.secondary.gain_and_play()
        scaled = self._guider.rates_known
        return HoldKnown(
            drift_east_arcsec_min=60.0 * east if scaled else None,
            drift_east_sigma_arcsec_min=60.0 * primary.rate_sigma_arcsec_s if scaled else None,
            drift_north_arcsec_min=60.0 * north if scaled else None,
            drift_north_sigma_arcsec_min=60.0 * secondary.rate_sigma_arcsec_s if scaled else None,
            period_s=self._guider.primary.period_s,
            amplitudes_arcsec=primary.amplitudes_arcsec if scaled else (),
            amplitude_sigma_arcsec=primary.amplitude_sigma_arcsec if scaled else None,
            noise_arcsec=max(primary.noise_arcsec, secondary.noise_arcsec),
            gain=gain,
            gain_sigma=gain_sigma,
            play_arcsec=play,
            play_sigma_arcsec=play_sigma,
            rotation=self._rotation.trend(),
            bending=self._bending.bending(),
        )

    async def _note(self, what: str, facts: dict[str, object]) -> None:
        await self._equipment.note(EntryKind.DECISION, what, facts)
        self._equipment.listen("holding", {"what": what, **facts})

    def _ends_utc(self) -> datetime | None:
        for_s = self._plan.for_s
        return None if for_s is None else self._epoch_utc + timedelta(seconds=for_s)

    def _seconds(self, utc: datetime) -> float:
        return (utc - self._epoch_utc).total_seconds()


def _means(equipment: Equipment, by: HoldBy | None) -> HoldBy:
    """By what the mount is corrected.

    Raises
    ------
    DeviceRefused
        It takes neither.
    """
    skills = equipment.mount.skills
    can: set[str] = set()
    if Skill.GUIDE in skills:
        can.add("pulses")
    if Skill.OFFSET_RATES in skills:
        can.add("rates")
    if len(can) == 2:
        can.add("both")
    chosen: HoldBy = by or ("pulses" if "pulses" in can else "rates")
    if chosen not in can:
        raise DeviceRefused(
            f"the mount can't be corrected by {chosen}" + (f", by {' or '.join(sorted(can))}" if can else ""),
            device=equipment.name,
            advice="leave out `by`" if can else "this mount takes neither guide pulses nor rates",
            reason=Refusal.UNSUPPORTED,
        )
    return chosen


__all__ = [
    "DitherReport",
    "DitherWish",
    "HoldBy",
    "HoldKnown",
    "HoldLooks",
    "HoldPlan",
    "HoldProgress",
    "HoldReport",
    "Holding",
]
