"""One telescope as an INDI device: its properties as they are now, and the ends of what was ordered of it.

What is shown comes from its watch; orders are taken by `api.indi_server.orders`. An order is answered
when it was taken or refused, as by a driver that talks to its mount: short ones at their end.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Coroutine, Sequence
from datetime import timedelta

from api.access.callers import Caller
from api.indi_server.life import ClientLife
from api.indi_server.orders import Answer, IndiOrders
from api.indi_server.properties import (
    COORDINATES,
    MOTIONS,
    Facts,
    Optics,
    driver_info,
    running,
    time_vector,
    vectors_of,
)
from api.indi_server.vectors import Vector
from api.orders.goto_orders import GotoOrders, NotTaken, require_success
from api.orders.job import Job
from api.orders.kept_motions import KeptAxes, KeptRates
from api.problems import Problem
from api.service import Service
from drivers.indi.codec.messages import Ordered, State
from mountnav.clock import utc_now
from mountnav.devices import MountAxis, Skill
from mountnav.errors import MountnavError
from mountnav.settings.telescope import TelescopeSettings
from mountnav.tasks import Died, begun, fault_words

_TIME_TOLD_EVERY = timedelta(seconds=30)
"""How often TIME_UTC is sent again; clients let the clock run on in between. Halved, twice the messages."""
_FIRST_READING_S = 3.0
"""Longest wait for a telescope's first reading before its properties are defined, s. Doubled, a client of a
silent mount waits that long for a device; halved, slow mounts are defined without a position."""
ABORT = "TELESCOPE_ABORT_MOTION"


class IndiTelescope:
    """A telescope of the service as an INDI device.

    Parameters
    ----------
    name : str
        What clients call it.
    changed : callable
        Told whenever a property may have changed.
    say : callable
        ``say(device, answer)``: what all clients should know.
    died : callable
        Told of a fault in what it is told from: what clients see of it is not so any more.
    """

    def __init__(
        self,
        service: Service,
        settings: TelescopeSettings,
        name: str,
        *,
        changed: Callable[[], None],
        say: Callable[[IndiTelescope, Answer], None],
        died: Died,
    ) -> None:
        self.id = settings.id
        self.name = name
        self.was_connected = False
        """Whether its mount was ever reached: until then it has nothing to show."""
        self.revision = 0
        self.vectors: dict[str, Vector] = {}
        self._service = service
        self._telescope = service.observatory.telescope(settings.id)
        self._watch = service.dispatcher.watch(settings.id)
        self._ordering = GotoOrders(service.dispatcher, service.audit, settings.id)
        self._optics = optics_of(settings)
        self._changed, self._say, self._died = changed, say, died
        own = service.settings.indi_server
        self._axes = KeptAxes(service.dispatcher, settings.id, most_s=own.move_axis_s, ended=self._axis_ended)
        self._rates = KeptRates(service.dispatcher, settings.id, within_s=own.offset_rates_s)
        self._orders = IndiOrders(
            self._ordering,
            self._watch,
            self._telescope.navigator.mount,
            axes=self._axes,
            rates=self._rates,
            follow=self._follow,
        )
        self._clock_utc = utc_now()
        self._tasks: set[asyncio.Task[None]] = set()

    # -- what it shows -------------------------------------------------------------------------------

    @property
    def connected(self) -> bool:
        """Whether its mount can be read now."""
        return self._watch.latest.state.connected

    @property
    def problem(self) -> str | None:
        """What is known to be wrong."""
        return self._watch.latest.state.problem

    def driver_info(self) -> Vector:
        """DRIVER_INFO, there before anything is connected."""
        return driver_info(self._telescope.navigator.mount.skills)

    def time_now(self) -> Vector:
        """TIME_UTC of this moment, for who asks."""
        return time_vector(utc_now(), _offset_h())

    async def start(self) -> None:
        """Begin to follow the telescope; a mount that is there is known before the first client asks."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_FIRST_READING_S):
                await self._watch.refresh()
        self._renew()
        self._follow_on()

    def _follow_on(self) -> None:
        def died(fault: Exception) -> None:
            # shown is what was last seen, and isn't renewed: nobody may take it for what is
            self._died(fault)
            self._follow_on()

        self._begin(self._follow_watch(), died)

    async def close(self) -> None:
        """Follow it no more. Jobs go on, but for what keys move."""
        await self._axes.close()
        await self._rates.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _follow_watch(self) -> None:
        seen = self._watch.latest.revision
        while True:
            snapshot = await self._watch.next(seen)
            seen = snapshot.revision
            self._renew()
            self._changed()

    def _renew(self) -> None:
        """Make the properties from what is known now."""
        snapshot = self._watch.latest
        self.was_connected = self.was_connected or snapshot.state.connected
        utc = utc_now()
        if abs(utc - self._clock_utc) >= _TIME_TOLD_EVERY:
            self._clock_utc = utc
        job = running(snapshot, "tracking")
        if job is not None and job.request.get("on"):
            self._orders.rate = str(job.request.get("rate", "sidereal"))
        mount = self._telescope.navigator.mount
        force = mount.offset_rates_in_force
        held = self._service.dispatcher.held(self.id).rates()
        movable: frozenset[MountAxis] = frozenset()
        if Skill.MOVE_AXIS in mount.skills:
            movable = frozenset(axis for axis, spans in mount.axis_rates_deg_s.items() if spans)
        facts = Facts(
            snapshot=snapshot,
            skills=mount.skills,
            site=mount.site,
            clock_utc=self._clock_utc,
            offset_h=_offset_h(),
            poll_s=self._service.settings.service.state_poll_s,
            optics=self._optics,
            target=self._orders.target,
            rate=self._orders.rate,
            offsets=None if force is None else force.rates,
            most_offsets=mount.most_offset_arcsec_s,
            speed=self._orders.speed,
            moved={axis: rate_deg_s for axis, (rate_deg_s, _) in held.items()},
            can_move=movable,
        )
        made = vectors_of(facts)
        last = self.vectors.get(COORDINATES)
        if COORDINATES not in made and last is not None:
            # it can't be read: where it was last stays, and says Alert
            made = {COORDINATES: last.with_state(State.ALERT)} | made
        self.vectors = made
        self.revision += 1

    # -- what is ordered of it -----------------------------------------------------------------------

    async def connect(self) -> str | None:
        """Have the service try to reach the mount; why it can't, in words."""
        try:
            await self._telescope.ready()
            await self._watch.refresh()
        except MountnavError as error:
            return str(error)
        self._renew()
        return None

    def abort(self, caller: Caller, tell: Callable[[Answer], None]) -> None:
        """Stop all motion now, before everything that waits; `tell` is told how that went."""
        self._axes.forget()

        async def stop() -> None:
            try:
                await self._ordering.stop(caller)
            except NotTaken as refusal:
                tell(Answer.refused(ABORT, f"the stop could not be sent: {refusal}"))
            else:
                self._renew()
                tell(Answer(ABORT, State.OK, "[INFO] stopped"))
            self._changed()

        def died(fault: Exception) -> None:
            tell(Answer.refused(ABORT, f"whether the stop was sent is not known: {fault_words(fault)}"))

        self._begin(stop(), died)

    async def take(self, caller: Caller, ordered: Ordered, mode: str) -> Answer:
        """Carry out an order, or refuse it.

        Parameters
        ----------
        ordered : Ordered
            To one of its properties.
        mode : str
            What this client has chosen of ON_COORD_SET.
        """
        name = ordered.name
        shown = self.vectors.get(name)
        if shown is None:
            return Answer.refused(name, f"{self.name} has no {name}")
        if ordered.kind != shown.kind:
            return Answer.refused(name, f"{name} is no {ordered.kind}")
        try:
            answer = await self._orders.take(caller, ordered, shown, mode)
        except NotTaken as refusal:
            answer = Answer.refused(name, str(refusal))
        except (ValueError, TypeError) as error:
            answer = Answer.refused(name, str(error))
        self._renew()
        self._changed()
        return answer

    def came(self, caller: Caller, life: ClientLife) -> None:
        """A client is here: what it moves by keys goes on while it lives."""
        self._orders.here[caller.name] = life

    def gone(self, caller: Caller) -> None:
        """It has gone: what its keys move ends now, and the end of its rates is put off no more."""
        self._orders.here.pop(caller.name, None)

        async def end() -> None:
            await self._axes.end_all(of=lambda one: one.name == caller.name)
            self._renew()
            self._changed()

        if self._axes.is_of(caller):
            # if that dies, it ends by itself
            self._begin(end(), lambda _: None)

    def _axis_ended(self, axis: MountAxis, why: str, problem: Problem | None) -> None:
        """A key's motion has ended, and nobody released the key."""
        name = next(one for one, (moved, _) in MOTIONS.items() if moved == axis)
        self._renew()
        if problem is not None and not problem.type.endswith(":cancelled"):
            self._say(self, Answer.refused(name, why))
        else:
            self._say(self, Answer(name, State.IDLE, f"[WARNING] the motion has ended: {why}"))
        self._changed()

    # -- ends of jobs --------------------------------------------------------------------------------

    def _follow(self, job: Job, name: str) -> None:
        async def end() -> None:
            await job.ended.wait()
            if job.superseded_by is not None:
                return
            self._renew()
            try:
                require_success(job)
            except NotTaken as failure:
                stopped = failure.problem.type.endswith(":cancelled")
                told = Answer(name, None, f"[WARNING] {failure}") if stopped else None
                self._say(self, told or Answer.refused(name, str(failure)))
            self._changed()

        def died(fault: Exception) -> None:
            self._say(self, Answer.refused(name, f"how it ended is not known: {fault_words(fault)}"))

        self._begin(end(), died)

    def _begin(self, work: Coroutine[None, None, None], died: Died) -> None:
        task = begun(work, f"INDI device {self.name}", died=died)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def device_names(telescopes: Sequence[TelescopeSettings]) -> dict[str, str]:
    """What each telescope is called as a device, by its id: its name, and the id where two have one name."""
    wanted = {telescope.id: telescope.name or telescope.id for telescope in telescopes}
    often = Counter(wanted.values())
    # an order to a name that two have must not reach the one that wasn't meant
    return {
        telescope_id: name if often[name] == 1 else f"{name} ({telescope_id})"
        for telescope_id, name in wanted.items()
    }


def optics_of(settings: TelescopeSettings) -> Optics | None:
    """Focal length and aperture, where the settings say both."""
    if settings.focal_length_mm is None or settings.aperture_mm is None:
        return None
    return Optics(settings.focal_length_mm, settings.aperture_mm)


def _offset_h() -> float:
    offset = utc_now().astimezone().utcoffset()
    return 0.0 if offset is None else offset.total_seconds() / 3600.0


__all__ = ["ABORT", "IndiTelescope", "device_names", "optics_of"]
