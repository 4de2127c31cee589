"""Axes that somebody holds: moved on as long as further orders come, ended when they cease.

One job per telescope holds both axes, so that a pad of keys can move it diagonally. Each further order of the
same caller prolongs that job, or changes a speed in it; nobody else's does. The job ends when every axis has
come to its end: told to, or because no order came in time. The mount itself is only ever told to move until
then, and ends it by itself though this service dies.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import OrderedDict
from dataclasses import dataclass, field

from api.access.callers import Caller
from api.orders.job import Job
from api.orders.results import AxesMovedView, AxisMovedView
from api.orders.vocabulary import MoveAxisOrder
from mountnav.clock import sky_s
from mountnav.devices import MountAxis
from mountnav.errors import MountnavError
from mountnav.mount import CheckedMount
from mountnav.navigation.navigator import Navigator
from mountnav.tasks import first_of, waited_for

__all__ = ["HeldAxes", "HeldWork"]

_LOOK_S = 0.2
"""How often it is looked whether the mount has ended the motion by itself, s. Doubled, the job of an axis
that came to a limit ends so much later."""
_END_S = 1.0
"""Given with the speed 0, where no time counts."""
_MOST_KEYS = 256
"""Idempotency keys of prolonging orders that are remembered for a telescope; a pad of keys makes three a
second. Doubled, an order that was lost on the way for three minutes is known, and not carried out, too."""
SILENT = "no further order came in time"
"""Why an axis ended whose holder has fallen silent."""
RELEASED = "told to end"
BY_THE_MOUNT = "the mount ended it: a limit, or a stop"


@dataclass(slots=True)
class _Axis:
    """What is wanted of one axis, and what was sent."""

    rate_deg_s: float
    until_s: float
    fresh: bool = True
    sent_deg_s: float = 0.0
    last_deg_s: float = 0.0
    since_s: float | None = None
    taken: asyncio.Event = field(default_factory=asyncio.Event)


@dataclass(slots=True)
class _Hold:
    """One job that holds axes; `_Axis.taken`: the mount has taken what was wanted last.

    Attributes
    ----------
    taking : bool
        Whether a further order still counts; false from when it has begun to end.
    """

    caller: Caller
    axes: dict[MountAxis, _Axis] = field(default_factory=dict)
    ended: dict[MountAxis, AxisMovedView] = field(default_factory=dict)
    news: asyncio.Event = field(default_factory=asyncio.Event)
    taking: bool = True
    job: Job | None = None


def _is_of(caller: Caller, hold: _Hold) -> bool:
    """Whether it is the same program, as far as it can be known."""
    held = hold.caller
    return (caller.name, caller.face, caller.lease_id) == (held.name, held.face, held.lease_id)


class HeldAxes:
    """Moves the axes of one telescope. Used from the event loop's thread alone."""

    def __init__(self) -> None:
        self._hold: _Hold | None = None
        self._keys: OrderedDict[str, Job] = OrderedDict()

    # -- what the dispatcher asks --------------------------------------------------------------------

    def known(self, key: str | None) -> Job | None:
        """The job that an order of this key was taken into: the same order comes again, and moves nothing."""
        return None if key is None else self._keys.get(key)

    def prolonged(self, caller: Caller, order: MoveAxisOrder, key: str | None) -> tuple[Job, bool] | None:
        """Take a further order into the job that runs.

        Returns
        -------
        tuple of Job and bool, or None
            The job, and whether a speed was changed by it. None: no job of this caller runs.
        """
        hold = self._hold
        if hold is None or hold.job is None or not hold.taking or hold.job.is_over:
            return None
        if not _is_of(caller, hold) or hold.job.phase == "cancelling":
            return None
        if key is not None:
            self._keys[key] = hold.job
            while len(self._keys) > _MOST_KEYS:
                self._keys.popitem(last=False)
        before = hold.axes.get(order.axis)
        changed = (0.0 if before is None else before.rate_deg_s) != order.rate_deg_s
        self._want(hold, order)
        return hold.job, changed

    def begin(self, caller: Caller, order: MoveAxisOrder) -> HeldWork:
        """Work for a new job; `HeldWork.is_of` tells it which that is."""
        hold = _Hold(caller)
        self._want(hold, order)
        return HeldWork(self, hold)

    async def taken(self, job: Job, axis: MountAxis) -> None:
        """Wait until the mount has taken what was ordered last of an axis, or the job has ended."""
        hold = self._hold
        wanted = None if hold is None or hold.job is not job else hold.axes.get(axis)
        await first_of(job.ended.wait(), *([] if wanted is None else [wanted.taken.wait()]))

    def rates(self) -> dict[MountAxis, tuple[float, float]]:
        """Which axes are held just now: how fast, °/s, and for how many seconds more."""
        hold = self._hold
        if hold is None or (hold.job is not None and hold.job.is_over):
            return {}
        now_s = asyncio.get_running_loop().time()
        return {
            axis: (one.rate_deg_s, max(0.0, one.until_s - now_s))
            for axis, one in hold.axes.items()
            if one.rate_deg_s != 0.0
        }

    # -- inside --------------------------------------------------------------------------------------

    @staticmethod
    def _want(hold: _Hold, order: MoveAxisOrder) -> None:
        until_s = asyncio.get_running_loop().time() + order.for_s
        axis = hold.axes.get(order.axis)
        if axis is None:
            hold.axes[order.axis] = _Axis(order.rate_deg_s, until_s)
        else:
            axis.rate_deg_s, axis.until_s, axis.fresh = order.rate_deg_s, until_s, True
            axis.taken.clear()
        hold.news.set()

    async def _run(self, hold: _Hold, navigator: Navigator) -> AxesMovedView:
        mount, loop = navigator.mount, asyncio.get_running_loop()
        self._hold = hold
        try:
            while hold.axes:
                hold.news.clear()
                for name, axis in list(hold.axes.items()):
                    await self._step(mount, hold, name, axis)
                if not hold.axes:
                    break
                ends_s = min(loop.time() + _LOOK_S, *(axis.until_s for axis in hold.axes.values()))
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout_at(ends_s):
                        await hold.news.wait()
            hold.taking = False
            return AxesMovedView(axes=list(hold.ended.values()))
        finally:
            hold.taking = False
            moving = [name for name, axis in hold.axes.items() if axis.sent_deg_s != 0.0]
            if moving:
                # cancelled, or refused on the way: nothing goes on that nobody holds. A stop sends its own
                await asyncio.wait({waited_for(self._end_all(mount, moving))})
            if self._hold is hold:
                self._hold = None

    async def _step(self, mount: CheckedMount, hold: _Hold, name: MountAxis, axis: _Axis) -> None:
        """Do what is due for one axis: begin, prolong, or end it."""
        now_s = asyncio.get_running_loop().time()
        left_s = axis.until_s - now_s
        if axis.rate_deg_s == 0.0 or left_s <= 0.0:
            moved = axis.sent_deg_s != 0.0
            axis.sent_deg_s = 0.0
            if moved or axis.rate_deg_s == 0.0:
                await mount.move_axis(name, 0.0, for_s=_END_S)
            self._ended(hold, name, axis, RELEASED if axis.rate_deg_s == 0.0 else SILENT)
        elif axis.sent_deg_s != 0.0 and not mount.axis_moving:
            # what was stopped doesn't begin again by itself, no matter who still holds the key
            hold.taking = False
            self._ended(hold, name, axis, BY_THE_MOUNT)
        elif axis.fresh:
            axis.fresh = False
            axis.sent_deg_s = axis.last_deg_s = axis.rate_deg_s
            axis.since_s = now_s if axis.since_s is None else axis.since_s
            await mount.move_axis(name, axis.rate_deg_s, for_s=sky_s(left_s))
            if not axis.fresh:
                axis.taken.set()

    @staticmethod
    def _ended(hold: _Hold, name: MountAxis, axis: _Axis, why: str) -> None:
        now_s = asyncio.get_running_loop().time()
        before = hold.ended.get(name)
        moved_s = 0.0 if axis.since_s is None else now_s - axis.since_s
        moved_s += 0.0 if before is None else before.moved_s or 0.0
        hold.ended[name] = AxisMovedView(
            axis=name, rate_deg_s=axis.last_deg_s, moved_s=round(moved_s, 3), why=why
        )
        hold.axes.pop(name, None)
        axis.taken.set()

    @staticmethod
    async def _end_all(mount: CheckedMount, axes: list[MountAxis]) -> None:
        for axis in axes:
            with contextlib.suppress(MountnavError):
                # else it ends by itself soon, and what is wrong with its link is told by that
                await mount.move_axis(axis, 0.0, for_s=_END_S)


class HeldWork:
    """What a job does that holds axes."""

    def __init__(self, held: HeldAxes, hold: _Hold) -> None:
        self._held = held
        self._hold = hold

    def is_of(self, job: Job) -> None:
        """The job that does it: further orders go into it from now on."""
        self._hold.job = job
        self._held._hold = self._hold

    async def __call__(self, navigator: Navigator) -> AxesMovedView:
        """Move until all axes have ended. Raises as `CheckedMount.move_axis`."""
        return await self._held._run(self._hold, navigator)
