"""What lives as long as the service does: events, jobs, the observatory; and how it all comes to rest."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

from fastapi import Depends, Request

from api.access.audit import Audit
from api.access.keys import KeyStore
from api.access.security import TheCaller, require_telescope
from api.events import Events
from api.leases.leases import Leases
from api.listeners.listeners import Listeners
from api.metrics import Metrics, Observed
from api.nights.morning import MorningPosts
from api.nights.nights import Nights, nights_of
from api.observatory.observatory import Observatory, Telescope, build_observatory
from api.orders.dispatcher import Dispatcher, preempt
from api.orders.job_views import result_view
from api.orders.jobs import Job, Jobs
from api.orders.longer_orders import LongerOrders
from api.orders.restore import RestoredState
from api.solver.limits import Limits
from api.solver.solve_settings import solve_settings
from api.solver.solver import Solver
from api.traces import Traces, provider_of
from mountnav.catalog.stars import Catalog
from mountnav.errors import DeviceError, MountnavError
from mountnav.journal.audit_chain import open_audit_key
from mountnav.journal.job_store import JobStore
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.settings.observatory import Settings
from mountnav.settings.secrets import masked_settings
from mountnav.solving.settings import SolveSettings

_log = logging.getLogger(__name__)

_FIRST_READINGS_S = 5.0
"""Longest wait for the first readings of all telescopes at the start, s; chosen by hand. Doubled, a service
with a silent mount begins 5 s later; halved, slow mounts are unknown to the first request."""


@dataclass(slots=True)
class Service:
    """The running service, as the routes see it."""

    settings: Settings
    catalog: Catalog
    events: Events
    jobs: Jobs
    observatory: Observatory
    solver: Solver
    journal: SqlJournal
    nights: Nights
    dispatcher: Dispatcher
    leases: Leases
    audit: Audit
    metrics: Metrics
    restored: RestoredState
    listeners: Listeners = field(default_factory=lambda: Listeners({}))
    keys: KeyStore | None = None
    mornings: MorningPosts | None = None
    longer: LongerOrders | None = None
    job_store: JobStore | None = None
    traces: Traces | None = None
    _halted: bool = False

    def solve_settings(self, telescope_id: str | None) -> SolveSettings:
        """The settings of solving, with the masters of a telescope if one is named. Raises `NotFound`."""
        if telescope_id is None:
            return solve_settings(self.settings.solving)
        return self.observatory.telescope(telescope_id).navigator.solving

    async def halt(self) -> None:
        """Cancel all jobs, stop and release all telescopes, end solver and event streams. Twice is fine."""
        if self._halted:
            return
        self._halted = True
        await self.restored.close()
        await self.listeners.stop()
        if self.mornings is not None:
            await self.mornings.close()
        # a night's correction ends before the mount is let go, and all of it is written down
        await self.nights.close()
        await self.leases.close()
        await self.metrics.close()
        await self.dispatcher.close()
        await self.jobs.close()
        if self.traces is not None:
            await self.traces.close()
        await self.observatory.close()
        await self.solver.close()
        await asyncio.to_thread(self.journal.close)
        await asyncio.to_thread(_tell_audit, self.journal, "ends")
        self.events.close()


async def open_service(settings: Settings, catalog: Catalog) -> Service:
    """Build the service and open its telescopes; the solver gets warm meanwhile, and nobody waits for it.

    Raises
    ------
    BadSettings, JournalDamaged
        The journal is of another kind or damaged, another service on it has one of the telescopes, or a
        pointing model can't be read: then nothing is started.
        One that can't be opened or written now is no reason: see `RestoredState`.
    """
    await asyncio.to_thread(settings.ephemerides.use)
    # before anything is opened: what it needs may be missing
    provider = provider_of(settings.traces)
    ids = frozenset(telescope.id for telescope in settings.telescope)
    journal = await asyncio.to_thread(
        open_journal,
        settings.journal.where,
        settings_text=json.dumps(masked_settings(settings), indent=1),
        fsync=settings.journal.fsync,
        keep_days=settings.journal.keep_days,
        looks_keep_days=settings.journal.looks_keep_days,
        audit_keep_days=settings.journal.audit_keep_days,
        max_size_mb=settings.journal.max_size_mb,
        # a mount that slews from before must be stopped all the same
        patient=True,
        audit_key=await asyncio.to_thread(open_audit_key, settings.journal.audit_key_path),
        telescopes=ids,
    )
    events = Events(settings.service.events_kept)
    job_store = JobStore(journal, journal.reader, ids)
    jobs = Jobs(events, settings.service.jobs_kept, store=job_store, view=_as_json)

    def tell(kind: str, data: dict[str, object]) -> None:
        events.publish(kind, data)

    early = settings.solving.worker and settings.solving.blind != "never"
    solver = Solver(
        catalog,
        worker=settings.solving.worker,
        tell=tell,
        build_early=early,
        limits=Limits(settings.solving.memory_mb),
        uploads_wait=settings.nova.enabled,
        engine=settings.solver,
    )
    restored = RestoredState(journal, tell)
    try:
        observatory = build_observatory(settings, catalog, jobs.heard, solver.of, journal)
    except BaseException:
        await asyncio.to_thread(journal.close)
        raise
    # keys and what was running are known before any order is taken
    await restored.first(jobs.take_up)
    solver.open()
    await observatory.open()
    audit = Audit(journal)
    leases = Leases(journal, events.publish, audit)
    longer = LongerOrders(settings, observatory, solver, jobs.heard)
    dispatcher = Dispatcher(
        observatory,
        jobs,
        longer=longer,
        leases=leases,
        audit=audit,
        poll_s=settings.service.state_poll_s,
        tell=events.publish,
        unwritable=lambda: restored.problem,
    )
    dispatcher.start()
    nights = nights_of(
        settings, observatory, catalog, jobs.heard, journal, make_way=partial(preempt, dispatcher, jobs)
    )
    await restored.first(nights.start)
    # the first who asks is to be told where the telescopes point, and not that nobody knows yet
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_FIRST_READINGS_S):
            await asyncio.gather(
                *(dispatcher.watch(telescope.id).next(0) for telescope in dispatcher.telescopes)
            )

    async def open_leases() -> None:
        leases.open(dispatcher, await asyncio.to_thread(journal.reader.leases, ids))

    async def take_up(one: Telescope) -> None:
        if one.is_open and not one.is_taken_up:
            with contextlib.suppress(DeviceError):
                await one.ready()

    await restored.first(open_leases)
    for one in observatory.telescopes:
        await restored.besides(partial(take_up, one))
    restored.start()
    await asyncio.to_thread(_tell_audit, journal, "begins")
    metrics = Metrics(Observed(dispatcher, jobs, events, leases, journal))
    metrics.start()
    traces = None if provider is None else Traces(events, provider)
    if traces is not None:
        traces.start()
    mornings = MorningPosts(settings, journal, events.publish)
    mornings.start()
    return Service(
        settings,
        catalog,
        events,
        jobs,
        observatory,
        solver,
        journal,
        nights,
        dispatcher,
        leases,
        audit,
        metrics,
        restored,
        mornings=mornings,
        longer=longer,
        job_store=job_store,
        traces=traces,
    )


def _tell_audit(journal: SqlJournal, what: str) -> None:
    """Say in the log where the audit stands: kept elsewhere, it shows that nothing was cut off later."""
    try:
        head = journal.reader.audit_head()
    except MountnavError as unreadable:
        _log.info("the service %s; the audit can't be read: %s", what, unreadable)
    else:
        _log.info("the service %s; the audit stands at %s", what, head or "0")


def _as_json(report: object, job: Job) -> dict[str, object] | None:
    """What a job brought, as it is kept for after a restart."""
    view = result_view(report, epoch=job.epoch, utc=job.finished_utc)
    return None if view is None else view.model_dump(mode="json")


# Coroutines, though they wait for nothing: others are called in threads, and a request waits for one.


async def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


async def _telescope(telescope_id: str, request: Request) -> Telescope:
    return (await _service(request)).observatory.telescope(telescope_id)


async def _job(job_id: str, request: Request, caller: TheCaller) -> Job:
    jobs = (await _service(request)).jobs
    # one that isn't remembered is asked of the journal's file, which may take a while
    found = jobs.remembered(job_id)
    job = found if found is not None else await asyncio.to_thread(jobs.get, job_id)
    require_telescope(caller, job.telescope)
    return job


TheService = Annotated[Service, Depends(_service)]
TheTelescope = Annotated[Telescope, Depends(_telescope)]
TheJob = Annotated[Job, Depends(_job)]
