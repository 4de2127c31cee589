"""One lease of a telescope: its holder, its end, and the refusals that it gives to others."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from secrets import compare_digest

from api.access.callers import Caller
from api.access.keys import sha256_of
from api.problems import Refused, problem
from mountnav.journal.audit_and_leases import LeaseRow

__all__ = ["holds", "kept_out", "leased"]


SHORTEST_S, LONGEST_S = 5.0, 3600.0
"""How long a lease may last without a heartbeat."""


class OnExpiry(StrEnum):
    """What is done when a holder falls silent."""

    STOP = "stop"
    """Cancel the telescope's job and stop its motion."""
    KEEP_TRACKING = "keep-tracking"
    """Cancel nothing: what was ordered goes on, the telescope is free."""
    PARK = "park"
    """Stop, then park."""


@dataclass(slots=True, eq=False)
class Lease:
    """A telescope in somebody's hands; only `Leases` changes it.

    Attributes
    ----------
    holder : str
        The caller's name.
    role, face, address : str
        Of the caller who took it.
    secret_sha256 : str
        Of what its holder sends; the secret itself is kept nowhere.
    ttl_s : float
        How long it lasts without a heartbeat.
    note : str
        The holder's words.
    until_s : float
        By the loop's clock, which no setting of the machine's clock disturbs.
    ending : bool
        It ran out, and what was agreed for that is being done.
    """

    telescope: str
    holder: str
    role: str
    face: str
    address: str
    secret_sha256: str
    ttl_s: float
    on_expiry: OnExpiry
    note: str
    taken_utc: datetime
    until_utc: datetime
    until_s: float
    ending: bool = False


def row_of(lease: Lease) -> LeaseRow:
    """A lease as it is written down."""
    return LeaseRow(
        telescope=lease.telescope,
        holder=lease.holder,
        role=lease.role,
        face=lease.face,
        address=lease.address,
        secret_sha256=lease.secret_sha256,
        note=lease.note,
        ttl_s=lease.ttl_s,
        on_expiry=str(lease.on_expiry),
        taken_utc=lease.taken_utc,
        deadline_utc=lease.until_utc,
    )


def lease_of(row: LeaseRow, now_utc: datetime, now_s: float) -> Lease:
    """A lease that was written down, as it stands now.

    The time that is left is never more than was agreed, whatever was done to the clock meanwhile.
    """
    left_s = min((row.deadline_utc - now_utc).total_seconds(), row.ttl_s)
    return Lease(
        telescope=row.telescope,
        holder=row.holder,
        role=row.role,
        face=row.face,
        address=row.address,
        secret_sha256=row.secret_sha256,
        ttl_s=row.ttl_s,
        on_expiry=OnExpiry(row.on_expiry),
        note=row.note,
        taken_utc=row.taken_utc,
        until_utc=row.deadline_utc,
        until_s=now_s + left_s,
    )


_HOLD = "wait, ask its holder, or break it: POST /v1/telescopes/{id}/lease with force, role configure"
_TAKE = "see where the telescope stands, then take it again: POST /v1/telescopes/{id}/lease"


def holds(caller: Caller, lease: Lease) -> bool:
    """Whether a caller shows the secret of a lease."""
    return caller.lease_id is not None and compare_digest(sha256_of(caller.lease_id), lease.secret_sha256)


def kept_out(caller: Caller, telescope_id: str, lease: Lease | None, left_s: float) -> Refused:
    """Say why a caller is not let through.

    Parameters
    ----------
    lease : Lease or None
        What is in force.
    left_s : float
        How long that lasts.

    Returns
    -------
    Refused
        409 ``leased``: another holds it. 409 ``lease-lost``: the caller shows a lease that is none any more,
        no matter who holds the telescope now: it must not go on in the belief that the telescope is its own.
    """
    if lease is not None and caller.lease_id is None:
        return leased(lease, left_s)
    if caller.lease_id is None:
        what = "nobody holds the telescope, and no lease came with the request"
    elif lease is None:
        what = "the lease that came with the request is not in force any more"
    elif holds(caller, lease):
        what = _who(lease, left_s)
    else:
        what = f"the lease that came with the request is not in force any more: {_who(lease, left_s)}"
    return Refused(problem("lease-lost", 409, what, device=telescope_id, advice=_TAKE))


def leased(lease: Lease, left_s: float) -> Refused:
    """409 ``leased``: who holds the telescope, and for how long."""
    return Refused(
        problem(
            "leased",
            409,
            _who(lease, left_s),
            retryable=True,
            retry_after_s=max(1.0, float(round(left_s))),
            device=lease.telescope,
            advice=_HOLD,
        )
    )


def _who(lease: Lease, left_s: float) -> str:
    note = f" ({lease.note})" if lease.note else ""
    if lease.ending:
        return f"the lease of {lease.holder}{note} has run out, and {lease.on_expiry} is being done"
    return f"{lease.holder} holds the telescope{note}, for {left_s:.0f} s from the last heartbeat"
