"""What lives as long as the service does: events, jobs, the observatory; and how it all comes to rest."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from api.events import Events
from api.jobs import Job, Jobs
from api.observatory import Observatory, Telescope, build_observatory, link_is_lost
from api.solver import Solver
from api.solving import solve_settings
from mountnav.catalog.stars import Catalog
from mountnav.errors import DeviceError
from mountnav.navigation.navigator import Navigator
from mountnav.settings import Settings
from mountnav.solve_settings import SolveSettings

_END_OF_JOB_S = 1.0


@dataclass(slots=True)
class Service:
    """The running service, as the routes see it."""

    settings: Settings
    catalog: Catalog
    events: Events
    jobs: Jobs
    observatory: Observatory
    solver: Solver
    _halted: bool = False

    def solve_settings(self, telescope_id: str | None) -> SolveSettings:
        """The settings of solving, with the masters of a telescope if one is named. Raises `Unknown`."""
        if telescope_id is None:
            return solve_settings(self.settings.solving)
        return self.observatory.telescope(telescope_id).navigator.solving

    def start(
        self,
        kind: str,
        telescope: Telescope,
        request: dict[str, object],
        order: Callable[[Navigator], Awaitable[object]],
        *,
        key: str | None,
    ) -> Job:
        """Start a job that opens the telescope if need be and gives its navigator an order."""

        async def work() -> object:
            try:
                return await order(await telescope.ready())
            except DeviceError as error:
                if link_is_lost(error):
                    await telescope.lost(error)
                raise

        return self.jobs.start(kind, telescope.id, request, work, key=key)

    async def stop(self, telescope: Telescope) -> Job | None:
        """Cancel the telescope's job and stop its mount; return the job. Waits for neither queue nor solve.

        The job is cancelled first, so that it can't send another slew after the stop; while it ends, the
        navigator stops the mount once more, in case a slew was on the wire at that very moment.

        Raises
        ------
        DeviceError
            The stop could not be sent.
        """
        job = self.jobs.running_on(telescope.id)
        if job is not None:
            self.jobs.cancel(job)
        try:
            await telescope.stop()
        except DeviceError as error:
            if link_is_lost(error):
                await telescope.lost(error)
            raise
        if job is not None:
            await _wait(job, _END_OF_JOB_S)
        return job

    async def cancel(self, job: Job) -> None:
        """Cancel a job and stop its mount; one that is over is left alone."""
        if job.is_over:
            return
        await self.stop(self.observatory.telescope(job.telescope))

    async def wait(self, job: Job, wait_s: float) -> None:
        """Wait for a job's end, but no longer than `wait_s`."""
        await _wait(job, wait_s)

    async def halt(self) -> None:
        """Cancel all jobs, stop and release all telescopes, end solver and event streams. Twice is fine."""
        if self._halted:
            return
        self._halted = True
        await self.jobs.close()
        await self.observatory.close()
        await self.solver.close()
        self.events.close()


async def open_service(settings: Settings, catalog: Catalog) -> Service:
    """Build the service and open its telescopes; the solver gets warm meanwhile, and nobody waits for it."""
    events = Events(settings.service.events_kept)
    jobs = Jobs(events, settings.service.jobs_kept)

    def tell(kind: str, data: dict[str, object]) -> None:
        events.publish(kind, data)

    early = settings.solving.worker and settings.solving.blind != "never"
    solver = Solver(catalog, worker=settings.solving.worker, tell=tell, build_early=early)
    observatory = build_observatory(settings, catalog, jobs.heard, solver)
    solver.open()
    await observatory.open()
    return Service(settings, catalog, events, jobs, observatory, solver)


async def _wait(job: Job, wait_s: float) -> None:
    if wait_s <= 0 or job.is_over:
        return
    try:
        await asyncio.wait_for(job.ended.wait(), wait_s)
    except TimeoutError:
        return


def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


def _telescope(telescope_id: str, request: Request) -> Telescope:
    return _service(request).observatory.telescope(telescope_id)


def _job(job_id: str, request: Request) -> Job:
    return _service(request).jobs.get(job_id)


TheService = Annotated[Service, Depends(_service)]
TheTelescope = Annotated[Telescope, Depends(_telescope)]
TheJob = Annotated[Job, Depends(_job)]
