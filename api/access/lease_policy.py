"""What is done, once, when the holder of a lease has fallen silent: through the desk, like any order."""

from __future__ import annotations

import asyncio
from typing import Protocol

from api.access.callers import Caller, Face, Role
from api.access.lease import Lease, OnExpiry
from api.orders.job import Job, JobState
from api.orders.orders import Order, ParkOrder
from mountnav.errors import DeviceError

STOP_AGAIN_S = 5.0
STOP_TRIES = 12
"""A stop that doesn't reach the mount is sent again, for a minute: the mount may be slewing."""


class Orders(Protocol):
    """The desk, as far as it is needed here."""

    async def stop(self, caller: Caller, telescope_id: str) -> Job | None:
        """Cancel the telescope's job and stop its mount."""
        ...

    async def order(
        self,
        caller: Caller,
        telescope_id: str,
        order: Order,
        *,
        key: str | None = None,
        supersede: bool = False,
    ) -> Job:
        """Start a job."""
        ...


def caller_for(lease: Lease) -> Caller:
    """In whose name it is done."""
    return Caller(f"lease of {lease.holder}", Role.CONFIGURE, Face.SERVICE)


async def act(lease: Lease, orders: Orders, *, again_s: float = STOP_AGAIN_S) -> Job | None:
    """Do what was agreed for the holder's silence.

    Returns
    -------
    Job or None
        The job that parks, under way.

    Raises
    ------
    MountnavError, Refused
        It could not be done: the stop reached nobody within a minute, or the order to park was refused.
    """
    if lease.on_expiry is OnExpiry.KEEP_TRACKING:
        return None
    caller = caller_for(lease)
    await _stopped(lease, orders, caller, again_s)
    if lease.on_expiry is OnExpiry.STOP:
        return None
    return await orders.order(caller, lease.telescope, ParkOrder(kind="park"), supersede=True)


async def end_of(job: Job) -> str:
    """Wait for the end of the job that parks; what went wrong, or nothing."""
    await job.ended.wait()
    if job.state is JobState.SUCCEEDED:
        return ""
    return f"parking ended {job.state}: {'' if job.problem is None else job.problem.detail}"


async def _stopped(lease: Lease, orders: Orders, caller: Caller, again_s: float) -> None:
    for left in reversed(range(STOP_TRIES)):
        try:
            await orders.stop(caller, lease.telescope)
        except DeviceError:
            if left == 0:
                raise
            await asyncio.sleep(again_s)
        else:
            return
