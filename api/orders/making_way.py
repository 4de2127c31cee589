"""Whoever works with a telescope that must be parked now is stopped, as by everyone's stop."""

from __future__ import annotations

from api.access.callers import Caller, Face, Role
from api.orders.desk import Desk
from api.orders.jobs import Jobs

NIGHT = Caller("night", Role.CONFIGURE, Face.SERVICE)
"""In whose name it is done."""


async def make_way(desk: Desk, jobs: Jobs, telescope_id: str) -> None:
    """End the job that runs on a telescope, unless it parks it already. Raises `DeviceError`.

    Parameters
    ----------
    desk : Desk
    jobs : Jobs
    telescope_id : str
    """
    job = jobs.running_on(telescope_id)
    if job is not None and job.kind != "park":
        await desk.stop(NIGHT, telescope_id)
