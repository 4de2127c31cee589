"""The one way to order something of a telescope, for every face: role, lease, one at a time, written down.

REST, Alpaca, INDI, the planetariums and the page all come here; none has another way to a navigator.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from api.access.audit import Audit
from api.access.callers import Caller, Face, Role
from api.access.security import require_role, require_telescope
from api.observatory.observatory import Observatory, Telescope, link_is_lost
from api.orders.execute_order import goal, work_of
from api.orders.held_axes import HeldAxes
from api.orders.jobs import Job, Jobs
from api.orders.longer_orders import LongerOrders
from api.orders.targets import Target, require_filter, require_place
from api.orders.vocabulary import (
    DitherOrder,
    LongerOrder,
    MoveAxisOrder,
    OffsetRatesOrder,
    Order,
    role_for,
)
from api.orders.watching import Watch
from api.problems import Refused
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, Cancelled, DeviceError, JournalFailed, MountnavError, OutsideLimits
from mountnav.mount.order_book import EVEN_UNWRITTEN
from mountnav.navigation.navigator import Navigator
from mountnav.tasks import waited_for

__all__ = ["STOP_KNOWN_S", "Dispatcher", "Guard", "StopGiven"]


_log = logging.getLogger(__name__)

_END_OF_JOB_S = 1.0
"""How long a stop waits for the end of the job that it cancelled, s; chosen by hand, below `STOP_KNOWN_S`.
Doubled, the answer comes before it is known that the stop was sent."""
_LONGEST_FRESHENING_S = 5.0
"""How long the end of a job waits for a reading made after its work, s; chosen by hand. Doubled, jobs of a
mount that fell silent end 5 s later."""
_HELD_S = 2.0
"""Seconds from its beginning for which a stop holds orders back that haven't begun; by then it is answered.
Doubled, a mount that never answers its stop delays the guide pulses of all others for twice as long."""
STOP_KNOWN_S = 1.4
"""So long a stop's answer waits for what came of it: it is to be there within 2 s, whatever a mount does."""


@dataclass(frozen=True, slots=True)
class StopGiven:
    """A stop that was given, and what is known of it by now.

    Attributes
    ----------
    job : Job or None
        The one that it cancelled.
    sent : bool or None
        Whether the mount was told; None: not known yet, the event ``stop-settled`` will tell.
    error : DeviceError or None
        Why not.
    """

    job: Job | None
    sent: bool | None
    error: DeviceError | None = None


class Guard(Protocol):
    """Who may order now."""

    def require(self, caller: Caller, telescope_id: str) -> None:
        """Raise `Refused` if somebody else holds the lease."""
        ...


class Dispatcher:
    """Takes the orders of all faces.

    Parameters
    ----------
    longer : LongerOrders
        Makes work of the orders that need more than a navigator.
    poll_s : float
        How often each telescope is read.
    tell : callable
        Publishes an event.
    unwritable : callable
        Why nothing can be written down just now; None when it can.
    """

    def __init__(
        self,
        observatory: Observatory,
        jobs: Jobs,
        *,
        longer: LongerOrders,
        leases: Guard,
        audit: Audit,
        poll_s: float,
        tell: Callable[[str, dict[str, object]], object],
        unwritable: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._observatory = observatory
        self._jobs = jobs
        self._longer = longer
        self._leases = leases
        self._audit = audit
        self._tell = tell
        self._unwritable = unwritable
        self._stopping: set[asyncio.Task[Job | None]] = set()
        self._beginning = asyncio.Lock()
        self._stops, self._stop_begun_s = 0, 0.0
        self._stops_given = {telescope.id: 0 for telescope in observatory.telescopes}
        self._calm = asyncio.Event()
        self._calm.set()
        self._held = {telescope.id: HeldAxes() for telescope in observatory.telescopes}
        self._poll_s = poll_s
        self._watches = {telescope.id: Watch(telescope, jobs, poll_s) for telescope in observatory.telescopes}

    @property
    def telescopes(self) -> Sequence[Telescope]:
        """All telescopes, in the order of the settings."""
        return self._observatory.telescopes

    def telescope(self, telescope_id: str) -> Telescope:
        """One of them. Raises `NotFound`."""
        return self._observatory.telescope(telescope_id)

    def watch(self, telescope_id: str) -> Watch:
        """What is known of a telescope. Raises `NotFound`."""
        return self._watches[self._observatory.telescope(telescope_id).id]

    def take_in(self, telescopes: Sequence[Telescope]) -> list[Watch]:
        """Watch these from now on, each in the place of one of the same id; watches to close are returned.

        What was ordered of that one and hasn't begun is held for overtaken, as by a stop.
        """
        old = []
        for one in telescopes:
            self._stops_given[one.id] = self._stops_given.get(one.id, 0) + 1
            self._held[one.id] = HeldAxes()
            before = self._watches.get(one.id)
            first = 0
            if before is not None:
                first = before.latest.revision + 1
                old.append(before)
            self._watches[one.id] = Watch(one, self._jobs, self._poll_s, first_revision=first)
            self._watches[one.id].start()
        return old

    def let_go(self, telescope_id: str) -> Watch:
        """The watch of a telescope that was taken out, to be closed; what was ordered of it is overtaken."""
        self._stops_given[telescope_id] += 1
        return self._watches[telescope_id]

    def start(self) -> None:
        """Begin to watch."""
        for watch in self._watches.values():
            watch.start()

    async def close(self) -> None:
        """Watch no more. A stop that is still being sent is given up: the telescopes are stopped next."""
        for stopping in self._stopping:
            stopping.cancel()
        await asyncio.gather(*self._stopping, return_exceptions=True)
        await asyncio.gather(*(watch.close() for watch in self._watches.values()))

    async def turn(self) -> None:
        """Wait for a turn of the loop in which no other order begins, and that no stop needs.

        For faces whose clients may send many orders at once: to refuse a goto takes up to 20 ms, and a stop
        needs some fifty turns. HTTP requests have it from `FairRequests`.
        """
        async with self._beginning:
            with contextlib.suppress(TimeoutError):
                # as long as that is in the future; later the stop has had its time
                async with asyncio.timeout_at(self._stop_begun_s + _HELD_S):
                    await self._calm.wait()
            await asyncio.sleep(0)

    async def order(
        self,
        caller: Caller,
        telescope_id: str,
        order: Order,
        *,
        key: str | None = None,
        supersede: bool = False,
        stops_given: int | None = None,
    ) -> Job:
        """Take an order; its job has begun, and is on the disk, when this returns. See `give`."""
        if stops_given is None:
            stops_given = self.stops_given(telescope_id)
        if isinstance(order, MoveAxisOrder):
            return await self._move_axis(
                caller, telescope_id, order, key=key, supersede=supersede, stops_given=stops_given
            )
        devices = True
        request = order.model_dump(exclude_none=True)
        if (target := getattr(order, "target", None)) is not None:
            navigator = self._observatory.telescope(telescope_id).navigator
            try:
                require_filter(target, solar_filter=navigator.limits.solar_filter)
                # an orbit may take a while to be integrated
                await asyncio.to_thread(
                    require_place, target, utc_now(), navigator.mount.site, navigator.mount.air
                )
            except (OutsideLimits, BadRequest) as refusal:
                self._audit.refused(caller, order.kind, refusal, telescope=telescope_id, request=request)
                raise
        if isinstance(order, LongerOrder):
            work = self._longer.work_of(self._observatory.telescope(telescope_id).id, order)
            devices = self._longer.needs_devices(order)
        else:
            work = work_of(order)
        return await self.give(
            caller,
            telescope_id,
            order.kind,
            request,
            work,
            key=key,
            supersede=supersede,
            needs=role_for(order),
            devices=devices,
            within="hold" if isinstance(order, DitherOrder) and self._holds(telescope_id) else None,
            stops_given=stops_given,
        )

    async def give(
        self,
        caller: Caller,
        telescope_id: str,
        kind: str,
        request: dict[str, object],
        work: Callable[[Navigator], Awaitable[object]],
        *,
        key: str | None = None,
        supersede: bool = False,
        needs: Role = Role.OPERATE,
        devices: bool = True,
        began: Callable[[Job], object] | None = None,
        within: str | None = None,
        stops_given: int | None = None,
    ) -> Job:
        """Take a piece of work as an order; `order` for those that have a body of their own.

        Parameters
        ----------
        kind : str
            Of the job.
        request : dict
            As it is written down; together with `kind` what an idempotency key stands for.
        work : callable
            What the navigator is to do.
        key : str, optional
            Made by the client: with the same key and request nothing is done twice.
        supersede : bool
            Whether a job that holds the telescope is ended, and its mount stopped, to make room. The new job
            is there at once and begins when that is done; if the mount can't be told to stop, it fails.
        devices : bool
            Whether the telescope must be open for it.
        began : callable, optional
            Told of the job before it does anything.
        within : str, optional
            Kind of job that it may be done within: then that one goes on, and holds the telescope.
        stops_given : int, optional
            How many stops had been given when this order came, as `stops_given` told; left out: it comes now.

        Raises
        ------
        NotFound
            No such telescope.
        Refused
            The caller's role, or somebody else's lease; or the key was used for something else.
        TelescopeBusy
            Another job holds it.
        JournalFailed
            It can't be written down, and is no park: nothing was begun.
        Cancelled
            A stop was given after it came: what was on its way before a stop never begins after it.
        """
        safe = kind in EVEN_UNWRITTEN
        telescope = self._observatory.telescope(telescope_id)
        try:
            require_role(caller, needs)
            require_telescope(caller, telescope.id)
            known = self._jobs.known(key, kind, telescope.id, request)
            if known is not None:
                await known.written.wait()
                return known
            if not safe and (why := self._unwritable()) is not None:
                raise JournalFailed(
                    why,
                    device=telescope.id,
                    advice="mountnav tries again by itself; stops and parks are taken",
                )
            self._leases.require(caller, telescope.id)
            self._require_unstopped(telescope.id, stops_given)
            job = self._jobs.start(
                kind,
                telescope.id,
                request,
                self.done(telescope, work, devices=devices, even_unwritten=safe),
                key=key,
                make_room=(lambda: self._stop(telescope, None)) if supersede else None,
                epoch=telescope.navigator.mount.epoch,
                even_unwritten=safe,
                within=within,
            )
            if began is not None:
                began(job)
            # first on the disk, then answered: after a kill the same request finds it
            await job.written.wait()
            if job.unwritten is not None:
                raise job.unwritten
        except (Refused, MountnavError) as refusal:
            self._audit.refused(caller, kind, refusal, telescope=telescope.id, request=request)
            raise
        self._audit.note(caller, kind, telescope=telescope.id, request=request, job_id=job.id)
        return job

    def stops_given(self, telescope_id: str) -> int:
        """How many stops were given to a telescope so far; for faces that look before they order.

        Raises
        ------
        NotFound
        """
        return self._stops_given[self._observatory.telescope(telescope_id).id]

    def all_stops_given(self) -> Mapping[str, int]:
        """The same of each telescope, as it is now."""
        return dict(self._stops_given)

    def held(self, telescope_id: str) -> HeldAxes:
        """The axes that somebody moves by hand. Raises `NotFound`."""
        return self._held[self._observatory.telescope(telescope_id).id]

    async def _move_axis(
        self,
        caller: Caller,
        telescope_id: str,
        order: MoveAxisOrder,
        *,
        key: str | None,
        supersede: bool,
        stops_given: int,
    ) -> Job:
        """Move an axis on, or go on moving it: a further order of the same caller goes into the same job.

        Role and lease are asked for each of them. That one was taken is noted once for each change of speed:
        a key that is held sends three a second.
        """
        held = self.held(telescope_id)
        if (known := held.known(key)) is not None:
            return known
        request: dict[str, object] = order.model_dump(exclude_none=True)
        try:
            require_role(caller, role_for(order))
            require_telescope(caller, telescope_id)
            self._leases.require(caller, telescope_id)
            if order.job_id is not None and (over := self._ended_motion(telescope_id, order)) is not None:
                return over
            if order.rate_deg_s != 0.0:  # an end is taken at any time
                self._require_unstopped(telescope_id, stops_given)
        except (Refused, MountnavError) as refusal:
            self._audit.refused(caller, order.kind, refusal, telescope=telescope_id, request=request)
            raise
        if (into := held.prolonged(caller, order, key)) is not None:
            job, changed = into
            if changed:
                self._audit.note(caller, order.kind, telescope=telescope_id, request=request, job_id=job.id)
            return job
        work = held.begin(caller, order)
        return await self.give(
            caller,
            telescope_id,
            order.kind,
            request,
            work,
            key=key,
            supersede=supersede,
            needs=role_for(order),
            began=work.is_of,
        )

    def _require_unstopped(self, telescope_id: str, stops_given: int | None) -> None:
        if stops_given is not None and stops_given != self._stops_given[telescope_id]:
            raise Cancelled("a stop came first", device=telescope_id, advice="send it again when it is safe")

    def _ended_motion(self, telescope_id: str, order: MoveAxisOrder) -> Job | None:
        """The job that an order is for, if it has ended and is only told to end; None while it goes on.

        Raises
        ------
        BadRequest
            It has ended: an order that comes late moves nothing.
        """
        job = self._jobs.remembered(order.job_id or "")
        if job is not None and job is self._jobs.running_on(telescope_id):
            return None
        if job is not None and order.rate_deg_s == 0.0:
            return job
        raise BadRequest(
            "that motion has ended", device=telescope_id, advice="begin a new one: order it without job_id"
        )

    async def end_rates(self, caller: Caller, telescope_id: str) -> None:
        """End rates that were ordered beside the sidereal one, if no job goes on that has its own.

        Raises
        ------
        MountnavError, Refused
            As `order`.
        """
        telescope = self._observatory.telescope(telescope_id)
        mount = telescope.navigator.mount
        if mount.offset_rates_in_force is not None and self._jobs.running_on(telescope.id) is None:
            job = await self.order(caller, telescope.id, OffsetRatesOrder(ra_arcsec_s=0.0, dec_arcsec_s=0.0))
            await job.ended.wait()

    async def check(self, telescope_id: str, target: Target, *, supersede: bool = False) -> None:
        """Tell what a slew there would be refused for now; nothing moves.

        Parameters
        ----------
        supersede : bool
            As if what runs now had been stopped for it.

        Raises
        ------
        OutsideLimits, DeviceRefused, Busy, BadRequest, Unknown, DeviceError
        """
        telescope = self._observatory.telescope(telescope_id)
        navigator = await telescope.ready()
        await navigator.would_slew(goal(navigator, target), after_stop=supersede)

    async def stop(self, caller: Caller, telescope_id: str) -> Job | None:
        """Cancel the telescope's job and stop its mount; return the job. Waits for neither queue nor solve.

        Taken from everyone who may operate, also past a lease. The job is cancelled first, so that
        it can't send another slew after the stop; while it ends, the navigator stops the mount once more, in
        case a slew was on the wire at that very moment.

        Raises
        ------
        Refused
            The caller may only look on.
        DeviceError
            The stop could not be sent.
        """
        telescope = self._observatory.telescope(telescope_id)
        job = self._jobs.running_on(telescope.id)
        try:
            require_role(caller, Role.OPERATE)
            require_telescope(caller, telescope.id)
            self._stops_given[telescope.id] += 1
            with self._others_held_back():
                await self._stop(telescope, job, f"stopped on request of {caller.name} ({caller.face})")
        except (Refused, DeviceError) as error:
            self._audit.refused(caller, "stop", error, telescope=telescope.id)
            raise
        self._audit.note(caller, "stop", telescope=telescope.id, job_id=None if job is None else job.id)
        return job

    async def give_stop(self, caller: Caller, telescope_id: str) -> StopGiven:
        """Stop as `stop` does, for those who wait for an answer: it is there within 2 s.

        A mount that takes longer is told to stop all the same; an event tells what came of it.

        Raises
        ------
        Refused
            The caller may only look on.
        """
        telescope = self._observatory.telescope(telescope_id)
        require_role(caller, Role.OPERATE)
        require_telescope(caller, telescope.id)
        job = self._jobs.running_on(telescope.id)
        begun_s = asyncio.get_running_loop().time()
        stopping = waited_for(self.stop(caller, telescope.id), name=f"stop {telescope.id}")
        self._stopping.add(stopping)
        stopping.add_done_callback(self._stopping.discard)
        await asyncio.wait({stopping}, timeout=STOP_KNOWN_S)
        if not stopping.done():
            stopping.add_done_callback(lambda ended: self._settled(telescope.id, ended, begun_s))
            return StopGiven(job, None)
        try:
            return StopGiven(stopping.result(), True)
        except DeviceError as error:
            return StopGiven(job, False, error)

    async def stop_all(self, caller: Caller) -> dict[str, StopGiven]:
        """Stop all telescopes that the caller's key is for at once, each as `give_stop` does."""
        require_role(caller, Role.OPERATE)
        reached = [telescope.id for telescope in self.telescopes if caller.reaches(telescope.id)]
        given = await asyncio.gather(*(self.give_stop(caller, one) for one in reached))
        return dict(zip(reached, given, strict=True))

    def next_panel(self, caller: Caller, job: Job) -> int:
        """Say that the camera is through with a frame of a mosaic; how many are wanted yet of its panel.

        Raises
        ------
        Refused
            The caller may only look on, or somebody else holds the telescope.
        BadRequest
            The job is no mosaic, has ended, or its panel isn't centered yet.
        """
        try:
            require_role(caller, Role.OPERATE)
            require_telescope(caller, job.telescope)
            self._leases.require(caller, job.telescope)
            if job.kind != "mosaic" or job.is_over:
                what = "is over" if job.is_over else f"is none, but {job.kind}"
                raise BadRequest(f"only a mosaic has a next panel; the job {what}", device=job.telescope)
            left = self._observatory.telescope(job.telescope).navigator.next_panel()
        except (Refused, MountnavError) as refusal:
            self._audit.refused(caller, "next", refusal, telescope=job.telescope)
            raise
        self._audit.note(caller, "next", telescope=job.telescope, job_id=job.id)
        return left

    async def cancel(self, caller: Caller, job: Job) -> None:
        """Cancel a job and stop its mount; one that is over is left alone. Raises as `stop`.

        The job's own end tells what came of a stop that takes long.
        """
        require_role(caller, Role.OPERATE)
        require_telescope(caller, job.telescope)
        if not job.is_over and self._jobs.running_on(job.telescope) is job:
            given = await self.give_stop(caller, job.telescope)
            if given.error is not None:
                raise given.error

    def done(
        self,
        telescope: Telescope,
        work: Callable[[Navigator], Awaitable[object]],
        *,
        devices: bool = True,
        even_unwritten: bool = False,
    ) -> Callable[[], Awaitable[object]]:
        """Work as a job does it: the telescope opened before, if need be, its state read again after."""
        watch = self._watches[telescope.id]

        async def done() -> object:
            try:
                report = await work(
                    await telescope.ready(even_unwritten=even_unwritten) if devices else telescope.navigator
                )
            except DeviceError as error:
                if link_is_lost(error):
                    await telescope.lost(error)
                watch.wake()
                raise
            except BaseException:
                watch.wake()
                raise
            # anyone who sees the job ended sees where the telescope stands since; a cancellation now comes
            # too late for the work, and what that brought must not be lost
            try:
                async with asyncio.timeout(_LONGEST_FRESHENING_S):
                    await watch.refresh()
            except (TimeoutError, asyncio.CancelledError):
                watch.wake()
            return report

        return done

    # -- inside --------------------------------------------------------------------------------------

    def _holds(self, telescope_id: str) -> bool:
        """Whether it holds a place by looks already, and takes dithers."""
        return self._observatory.telescope(telescope_id).navigator.holds

    @contextlib.contextmanager
    def _others_held_back(self) -> Iterator[None]:
        self._stops += 1
        self._stop_begun_s = asyncio.get_running_loop().time()
        self._calm.clear()
        try:
            yield
        finally:
            self._stops -= 1
            if not self._stops:
                self._calm.set()

    def _settled(self, telescope_id: str, stopping: asyncio.Task[Job | None], begun_s: float) -> None:
        if stopping.cancelled():
            return
        error = stopping.exception()
        told: dict[str, object] = {
            "telescope": telescope_id,
            "sent": error is None,
            "took_s": round(asyncio.get_running_loop().time() - begun_s, 1),
        }
        if error is not None:
            told["problem"] = str(error)
            _log.error("the stop of %s could not be sent: %s", telescope_id, error)
        self._tell("stop-settled", told)

    async def _stop(self, telescope: Telescope, job: Job | None, why: str = "") -> None:
        if job is not None:
            self._jobs.cancel(job, why)
        try:
            await telescope.stop()
        except DeviceError as error:
            if link_is_lost(error):
                await telescope.lost(error)
            raise
        finally:
            self._watches[telescope.id].wake()
        if job is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_END_OF_JOB_S):
                    await job.ended.wait()


NIGHT = Caller("night", Role.CONFIGURE, Face.SERVICE)
"""In whose name it is done."""


async def preempt(dispatcher: Dispatcher, jobs: Jobs, telescope_id: str) -> None:
    """End the job that runs on a telescope, unless it parks it already. Raises `DeviceError`."""
    job = jobs.running_on(telescope_id)
    if job is not None and job.kind != "park":
        await dispatcher.stop(NIGHT, telescope_id)
