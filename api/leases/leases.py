"""Leases: a telescope is held by a heartbeat; when that ends, what was agreed is done once.

Without the lease nothing but a stop may be ordered on a leased telescope. A lease outlives a restart of the
service: one that ran out meanwhile is acted on when the service begins. What is done for a holder that has
fallen silent goes through the dispatcher, like any order.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from secrets import token_urlsafe
from typing import Protocol

from api.access.audit import Audit
from api.access.callers import Caller, Face, Role
from api.access.keys import sha256_of
from api.access.security import require_role, require_telescope
from api.leases.lease import Lease, OnExpiry, holds, kept_out, lease_of, leased, row_of
from api.orders.job import Job, JobState
from api.orders.vocabulary import Order, ParkOrder
from api.problems import Refused
from mountnav.errors import DeviceError, MountnavError
from mountnav.journal.audit_and_leases import LeaseRow
from mountnav.tasks import begun, fault_words

__all__ = ["LeaseKeeper", "Leases"]


STOP_AGAIN_S = 5.0
"""Between two tries of the stop of an expired lease, s. With `STOP_TRIES`: for a minute. Doubled, a mount
whose link fails once slews on for 5 s more."""
STOP_TRIES = 12
"""A stop that doesn't reach the mount is sent again, for a minute: the mount may be slewing."""


class Orders(Protocol):
    """The dispatcher, as far as it is needed here."""

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

    async def end_rates(self, caller: Caller, telescope_id: str) -> None:
        """End rates beside the sidereal one that no job has."""
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
    caller = caller_for(lease)
    if lease.on_expiry is OnExpiry.KEEP_TRACKING:
        # as for a star: rates of a target that nobody looks after any more lead astray
        await orders.end_rates(caller, lease.telescope)
        return None
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


_log = logging.getLogger(__name__)

Tell = Callable[[str, dict[str, object]], object]


class LeaseKeeper(Protocol):
    """Where leases outlive the process."""

    async def save_lease(self, row: LeaseRow) -> None:
        """Keep it; on the disk on return. Raises `JournalFailed`."""
        ...

    def save_lease_now(self, row: LeaseRow) -> None:
        """Keep it, without waiting. Never raises."""
        ...

    def end_lease_now(self, telescope: str, secret_sha256: str) -> None:
        """It is over. Never raises."""
        ...


class Leases:
    """Who holds which telescope. Used from the event loop's thread alone.

    Parameters
    ----------
    tell : callable
        ``tell(kind, data)``: publishes an event.
    """

    def __init__(
        self, keeper: LeaseKeeper, tell: Tell, audit: Audit, *, stop_again_s: float = STOP_AGAIN_S
    ) -> None:
        self._keeper = keeper
        self._tell = tell
        self._audit = audit
        self._stop_again_s = stop_again_s
        self._leases: dict[str, Lease] = {}
        self._turns: dict[str, asyncio.Lock] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._acting: dict[str, asyncio.Task[None]] = {}
        self._watching: set[asyncio.Task[None]] = set()
        self._orders: Orders | None = None
        self._closed = False

    def open(self, orders: Orders, kept: list[LeaseRow]) -> None:
        """Take up the leases of an earlier run; those that ran out meanwhile are acted on at once.

        To be called when orders can be given, and before a client is let in.

        Parameters
        ----------
        orders : Orders
            The dispatcher.
        kept : list of LeaseRow
            As the journal has them, of this service's telescopes.
        """
        self._orders = orders
        now_utc, now_s = _machine_utc(), asyncio.get_running_loop().time()
        for row in kept:
            lease = lease_of(row, now_utc, now_s)
            self._leases[lease.telescope] = lease
            if lease.until_s <= now_s:
                self._expire(lease)
            else:
                self._wind(lease)

    async def close(self) -> None:
        """Act on nothing any more; leases stay written down with their deadlines."""
        self._closed = True
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        tasks = [*self._acting.values(), *self._watching]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def of(self, telescope_id: str) -> Lease | None:
        """The telescope's lease, if it is held."""
        return self._leases.get(telescope_id)

    def require(self, caller: Caller, telescope_id: str) -> None:
        """Let an order pass unless somebody else holds the telescope.

        Raises
        ------
        Refused
            409 ``leased``: another holds it. 409 ``lease-lost``: the caller shows a lease that is none any
            more, no matter who holds the telescope now; see `kept_out`.
        """
        if caller.face is Face.SERVICE:
            return
        if caller.lease_id is not None or telescope_id in self._leases:
            self._own(caller, telescope_id)

    async def take(
        self,
        caller: Caller,
        telescope_id: str,
        *,
        ttl_s: float,
        on_expiry: OnExpiry = OnExpiry.STOP,
        note: str = "",
        force: bool = False,
    ) -> tuple[Lease, str]:
        """Take a telescope; who holds it already gets a new lease with these terms.

        Parameters
        ----------
        caller : Caller
            Of role operate at least.
        ttl_s : float
            It lasts so long without a heartbeat.
        on_expiry : OnExpiry
            What is done then.
        note : str
            For people who meet it.
        force : bool
            Break another's lease; needs the role configure.

        Returns
        -------
        str
            The secret that shows its holder, told this once.

        Raises
        ------
        Refused
            409 ``leased``; 403 ``role-too-low``.
        JournalFailed
            It can't be written down, and so isn't taken.
        """
        require_role(caller, Role.CONFIGURE if force else Role.OPERATE)
        require_telescope(caller, telescope_id)
        async with self._turns.setdefault(telescope_id, asyncio.Lock()):
            held = self._leases.get(telescope_id)
            if held is not None and not force and (held.ending or not holds(caller, held)):
                raise leased(held, self._left_s(held))
            secret = token_urlsafe(32)
            now_utc, now_s = _machine_utc(), asyncio.get_running_loop().time()
            lease = Lease(
                telescope=telescope_id,
                holder=caller.name,
                role=str(caller.role),
                face=str(caller.face),
                address=caller.address,
                secret_sha256=sha256_of(secret),
                ttl_s=ttl_s,
                on_expiry=on_expiry,
                note=note,
                taken_utc=now_utc,
                until_utc=now_utc + timedelta(seconds=ttl_s),
                until_s=now_s + ttl_s,
            )
            await self._keeper.save_lease(row_of(lease))
            # what was in force while it was written down gives way
            held = self._leases.get(telescope_id)
            self._forget(telescope_id)
            self._leases[telescope_id] = lease
            self._wind(lease)
        if held is not None and not holds(caller, held):
            self._say("lease-broken", held, by=caller.name)
        self._say("lease-taken", lease)
        return lease, secret

    def heartbeat(self, caller: Caller, telescope_id: str) -> Lease:
        """The holder lives: the lease lasts for its `ttl_s` from now on. Raises `Refused` as `release`."""
        lease = self._own(caller, telescope_id)
        lease.until_utc = _machine_utc() + timedelta(seconds=lease.ttl_s)
        lease.until_s = asyncio.get_running_loop().time() + lease.ttl_s
        self._wind(lease)
        turn = self._turns.get(telescope_id)
        if turn is None or not turn.locked():
            # while another's is being written, this one's row must not come behind it
            self._keeper.save_lease_now(row_of(lease))
        return lease

    def release(self, caller: Caller, telescope_id: str, *, force: bool = False) -> Lease:
        """Give the telescope back; what was agreed for the holder's silence is not done.

        Raises
        ------
        Refused
            409 ``leased``: another holds it (`force`, with the role configure, ends that lease as well).
            409 ``lease-lost``: it is not the caller's any more.
        """
        if force:
            require_role(caller, Role.CONFIGURE)
            lease = self._leases.get(telescope_id)
            if lease is None:
                raise kept_out(caller, telescope_id, None, 0.0)
        else:
            lease = self._own(caller, telescope_id)
        own = holds(caller, lease)
        self._forget(telescope_id)
        self._keeper.end_lease_now(telescope_id, lease.secret_sha256)
        if own:
            self._say("lease-released", lease)
        else:
            self._say("lease-broken", lease, by=caller.name)
        return lease

    def _own(self, caller: Caller, telescope_id: str) -> Lease:
        """The lease that a caller holds. Raises `Refused` if that is none."""
        lease = self._leases.get(telescope_id)
        if lease is None or lease.ending or not holds(caller, lease):
            raise kept_out(caller, telescope_id, lease, 0.0 if lease is None else self._left_s(lease))
        return lease

    def _left_s(self, lease: Lease) -> float:
        return max(0.0, lease.until_s - asyncio.get_running_loop().time())

    def _wind(self, lease: Lease) -> None:
        """Have it run out at its deadline."""
        if (timer := self._timers.pop(lease.telescope, None)) is not None:
            timer.cancel()
        loop = asyncio.get_running_loop()
        self._timers[lease.telescope] = loop.call_at(lease.until_s, self._expire, lease)

    def _forget(self, telescope_id: str) -> None:
        """Take a lease out of force, and whatever is being done for it."""
        self._leases.pop(telescope_id, None)
        if (timer := self._timers.pop(telescope_id, None)) is not None:
            timer.cancel()
        if (acting := self._acting.pop(telescope_id, None)) is not None:
            acting.cancel()

    def _expire(self, lease: Lease) -> None:
        if self._closed or self._leases.get(lease.telescope) is not lease:
            return
        lease.ending = True
        self._timers.pop(lease.telescope, None)
        self._say("lease-expired", lease)
        self._audit.note(
            caller_for(lease),
            "lease-expired",
            telescope=lease.telescope,
            request={"on_expiry": str(lease.on_expiry), "ttl_s": lease.ttl_s, "note": lease.note},
        )
        self._acting[lease.telescope] = begun(
            self._act(lease),
            f"lease {lease.telescope}",
            died=lambda fault: self._done(lease, fault_words(fault)),
        )

    async def _act(self, lease: Lease) -> None:
        assert self._orders is not None, "leases are open before they can run out"
        failed, job = "", None
        try:
            job = await act(lease, self._orders, again_s=self._stop_again_s)
        except (MountnavError, Refused) as error:
            failed = str(error)
        except Exception as error:
            _log.exception("the lease of %s on %s failed unexpectedly", lease.holder, lease.telescope)
            failed = f"a fault in mountnav: {type(error).__name__}"
        # done, once: from now on the telescope is free, and a restart doesn't do it again
        self._acting.pop(lease.telescope, None)
        self._leases.pop(lease.telescope, None)
        self._keeper.end_lease_now(lease.telescope, lease.secret_sha256)
        if job is not None:
            watching = begun(
                self._watch(lease, job),
                f"end of the lease of {lease.telescope}",
                died=lambda fault: self._done(lease, fault_words(fault)),
            )
            self._watching.add(watching)
            watching.add_done_callback(self._watching.discard)
        else:
            self._done(lease, failed)

    async def _watch(self, lease: Lease, job: Job) -> None:
        self._done(lease, await end_of(job))

    def _done(self, lease: Lease, failed: str) -> None:
        if failed:
            _log.error(
                "%s: the lease of %s ran out, and %s failed: %s",
                lease.telescope,
                lease.holder,
                lease.on_expiry,
                failed,
            )
            self._audit.note(
                caller_for(lease),
                "lease-expired",
                telescope=lease.telescope,
                request={"on_expiry": str(lease.on_expiry)},
                outcome="lease-policy-failed",
                detail=failed,
            )
            self._say("lease-policy-failed", lease, why=failed)
        else:
            self._say("lease-policy-done", lease)

    def _say(self, kind: str, lease: Lease, **more: object) -> None:
        data: dict[str, object] = {
            "telescope": lease.telescope,
            "holder": lease.holder,
            "note": lease.note,
            "on_expiry": str(lease.on_expiry),
            "until_utc": lease.until_utc.isoformat(),
        }
        self._tell(kind, data | more)


def _machine_utc() -> datetime:
    """The machine's UTC, also in a virtual observatory: holders' heartbeats come by the machine's time."""
    return datetime.now(UTC)
