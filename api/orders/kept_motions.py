"""Motions of programs that say only when they begin and when they end: kept up while the program lives.

An ASCOM client sends a speed and, later, 0; an INDI or LX200 program a key pressed and a key released. None
repeats itself, so a program that dies would leave the mount turning. Here each motion is ordered for a moment
only, and ordered again and again as long as the program is heard and its time isn't over. Rates beside the
sidereal one are kept in the same way, with longer spans. All orders go through the dispatcher.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from api.access.callers import Caller
from api.orders.dispatcher import Dispatcher
from api.orders.goto_orders import NotTaken, words_of
from api.orders.job import Job
from api.orders.vocabulary import MoveAxisOrder, OffsetRatesOrder
from api.problems import Problem, Refused, problem_of
from mountnav.clock import real_s, sky_s
from mountnav.devices import MountAxis, OffsetRates, RateSpan
from mountnav.errors import Busy, MountnavError
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from mountnav.tasks import begun, fault_words

__all__ = ["SPEEDS", "KeptAxes", "KeptRates", "ladder", "nearest_speed"]

_ORDERED_S = 1.5
"""For how long each order moves an axis on, s: three repeats. Doubled, the mount of a service that was killed
turns for 3 s."""
_REPEAT_S = 0.5
"""How often a motion is ordered again, s. Doubled, one late turn of the loop ends a motion that is wanted."""
_TAKEN_S = 5.0
"""How long it is waited whether a mount takes a motion, s. Halved, slow handsets are reported as taken before
they have refused."""
SPEEDS = (1.0, 16.0, 64.0, None)
"""Speeds of a pad's four steps (guide, center, find, slew), in multiples of the sidereal rate; None: the
fastest. Doubled, the step for centering at a high power jumps over the target."""


def nearest_speed(spans: Sequence[RateSpan], wanted_deg_s: float) -> float | None:
    """The speed that an axis can, nearest to a wanted one; None if it can't move at all."""
    can = [min(max(wanted_deg_s, span.least_deg_s), span.most_deg_s) for span in spans if span.most_deg_s > 0]
    return min(can, key=lambda speed: abs(speed - wanted_deg_s), default=None)


def ladder(spans: Sequence[RateSpan], most_deg_s: float) -> tuple[float, ...]:
    """The four speeds of a pad of keys, °/s; empty if the axis can't be moved.

    Parameters
    ----------
    most_deg_s : float
        No faster than that, where the axis can be as slow.
    """
    fastest_deg_s = min(most_deg_s, max((span.most_deg_s for span in spans), default=0.0))
    wanted = [fastest_deg_s if times is None else times * SIDEREAL_DEG_S for times in SPEEDS]
    found = [nearest_speed(spans, min(speed, fastest_deg_s)) for speed in wanted]
    return tuple(speed for speed in found if speed is not None)


@dataclass(slots=True)
class _Key:
    """One motion that is kept up.

    Attributes
    ----------
    lives : callable
        Why its program doesn't count as living any more; None while it does.
    """

    caller: Caller
    rate_deg_s: float
    job: Job
    until_s: float
    lives: Callable[[], str | None]


class KeptAxes:
    """Axes of one telescope as one face moves them.

    Parameters
    ----------
    most_s : float
        A motion ends by itself so long after it was ordered.
    ended : callable
        ``ended(axis, why, problem)``: told of each motion that nobody ended: in words, and as a problem if it
        failed.
    """

    def __init__(
        self,
        dispatcher: Dispatcher,
        telescope_id: str,
        *,
        most_s: float,
        ended: Callable[[MountAxis, str, Problem | None], None],
    ) -> None:
        self._dispatcher = dispatcher
        self._telescope_id = telescope_id
        self._most_s = most_s
        self._ended = ended
        self._keys: dict[MountAxis, _Key] = {}
        self._task: asyncio.Task[None] | None = None

    @property
    def rates_deg_s(self) -> Mapping[MountAxis, float]:
        """How fast each axis is moved from here."""
        return {axis: key.rate_deg_s for axis, key in self._keys.items()}

    def is_of(self, caller: Caller) -> bool:
        """Whether one of them is moved by this caller."""
        return any(key.caller.name == caller.name for key in self._keys.values())

    async def move(
        self,
        caller: Caller,
        axis: MountAxis,
        rate_deg_s: float,
        lives: Callable[[], str | None],
        *,
        stops_given: int | None = None,
    ) -> None:
        """Move an axis on, or change its speed; the mount has taken it when this returns.

        Parameters
        ----------
        lives : callable
            Asked twice a second: why the motion has to end now; None if it may go on.
        stops_given : int, optional
            As the dispatcher's `order`.

        Raises
        ------
        NotTaken
            It moves no more by this order.
        """
        try:
            job = await self._ordered(caller, axis, rate_deg_s, stops_given=stops_given)
        except NotTaken:
            self._keys.pop(axis, None)
            raise
        until_s = asyncio.get_running_loop().time() + self._most_s
        mine = _Key(caller, rate_deg_s, job, until_s, lives)
        self._keys[axis] = mine
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_TAKEN_S):
                await self._dispatcher.held(self._telescope_id).taken(job, axis)
        if job.is_over and job.problem is not None:
            if self._keys.get(axis) is mine:
                del self._keys[axis]
            raise NotTaken(job.problem)
        if self._task is None or self._task.done():
            self._task = begun(self._keep(), f"keeps axes of {self._telescope_id}", died=self._died)

    async def end(self, caller: Caller, axis: MountAxis) -> None:
        """End the motion of an axis; one that isn't moved from here is left alone.

        Raises
        ------
        NotTaken
            The mount could not be told; it ends by itself in a moment.
        """
        key = self._keys.pop(axis, None)
        if key is None or key.job.is_over:
            return
        job = await self._ordered(key.caller, axis, 0.0, key.job)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_TAKEN_S):
                await self._dispatcher.held(self._telescope_id).taken(job, axis)
                if not self._keys:
                    await job.ended.wait()

    async def end_all(self, *, of: Callable[[Caller], bool] = lambda caller: True) -> None:
        """End what is moved from here, by these callers; what can't be told ends by itself in a moment."""
        for axis, key in list(self._keys.items()):
            if of(key.caller):
                with contextlib.suppress(NotTaken):
                    await self.end(key.caller, axis)

    def forget(self) -> None:
        """Everything was stopped: nothing is kept up any more."""
        self._keys.clear()

    async def close(self) -> None:
        """Keep nothing up any more, and end it."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        await self.end_all()

    async def _ordered(
        self,
        caller: Caller,
        axis: MountAxis,
        rate_deg_s: float,
        job: Job | None = None,
        *,
        stops_given: int | None = None,
    ) -> Job:
        """Order it; with a job into that one alone, so that what has ended meanwhile doesn't begin again."""
        order = MoveAxisOrder(
            axis=axis, rate_deg_s=rate_deg_s, for_s=_ORDERED_S, job_id=None if job is None else job.id
        )
        try:
            return await self._dispatcher.order(caller, self._telescope_id, order, stops_given=stops_given)
        except (Refused, MountnavError) as refusal:
            raise NotTaken(
                refusal.problem if isinstance(refusal, Refused) else problem_of(refusal)
            ) from refusal

    async def _keep(self) -> None:
        while self._keys:
            await asyncio.sleep(_REPEAT_S)
            for axis, key in list(self._keys.items()):
                await self._keep_one(axis, key)

    async def _keep_one(self, axis: MountAxis, key: _Key) -> None:
        if self._keys.get(axis) is not key:
            return
        if key.job.is_over:
            # never begun again: somebody, or a limit, has ended it
            self._keys.pop(axis, None)
            self._tell_end(axis, key.job)
            return
        late = asyncio.get_running_loop().time() >= key.until_s
        why = f"it was not renewed within {self._most_s:g} s" if late else key.lives()
        try:
            if why is None:
                await self._ordered(key.caller, axis, key.rate_deg_s, key.job)
                return
            await self.end(key.caller, axis)
        except NotTaken as refusal:
            if self._keys.get(axis) is key:
                del self._keys[axis]
            self._ended(axis, why or refusal.words, refusal.problem)
        else:
            self._ended(axis, why, None)

    def _tell_end(self, axis: MountAxis, job: Job) -> None:
        if job.problem is not None:
            self._ended(axis, words_of(job.problem), job.problem)
        else:
            self._ended(axis, "the mount ended it", None)

    def _died(self, fault: Exception) -> None:
        """Nobody keeps them up: they end by themselves in a moment, and that is told."""
        keys, self._keys = self._keys, {}
        for axis in keys:
            self._ended(axis, fault_words(fault), None)


_RATES_AGAIN_S = 5.0
"""After how long rates are ordered again that found the telescope busy, s. Doubled, rates that are wanted
lapse where each job between leaves less than 10 s free."""
_LOOKS = 8
"""So often it is looked whether the program was heard, until rates would end. Halved, an answer that comes
just after a look counts a quarter of the span later, and rates of a busy machine lapse."""
_DUE = 0.5
"""An end is put off when no more than this share of the span is left. Doubled, each look is an order."""
_WORTH_IT = 0.1
"""An end is put off by no less than this share of the whole span: less is no new word of the program's."""


class KeptRates:
    """Rates beside the sidereal one of programs that know no end: with one, put off while the program lives.

    Parameters
    ----------
    within_s : float
        They end so long after the program was last heard, whatever becomes of it and of its connection.
    """

    def __init__(self, dispatcher: Dispatcher, telescope_id: str, *, within_s: float) -> None:
        self._dispatcher = dispatcher
        self._telescope_id = telescope_id
        self._within_s = within_s
        self._task: asyncio.Task[None] | None = None

    async def set(
        self,
        caller: Caller,
        rates: OffsetRates,
        silent_s: Callable[[], float | None],
        *,
        stops_given: int | None = None,
    ) -> None:
        """Order them, or as for a star again; the mount has taken them when this returns.

        Parameters
        ----------
        silent_s : callable
            For how many of the machine's seconds nothing was heard of the program; None: it has gone.
        stops_given : int, optional
            As the dispatcher's `order`.

        Raises
        ------
        NotTaken
        """
        if stops_given is None:
            stops_given = self._dispatcher.stops_given(self._telescope_id)
        await self._end_keeping()
        ends_s = asyncio.get_running_loop().time() + real_s(self._within_s)
        await self._ordered(caller, rates, self._within_s, stops_given=None if rates.none else stops_given)
        if not rates.none:
            name = f"keeps rates of {self._telescope_id}"
            # they end by themselves
            self._task = begun(self._keep(caller, rates, silent_s, ends_s), name, died=lambda _: None)

    async def close(self) -> None:
        """Put their end off no more."""
        await self._end_keeping()

    async def _end_keeping(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _ordered(
        self, caller: Caller, rates: OffsetRates, for_s: float, *, stops_given: int | None = None
    ) -> None:
        order = OffsetRatesOrder(ra_arcsec_s=rates.ra_arcsec_s, dec_arcsec_s=rates.dec_arcsec_s, for_s=for_s)
        try:
            job = await self._dispatcher.order(caller, self._telescope_id, order, stops_given=stops_given)
        except (Refused, MountnavError) as refusal:
            raise NotTaken(
                refusal.problem if isinstance(refusal, Refused) else problem_of(refusal)
            ) from refusal
        await job.ended.wait()
        if job.problem is not None:
            raise NotTaken(job.problem)

    async def _keep(
        self, caller: Caller, rates: OffsetRates, silent_s: Callable[[], float | None], ends_s: float
    ) -> None:
        """Put their end off to `within_s` after the program's last word, as often as there was a new one."""
        mount = self._dispatcher.telescope(self._telescope_id).navigator.mount
        loop, span_s = asyncio.get_running_loop(), real_s(self._within_s)
        wait_s = span_s / _LOOKS
        while True:
            await asyncio.sleep(wait_s)
            wait_s = span_s / _LOOKS
            force, silence_s = mount.offset_rates_in_force, silent_s()
            if force is None or force.rates != rates or silence_s is None:
                # ended by a stop, a slew, or another face; or nobody is there any more
                return
            left_s, remaining_s = span_s - silence_s, ends_s - loop.time()
            if remaining_s > _DUE * span_s or left_s < remaining_s + _WORTH_IT * span_s:
                continue
            wanted_s = loop.time() + left_s
            try:
                await self._ordered(caller, rates, sky_s(left_s))
                ends_s = wanted_s
            except NotTaken as refusal:
                if not refusal.problem.type.endswith(f":{Busy.slug}"):
                    return
                wait_s = min(_RATES_AGAIN_S, wait_s)
