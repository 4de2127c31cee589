"""Axes moved by hand: for a moment at a time, prolonged by being ordered again, never into a limit.

::

    refused? -> limits ahead, with braking -> guard armed -> written -> sent -> moves -> ended, seen at rest
                                                                                  |
                 its time, 0 ordered, a limit ahead, a stop, slew, park, home, tracking ordered, close
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from datetime import timedelta
from typing import Final, get_args

from mountnav.devices import MountAxis, MountReading, MovesAxes, RateSpan, Skill, from_mount, skills_of
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceRefused,
    MountnavError,
    OutsideLimits,
)
from mountnav.journal.records import EntryKind, Outcome
from mountnav.mount.order_rooms import OrderRooms
from mountnav.mount.self_acting import SelfActingOrders
from mountnav.mount.sending import OrderResult, OvertakenError
from mountnav.pointing.limits import Reached
from mountnav.pointing.limits.refusing import why as in_words
from mountnav.sky.coordinates import Observed
from mountnav.sky.sphere import separation_arcsec
from mountnav.tasks import begun, first_of

__all__ = ["AxisOrders"]

AXIS_LOOK_S = 0.5
"""How often a moved axis is looked at, s. Chosen by hand: two or three exchanges of a slow line. Doubled,
axes are ended half a second's way earlier before a limit."""
_HEARD_S = 1.5
"""So long after a reading the order to end is heard, s: a look, one exchange, and a slow line. Doubled, axes
are ended twice as far before a limit; halved, a slow line lets one at 4°/s 3° beyond."""
_GRACE_S = 2.0
"""The guard waits so much longer than an axis may go on for news, s. Doubled, an axis of a service that hangs
goes on for so much longer."""
_REST_POLL_S = 0.4
"""Between two readings that show whether an axis rests, s. Halved, steps of a coarse reading look like
motion."""
_REST_WITHIN_S = 8.0
"""So long after its end an axis may turn on, s, beside what it brakes for. Chosen by hand. Doubled, one that
doesn't heed its end is stopped that much later."""
_STILL_SHARE = 0.25
"""An axis rests when it turns at less than this share of its speed. Chosen by hand. Doubled, one that brakes
slowly is taken for one at rest."""
_NAME: Final = "move-axis"
_AXES: tuple[MountAxis, ...] = get_args(MountAxis)
_SUPERSIDEREAL_DEG_S = 0.02
"""Slower than this an axis' motion is below what tracking explains, °/s: whether it rests can't be read."""


@dataclass(slots=True)
class _Moved:
    """An axis that moves, or may.

    Attributes
    ----------
    until_s : float
        When it ends unless it is ordered again, on the monotonic clock.
    """

    rate_deg_s: float
    until_s: float


class AxisOrders(SelfActingOrders):
    """Moves one mount's axes, and ends them.

    Parameters
    ----------
    stop : callable
        ``stop(why)``: stops the mount.
    follows : callable
        Whether rates beside the stars' are in force.
    """

    def __init__(
        self,
        rooms: OrderRooms,
        *,
        stop: Callable[[str], Awaitable[None]],
        follows: Callable[[], bool],
    ) -> None:
        super().__init__(rooms, _NAME, "the motion of an axis", stop=stop)
        self._follows = follows
        self._moved: dict[MountAxis, _Moved] = {}
        self._changed = asyncio.Event()
        self._watch.by_hand = self.look

    @property
    def owed(self) -> bool:
        """Whether an axis moves by an order of ours, or may."""
        return bool(self._moved)

    # -- ordering ----------------------------------------------------------------------------------

    async def move(self, axis: MountAxis, rate_deg_s: float, *, for_s: float) -> None:
        """Move an axis on for a moment. See `CheckedMount.move_axis`."""
        if axis not in _AXES:
            raise BadRequest(f"there is no axis {axis!r}", advice=f"one of {', '.join(_AXES)}")
        if not (math.isfinite(rate_deg_s) and math.isfinite(for_s)):
            raise BadRequest(f"{rate_deg_s} °/s for {for_s} s is no motion")
        if rate_deg_s == 0.0:
            await self.end(f"the {axis} axis was ordered to end", axis)
            return
        stops = self._sender.stops
        mount = await self._skilled()
        await self._admission.require_free(_NAME)
        before = await self._admission.ready(_NAME)
        try:
            self._require_sense(mount, axis, rate_deg_s, for_s)
            self._require_within(before, {axis: rate_deg_s}, for_s)
        except MountnavError as refusal:
            if self._moved.get(axis) is not None and isinstance(refusal, OutsideLimits):
                with contextlib.suppress(MountnavError):
                    await self.end(f"the limits ahead: {refusal.what}", axis)
            await self._sender.refused(_NAME, refusal, before)
            raise
        async with self._wire:
            await self._admission.require_free(_NAME)
            if self._follows():
                raise self._busy_following()
            if self._sender.stops != stops:
                raise self._stopped()
            moved = self._moved.get(axis)
            until_s = self._clock.monotonic_s() + for_s
            if moved is not None and moved.rate_deg_s == rate_deg_s and not self.ending.problem:
                self._arm(for_s)
                moved.until_s = until_s
                self._changed.set()
                return
            await self._sent(mount, axis, _Moved(rate_deg_s, until_s), for_s, before, stops)
        if self._sender.stops != stops:
            await self._ended_quietly("a stop came while it was ordered")
            raise self._stopped()

    async def _sent(
        self,
        mount: MovesAxes,
        axis: MountAxis,
        wanted: _Moved,
        for_s: float,
        before: MountReading,
        stops: int,
    ) -> None:
        was = self._moved.get(axis)

        async def send() -> None:
            self._arm(for_s)
            self._guard.set_out()
            self._guard.chooses_anew()
            # from here on it may move
            self._moved[axis] = wanted
            self._count_down()
            await mount.move_axis(axis, wanted.rate_deg_s)

        facts: dict[str, object] = {"axis": axis, "rate_deg_s": wanted.rate_deg_s, "for_s": for_s}
        try:
            await self._sender.send(
                _NAME,
                send,
                lambda _nothing: OrderResult(Outcome.DONE),
                stops=stops,
                moves=True,
                facts=facts,
                before=before,
            )
        except OvertakenError:
            raise self._stopped() from None
        except (DeviceRefused, BadRequest):
            # it moves as before
            if was is None:
                self._moved.pop(axis, None)
            else:
                self._moved[axis] = was
            self._settle()
            raise
        except (MountnavError, asyncio.CancelledError):
            self.ending.begin("whether it moves isn't known")
            raise
        self._watch.wake()

    def _require_sense(self, mount: MovesAxes, axis: MountAxis, rate_deg_s: float, for_s: float) -> None:
        policy = self._policy
        if not 0.0 < for_s <= policy.most_axis_s:
            raise BadRequest(
                f"an axis moved for {for_s:g} s: above 0, at most {policy.most_axis_s:g} s at once",
                advice="order it again before that time is over; or set following.most_axis_s",
            )
        if abs(rate_deg_s) > policy.most_axis_deg_s:
            raise BadRequest(
                f"an axis at {abs(rate_deg_s):g}°/s: at most {policy.most_axis_deg_s:g}°/s are allowed",
                advice="choose a slower speed; or set following.most_axis_deg_s",
            )
        spans = mount.axis_rates_deg_s.get(axis, ())
        if not any(_in(span, abs(rate_deg_s)) for span in spans):
            told = ", ".join(f"{span.least_deg_s:g} to {span.most_deg_s:g}" for span in spans) or "none"
            raise BadRequest(
                f"this mount doesn't move its {axis} axis at {abs(rate_deg_s):g}°/s",
                device=self._mount.name,
                advice=f"it moves it at (°/s): {told}",
            )
        if self._follows():
            raise self._busy_following()

    def _busy_following(self) -> Busy:
        return Busy(
            "it follows a moving target, at offset rates",
            device=self._mount.name,
            advice="end that motion first, or stop it",
        )

    def _require_within(
        self, before: MountReading, rates_deg_s: dict[MountAxis, float], for_s: float
    ) -> None:
        rates = {axis: moved.rate_deg_s for axis, moved in self._moved.items()} | rates_deg_s
        reached = self._guard.turns_into(before, rates, for_s + self._runs_on_s(rates.values()))
        if reached is None:
            return
        at = before.utc + timedelta(seconds=reached.after_s)
        place = Observed(reached.az_deg, reached.alt_deg, at)
        raise OutsideLimits(
            f"moved so it comes in {reached.after_s:.1f} s, or braking after that, to altitude "
            f"{reached.alt_deg:.1f}°, azimuth {reached.az_deg:.0f}°, "
            f"{in_words(self._guard.limits, reached.limit, 0.0, place)}",
            advice="move it more slowly, for a shorter time, or the other way",
            limit=reached.limit,
        )

    def _runs_on_s(self, rates_deg_s: Iterable[float]) -> float:
        """How long, at its full speed, an axis would take for the way on which it is ended and brakes."""
        fastest = max((abs(rate) for rate in rates_deg_s), default=0.0)
        return _HEARD_S + 0.5 * fastest / self._policy.axis_braking_deg_s2

    async def _skilled(self) -> MovesAxes:
        if Skill.MOVE_AXIS not in skills_of(self._mount) or not isinstance(self._mount, MovesAxes):
            raise await self._admission.unsupported(_NAME)
        return self._mount

    def _stopped(self) -> Cancelled:
        return Cancelled("stopped before the axis was moved", device=self._mount.name)

    def _arm(self, for_s: float) -> None:
        self._armed.need(_NAME, self._clock.utc() + timedelta(seconds=for_s + _GRACE_S))

    # -- watching ----------------------------------------------------------------------------------

    async def look(self, reading: MountReading) -> float | None:
        """End what moves before a limit; how soon to look again, None if nothing moves."""
        if not self._moved:
            return None
        rates = {axis: moved.rate_deg_s for axis, moved in self._moved.items()}
        age_s = max(0.0, (self._clock.utc() - reading.utc).total_seconds())
        ahead_s = age_s + AXIS_LOOK_S + self._runs_on_s(rates.values())
        reached = self._guard.turns_into(reading, rates, ahead_s)
        if reached is not None:
            await self._end_at(reached, reading)
        return AXIS_LOOK_S

    async def _end_at(self, reached: Reached, reading: MountReading) -> None:
        place = Observed(reached.az_deg, reached.alt_deg, reading.utc)
        what = (
            f"moved by hand it would come to altitude {reached.alt_deg:.1f}°, azimuth {reached.az_deg:.0f}°, "
            f"{in_words(self._guard.limits, reached.limit, 0.0, place)}"
        )
        facts: dict[str, object] = {
            "limit": str(reached.limit),
            "why": what,
            "altitude_deg": reached.alt_deg,
            "azimuth_deg": reached.az_deg,
        }
        self._book.note_now(EntryKind.FAULT, "an axis is ended before a limit", facts)
        self._state.tell("limit-stop", facts)
        await self._ended_quietly(what)

    # -- ending ------------------------------------------------------------------------------------

    async def end(self, why: str, axis: MountAxis | None = None) -> None:
        """End one axis or both, and return when they are seen at rest; nothing to end is fine.

        Raises
        ------
        DeviceError
            It is tried on, and the mount stopped if that doesn't help.
        """
        if axis is None or axis in self._moved:
            # the other axis, if it moves, may go on
            others = {name: one for name, one in self._moved.items() if axis is not None and name != axis}
            if others:
                await self._end_one(axis, why)
            elif self._moved:
                await self.ending.now(why)

    async def _end_one(self, axis: MountAxis | None, why: str) -> None:
        assert axis is not None
        try:
            async with self._wire:
                await self._told_to_end([axis], why)
        except MountnavError:
            self.ending.begin(why)
            raise
        self._moved.pop(axis, None)
        self._settle()

    async def stopped(self) -> None:
        """A stop was sent: end them too, some mounts stop slews alone. Never raises a `MountnavError`."""
        if self._moved:
            await self._ended_quietly("a stop")

    async def close(self, within_s: float) -> None:
        """The mount is let go: end them; what can't be ended is left to the guard."""
        await self._let_go(within_s)

    async def take_up(self, why: str) -> None:
        """An earlier run of the service has left an axis moving: end both. Raises as `end`."""
        if Skill.MOVE_AXIS in skills_of(self._mount) and isinstance(self._mount, MovesAxes):
            for axis in _AXES:
                # how fast isn't known any more: both are seen at rest
                self._moved.setdefault(axis, _Moved(self._policy.most_axis_deg_s, math.inf))
            await self._end_left(why)

    async def _end_once(self, why: str) -> None:
        """End all, and see them at rest. Raises a `MountnavError` if they aren't."""
        async with self._wire:
            axes = list(self._moved)
            if not axes:
                return
            fastest = max(abs(moved.rate_deg_s) for moved in self._moved.values())
            await self._told_to_end(axes, why)
            await self._require_rest(fastest)
            for axis in axes:
                self._moved.pop(axis, None)
            self._settle()

    async def _told_to_end(self, axes: list[MountAxis], why: str) -> None:
        mount = self._mount
        if not isinstance(mount, MovesAxes):
            return
        for axis in axes:
            facts: dict[str, object] = {"axis": axis, "rate_deg_s": 0.0, "why": why}
            with self._written_end(facts):
                await mount.move_axis(axis, 0.0)

    async def _require_rest(self, fastest_deg_s: float) -> None:
        """See that it turns no more. Raises `DeviceRefused`."""
        if fastest_deg_s < _SUPERSIDEREAL_DEG_S:
            return
        brakes_s = fastest_deg_s / self._policy.axis_braking_deg_s2
        until_s = self._clock.monotonic_s() + brakes_s + _REST_WITHIN_S
        before = await self._state.reading()
        while True:
            await self._clock.sleep(_REST_POLL_S)
            now = await self._state.reading()
            seconds = max((now.utc - before.utc).total_seconds(), 1e-3)
            turned = separation_arcsec(from_mount(before.place), from_mount(now.place)) / 3600.0 / seconds
            steps = 3.0 * self._mount.resolution_arcsec / 3600.0 / seconds
            # one at rest over the ground seems to turn with the sky
            if turned <= max(_STILL_SHARE * fastest_deg_s, _SUPERSIDEREAL_DEG_S, steps):
                return
            if self._clock.monotonic_s() > until_s:
                raise DeviceRefused(
                    f"an axis still turns at {turned:.2f}°/s after it was told to end",
                    device=self._mount.name,
                    advice="stop it, or cut its power",
                )
            before = now

    def _settle(self) -> None:
        self._changed.set()
        if not self._moved:
            self._no_countdown()
            self._armed.free(_NAME)
        self._watch.wake()

    # -- its time ----------------------------------------------------------------------------------

    def _count_down(self) -> None:
        if self._timer is None or self._timer.done():
            self._timer = begun(self._until_its_time(), "axis-time", died=self._timer_died)
        self._changed.set()

    async def _until_its_time(self) -> None:
        while self._moved:
            self._changed.clear()
            now_s = self._clock.monotonic_s()
            over = [axis for axis, moved in self._moved.items() if moved.until_s <= now_s]
            if over:
                why = "its time is over and it was not ordered again"
                try:
                    await self.end(why, over[0] if len(over) == 1 else None)
                except MountnavError:
                    return  # it is tried on
                continue
            left_s = min(moved.until_s for moved in self._moved.values()) - now_s
            await first_of(self._clock.sleep(max(left_s, 0.0)), self._changed.wait())


def _in(span: RateSpan, rate_deg_s: float) -> bool:
    # ends are given in other units by most protocols, and rounded on the way
    return span.least_deg_s * (1.0 - 1e-6) <= rate_deg_s <= span.most_deg_s * (1.0 + 1e-6)
