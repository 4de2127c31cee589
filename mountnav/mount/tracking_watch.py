"""Tracking into a limit stops in time, and so does a slew that goes another way than was predicted.

`TrackingWatch` holds the mount against its limits now and then; `LimitStop` ends the motion or the tracking
there, by stop, rest or park; written down, reported, and watched.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Container
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Protocol

from mountnav.clock import Clock
from mountnav.devices import MountReading, Skill, SlewOutcome, TrackingRate, from_mount, offset_speed_arcsec_s
from mountnav.errors import DeviceError, DeviceRefused, LimitKind, MountnavError, OutsideLimits
from mountnav.journal.records import EntryKind, because
from mountnav.mount.axis_rates import Braking
from mountnav.mount.limits_guard import LimitsGuard
from mountnav.mount.mount_state import Listener
from mountnav.mount.order_book import OrderBook
from mountnav.pointing.limits import Reached, SlewCheck
from mountnav.pointing.limits.refusing import why
from mountnav.sky.sphere import separation_arcsec
from mountnav.tasks import begun, fault_words, first_of, waited_for

SLEWING_S = 1.0
"""How often a motion is looked at, s. Chosen by hand. Doubled, a mount at 5°/s goes 10° between two looks."""
_WATCHED_S = 4.0
"""Between the two readings that show whether a mount tracks that doesn't report it, s: the sky turns by 60″,
at declination 60° by 30″, more than most mounts' steps. Doubled, a mount at a limit tracks on for as long."""
_TELL_AGAIN_S = 60.0
"""A stop at a limit that failed is tried at each look and reported again after so long, s. Chosen by hand:
one row of the journal a minute. Halved, an unplugged mount fills the journal twice as fast."""


class Watched(Protocol):
    """What the watch asks of the mount, and orders."""

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do."""
        ...

    @property
    def trusted(self) -> bool:
        """Whether its position counts."""
        ...

    async def reading(self) -> MountReading:
        """Where it is."""
        ...

    async def stop(self) -> None:
        """Stop it."""
        ...

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Track or rest."""
        ...

    async def park(self) -> SlewOutcome:
        """Park it."""
        ...


class LimitStop:
    """Ends what one mount does, by orders that are checked and written like any other.

    Parameters
    ----------
    tell : callable
        Told ``limit-stop``, ``limit-stop-failed``.
    under_way : callable
        Whether an order to move runs.
    look : callable
        Looks at that order once.
    """

    def __init__(
        self,
        mount: Watched,
        guard: LimitsGuard,
        book: OrderBook,
        clock: Clock,
        tell: Listener,
        *,
        under_way: Callable[[], bool],
        look: Callable[[], Awaitable[None]],
    ) -> None:
        self._mount = mount
        self._guard = guard
        self._book = book
        self._clock = clock
        self._tell = tell
        self._under_way = under_way
        self._look = look
        self._failed_s = -math.inf
        self._over = asyncio.Event()
        self._over.set()

    async def over(self) -> None:
        """Wait until what is being ended has ended: an order before that would be stopped as well."""
        await self._over.wait()

    async def halt(self, reading: MountReading, limit: LimitKind, what: str, *, motion: bool) -> bool:
        """End the motion or the tracking, write it down and report it; whether it was done.

        Parameters
        ----------
        reading : MountReading
            That showed it.
        what : str
            Why, in words.
        motion : bool
            Whether it moves, rather than tracks.
        """
        self._over.clear()
        try:
            return await self._halted(reading, limit, what, motion)
        finally:
            self._over.set()

    async def _halted(self, reading: MountReading, limit: LimitKind, what: str, motion: bool) -> bool:
        seen = self._guard.seen(reading)
        facts: dict[str, object] = {
            "limit": str(limit),
            "why": what,
            "ra_deg": reading.place.ra_deg,
            "dec_deg": reading.place.dec_deg,
            "altitude_deg": seen.alt_deg,
            "azimuth_deg": seen.az_deg,
            "side": None if reading.pier_side is None else str(reading.pier_side),
        }
        again = self._clock.monotonic_s() < self._failed_s + _TELL_AGAIN_S
        if not again:
            self._book.note_now(EntryKind.FAULT, "to be stopped at a limit", facts)
        try:
            with because(why=f"limits: {what}"):
                if limit is LimitKind.SUN and not motion and self._guard.sun_would_come(reading):
                    await self._flee()
                else:
                    await self._end(motion)
        except MountnavError as error:
            facts["error"] = str(error)
            if again:
                return False
            self._failed_s = self._clock.monotonic_s()
            self._book.note_now(EntryKind.FAULT, "could not be stopped at a limit", facts)
            self._tell("limit-stop-failed", facts)
            return False
        self._tell("limit-stop", facts)
        return True

    async def _flee(self) -> None:
        """Get out of the Sun's way: a tube west of it that stands still is where the Sun will be."""
        if Skill.PARK not in self._mount.skills or not self._mount.trusted:
            raise DeviceRefused(
                "it keeps tracking: the Sun would pass over it if it stood still, and it can't park"
            )
        await self._park()

    async def _end(self, motion: bool) -> None:
        if motion:
            await self._mount.stop()
            if self._under_way():
                return  # the slew that was stopped reports it; tracking is judged for itself
        if Skill.TRACK in self._mount.skills:
            try:
                await self._mount.set_tracking(False)
            except DeviceError:
                await self._mount.stop()
                raise
            return
        if not motion:
            await self._mount.stop()
        # many old mounts track on after a stop, and have no words for ending that: parked they rest
        if await self._tracks():
            if Skill.PARK not in self._mount.skills:
                raise DeviceRefused("it keeps tracking after a stop, and can neither stand still nor park")
            await self._park()

    async def _park(self) -> None:
        """Park it, and watch its way from here: the watch itself waits here for that."""
        parking = waited_for(self._mount.park())
        try:
            while not parking.done():
                pause = waited_for(self._clock.sleep(SLEWING_S))
                try:
                    await asyncio.wait({parking, pause}, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    pause.cancel()
                if not parking.done():
                    with contextlib.suppress(MountnavError):  # the next look may be answered; it parks on
                        await self._look()
        finally:
            if not parking.done():
                parking.cancel()
            # what became of it is reported below; it must have ended either way
            await asyncio.gather(parking, return_exceptions=True)
        if parking.result() is SlewOutcome.STALLED:
            raise DeviceError(
                "it stopped on its way to its park position",
                advice="look at the mount: is an axis blocked, or a clutch open?",
            )

    async def _tracks(self) -> bool:
        """Whether it follows the sky, by two readings."""
        before = await self._mount.reading()
        if before.tracking is not None:
            return before.tracking
        await self._clock.sleep(_WATCHED_S)
        after = await self._mount.reading()
        seconds = (after.utc - before.utc).total_seconds()
        moved = separation_arcsec(from_mount(before.place), from_mount(after.place))
        turned = 15.0 * seconds * math.cos(math.radians(after.place.dec_deg))
        return moved < 0.5 * turned


GUESSED_S = 0.5
"""How often a slew is looked at of which it isn't known which way the mount takes, s. Chosen by hand.
Doubled, one that goes the wrong way is stopped half a second later."""
NEAR_S = 2.0
"""How often a mount is looked at that is moved by hand, can't be read, or stands at a limit, s. Chosen by
hand. Doubled, a tube moved by hand at 4°/s comes 8° further outside before it is stopped."""
LEAD_S = 10.0
"""So long before a limit tracking is stopped, s: what reading, ordering and obeying take. The sky turns by
2.5′ in it. Halved, 5 s have to do for a reading, a stop and its repetition."""
SLOWEST_S = 15.0
"""The longest pause between two looks, s, of a mount that rests or has no limit near. Chosen by hand:
tracking goes 4′ in it. Doubled, a mount that somebody begins to move by hand is found out that much later."""
_TELL_FROM_S = 1800.0
"""A limit is announced from so long before it on, s: time for another exposure. Chosen by hand."""
_STILL_ARCSEC_S = 5.0
"""A mount may drift so much faster than the sky turns, ″/s, and isn't taken to be moved: refraction, rates of
Moon and Sun, a step of the reading. Doubled, a slow motion by hand (10″/s) is taken for tracking."""
_CHANGES = 0.25
"""Rates may have been others for a part of the time between two looks: so much of their way is no motion of
its own. Doubled, a mount that is fast by a third is taken to follow."""
_FAST_ARCSEC_S = 15.0
"""A mount that follows faster than this is looked at each 2 s, ″/s: one that gets a rate wrong by a factor of
200 goes a degree in the time. Doubled, twice as far."""
_DEEPER_DEG = 0.25
"""Outside of a limit a mount counts as going deeper from so much on, °, more than readings scatter. Doubled,
it is stopped that much later; at 0 a mount that may leave a limit is stopped by the noise of its readings."""
_OF_SIDES = (LimitKind.MERIDIAN, LimitKind.UNREACHABLE)
"""Limits that hang on the side of the pier: outside of them means nothing until a second reading says so."""

_OF_STATIONS = frozenset({LimitKind.SUN, *_OF_SIDES})
"""Limits that count on the way to the park position and home too."""


class WentAnotherWay(OutsideLimits):
    """A slew took none of the ways that are allowed and was stopped, still inside all limits."""


@dataclass(slots=True, eq=False)
class Following:
    """One order to move, while it runs: what is found out of it, and which stop is its own.

    Attributes
    ----------
    check : SlewCheck or None
        The ways that were checked, if any were.
    left : OutsideLimits or None
        Why it was stopped by the watch.
    stopped : bool
        Whether that stop was heard.
    before : MountReading or None
        The last look's, once it is on its way.
    braking : Braking
        How fast its first axis is seen to turn.
    """

    order: str
    check: SlewCheck | None = None
    left: OutsideLimits | None = None
    stopped: bool = False
    before: MountReading | None = None
    braking: Braking = field(default_factory=Braking)


class TrackingWatch:
    """Watches one mount from `start` to `end`.

    Parameters
    ----------
    tell : callable
        Told ``limit-near`` (limit, seconds left), ``limit-stop``, ``limit-stop-failed``.
    """

    def __init__(
        self, mount: Watched, guard: LimitsGuard, book: OrderBook, clock: Clock, tell: Listener
    ) -> None:
        self._mount = mount
        self._guard = guard
        self._book = book
        self._clock = clock
        self._tell = tell
        self._task: asyncio.Task[None] | None = None
        self._wake = asyncio.Event()
        self._following: Following | None = None
        self._least: dict[LimitKind, float] = {}
        self._before: MountReading | None = None
        self._told_near: tuple[LimitKind, int] | None = None
        self._handled: LimitKind | None = None
        self._untrusted_s = 0.0
        self.by_hand: Callable[[MountReading], Awaitable[float | None]] | None = None
        """Judges a reading while an axis is moved by our order; how soon to look again, None if none is."""
        self._halting = LimitStop(
            mount,
            guard,
            book,
            clock,
            tell,
            under_way=lambda: self._following is not None,
            look=self._look_on_the_way,
        )

    # -- its life ----------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin; once is enough."""
        if self._task is None or self._task.done():
            self._task = begun(self._run(), "limits-watch", died=self._died)

    async def end(self) -> None:
        """End; once is enough."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await task

    def _died(self, fault: Exception) -> None:
        """Nobody watches the limits: report that, and begin again."""
        self._tell("limits-not-watched", {"why": fault_words(fault)})
        self.start()

    def follow(self, order: str, before: MountReading, check: SlewCheck | None = None) -> Following:
        """An order to move goes out: look often, until `unfollow`; whether it goes as checked, if it was."""
        self._following = Following(order, check)
        if check is not None:
            self._guard.overruns(self._following.braking, before, check)
        self._least = self._guard.depths(before, passing=True)
        self._wake.set()
        return self._following

    def unfollow(self, following: Following) -> None:
        """The order has ended."""
        if self._following is following:
            self._following = None
        self._before = None
        self._handled = None
        self._wake.set()

    async def halted(self) -> None:
        """Wait until a stop on the way is over, while the order it belongs to is still followed."""
        await self._halting.over()

    def wake(self) -> None:
        """Look soon: something has changed."""
        self._wake.set()

    async def _run(self) -> None:
        pause_s = NEAR_S
        while True:
            await self._pause(pause_s)
            # before the look: what begins during it must be looked at once more
            self._wake.clear()
            try:
                pause_s = await self.look()
            except DeviceError:
                pause_s = NEAR_S  # the driver's link reports it
            except MountnavError as error:
                self._tell("limits-not-watched", {"why": str(error)})
                await self._book.note(EntryKind.FAULT, "the limits can't be watched", {"why": str(error)})
                pause_s = SLOWEST_S

    async def _pause(self, seconds: float) -> None:
        """Wait, or until an order begins or ends."""
        await first_of(self._clock.sleep(seconds), self._wake.wait())

    # -- a look ------------------------------------------------------------------------------------

    async def look(self) -> float:
        """Read the mount once and do what has to be done; how many seconds later to look again."""
        following = self._following
        reading = await self._mount.reading()
        before, self._before = self._before, reading
        if following is not None and following is self._following:
            await self._look_at_motion(following, reading)
            return SLEWING_S if following.check is None or following.check.sure else GUESSED_S
        soon_s = None if self.by_hand is None else await self.by_hand(reading)
        if soon_s is not None:
            await self._look_at_hand(reading)
            return soon_s
        if self._mount.trusted:
            self._untrusted_s = 0.0
            self._guard.stood(reading)
        if self._guard.following is not None and not reading.parked:
            if reading.slewing or self._moves(before, reading):
                await self._look_at_hand(reading)
            return min(await self._look_at_tracking(before, reading), self._often_s(reading))
        if reading.parked or (reading.tracking is False and not self._moves(before, reading)):
            self._told_near = None
            return SLOWEST_S
        if reading.slewing or self._moves(before, reading):
            self._guard.chooses_anew()
            await self._look_at_hand(reading)
            return NEAR_S
        return await self._look_at_tracking(before, reading)

    def _moves(self, before: MountReading | None, now: MountReading) -> bool:
        """Whether it moved between two readings faster than following, tracking or resting explains."""
        if before is None:
            return False
        seconds = (now.utc - before.utc).total_seconds()
        there, led_arcsec = self._guard.left_alone(before, now.utc)
        moved = separation_arcsec(there, from_mount(now.place))
        return moved > 60.0 + (15.1 + _STILL_ARCSEC_S) * max(seconds, 0.0) + _CHANGES * led_arcsec

    def _often_s(self, reading: MountReading) -> float:
        """How often to look at a mount that follows: one that gets its rates wrong goes elsewhere."""
        following = self._guard.following
        if following is None:
            return SLOWEST_S
        fast = offset_speed_arcsec_s(following.rates, reading.place.dec_deg) > _FAST_ARCSEC_S
        return NEAR_S if fast else SLOWEST_S

    def _deeper(
        self, reading: MountReading, among: Container[LimitKind] = frozenset(LimitKind)
    ) -> tuple[LimitKind, float] | None:
        """Which of these limits it is outside of, and deeper so than it has been."""
        found: tuple[LimitKind, float] | None = None
        for limit, depth in self._guard.depths(reading, passing=True).items():
            least = max(0.0, self._least.get(limit, 0.0))
            if limit in among and depth > least + _DEEPER_DEG and (found is None or depth > found[1]):
                found = limit, depth
            self._least[limit] = min(self._least.get(limit, depth), depth)
        return found

    async def _look_on_the_way(self) -> None:
        """Look at the order to move that runs, if one does: one of the watch itself is watched as well."""
        following = self._following
        if following is None:
            return
        reading = await self._mount.reading()
        if following is self._following:
            await self._look_at_motion(following, reading)

    async def _look_at_motion(self, following: Following, reading: MountReading) -> None:
        # where it parks may be low
        among = frozenset(LimitKind) if following.order == "slew" else _OF_STATIONS
        deeper = self._deeper(reading, among)
        if deeper is not None and deeper[0] in _OF_SIDES:
            # most mounts answer place and side to two questions, and the tube may change sides between them
            reading = await self._mount.reading()
            if self._following is not following:
                return  # it is over
            deeper = self._deeper(reading, among)
        if following.left is not None:
            if not following.stopped:  # it wasn't heard, and the mount may still be going there
                await self._stop_on_the_way(reading, following, following.left)
            return
        before, following.before = following.before, reading
        if deeper is None:
            following.left = self._astray(following.check, before, reading) or await self._overrunning(
                following, reading
            )
            if self._following is not following:
                return  # it is over
        else:
            limit, depth = deeper
            following.left = OutsideLimits(
                f"on its way the mount came to {self._where(reading, limit, depth)}: it was stopped",
                advice=self._guard.advice_beyond(reading, limit),
                limit=limit,
            )
        if following.left is not None:
            await self._stop_on_the_way(reading, following, following.left)

    def _astray(
        self, check: SlewCheck | None, before: MountReading | None, reading: MountReading
    ) -> WentAnotherWay | None:
        """Why a mount has to be stopped that is still inside, since it goes a way that wasn't checked."""
        if check is None:
            return None
        seen = self._guard.seen(reading)
        where = f"it was stopped at altitude {seen.alt_deg:.1f}°, azimuth {seen.az_deg:.0f}°"
        if self._guard.strays(reading, check):
            return WentAnotherWay(
                f"the mount took another path than expected ({', '.join(check.ways)}): {where}",
                advice=self._guard.advice_astray(reading),
                limit=LimitKind.MERIDIAN,
            )
        unlike = None if before is None else self._guard.unlike(before, reading, check)
        if unlike is None or unlike.trouble is None:
            return None
        trouble = unlike.trouble
        return WentAnotherWay(
            f"the mount's second axis turns {unlike.ratio:.2g} times as fast as the first one, which was not "
            f"expected: by altitude {trouble.alt_deg:.1f}°, azimuth {trouble.az_deg:.0f}° it would have come "
            f"outside the limits ({trouble.limit}); {where}",
            advice="set limits.axis_rates_deg_s as they are, or send it again: it is planned for these rates",
            limit=trouble.limit,
        )

    async def _overrunning(self, following: Following, reading: MountReading) -> OutsideLimits | None:
        """Why a mount has to be stopped now, since later it would come to rest beyond a limit."""
        check = following.check
        if check is None or self._guard.overruns(following.braking, reading, check) is None:
            return None
        # place and side by two questions: see above
        again = await self._mount.reading()
        if self._guard.overruns(following.braking, again, check) is None:
            return None
        seen = self._guard.seen(again)
        # planned again it would go on from here, nearer to the limit
        return OutsideLimits(
            "the mount took another path than expected "
            f"({', '.join(check.ways)}), towards the limit past the "
            f"meridian: it was stopped while it could rest before it, at altitude {seen.alt_deg:.1f}°, "
            f"azimuth {seen.az_deg:.0f}°",
            advice=self._guard.advice_astray(again),
            limit=LimitKind.MERIDIAN,
        )

    async def _stop_on_the_way(
        self, reading: MountReading, following: Following, left: OutsideLimits
    ) -> None:
        following.stopped = await self._halting.halt(reading, left.limit, left.what, motion=True)

    async def _look_at_hand(self, reading: MountReading) -> None:
        """Somebody moves it by hand, or it moves by itself: outside it may only come nearer."""
        deeper = self._deeper(reading)
        if deeper is None:
            return
        limit, depth = deeper
        what = f"moved without an order from mountnav to {self._where(reading, limit, depth)}"
        if await self._halting.halt(reading, limit, what, motion=True):
            self._least[limit] = depth  # from here on

    async def _look_at_tracking(self, before: MountReading | None, reading: MountReading) -> float:
        if not self._mount.trusted and await self._lost_for_long(before, reading):
            return SLOWEST_S
        soon = self._guard.reached(reading)
        self._least = self._guard.depths(reading, passing=True)
        if soon is None:
            self._told_near = self._handled = None
            return SLOWEST_S
        age_s = (self._clock.utc() - reading.utc).total_seconds()
        left_s = soon.after_s - age_s
        self._announce(soon, left_s)
        if left_s > LEAD_S:
            self._handled = None
            # look once more when it is near, and not much later than it has to be stopped
            return max(0.1, min(SLOWEST_S, left_s - LEAD_S if left_s < 2.0 * SLOWEST_S else SLOWEST_S))
        if self._handled is not soon.limit:
            what = f"tracking has come to {self._where(reading, soon.limit, 0.0)}"
            if await self._halting.halt(reading, soon.limit, what, motion=False):
                self._handled = soon.limit
        return NEAR_S

    async def _lost_for_long(self, before: MountReading | None, reading: MountReading) -> bool:
        """Stop a mount that has tracked for long, all in all, from a place nobody knows."""
        if before is not None:
            seconds = (reading.utc - before.utc).total_seconds()
            self._untrusted_s += min(max(seconds, 0.0), 2.0 * SLOWEST_S)
        if not self.lost_for_long:
            return False
        await self._halting.halt(reading, LimitKind.UNREACHABLE, self.lost_words, motion=False)
        return True

    @property
    def lost_words(self) -> str:
        """For how long it has tracked from a position that can't be trusted, in words."""
        return f"it has tracked for {self._untrusted_s:.0f} s from a position that can't be trusted"

    @property
    def lost_for_long(self) -> bool:
        """Whether it has tracked from a position that can't be trusted for as long as it may."""
        return not self._mount.trusted and self._untrusted_s >= self._guard.limits.untrusted_tracking_s

    def _where(self, reading: MountReading, limit: LimitKind, depth_deg: float) -> str:
        seen = self._guard.seen(reading)
        return (
            f"altitude {seen.alt_deg:.1f}°, azimuth {seen.az_deg:.0f}°, "
            f"{why(self._guard.limits, limit, max(depth_deg, 0.0), seen)}"
        )

    def _announce(self, soon: Reached, left_s: float) -> None:
        """Tell of a limit that comes near: when it is 30, 15, 8, 4, 2, 1 minutes away."""
        if left_s > _TELL_FROM_S:
            self._told_near = None
            return
        stage = max(0, int(max(left_s, 1.0) / 60.0)).bit_length()
        if self._told_near == (soon.limit, stage):
            return
        self._told_near = soon.limit, stage
        at = self._clock.utc() + timedelta(seconds=max(left_s, 0.0))
        self._tell(
            "limit-near",
            {
                "limit": str(soon.limit),
                "seconds_left": round(max(left_s, 0.0), 1),
                "at_utc": at.isoformat(),
                "altitude_deg": soon.alt_deg,
                "azimuth_deg": soon.az_deg,
            },
        )
