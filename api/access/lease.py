"""One lease: who holds a telescope, until when, and what is done if the holder falls silent."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.journal.audit_and_leases import LeaseRow

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
    telescope : str
    holder : str
        The caller's name.
    role, face, address : str
        Of the caller who took it.
    secret_sha256 : str
        Of what its holder sends; the secret itself is kept nowhere.
    ttl_s : float
        How long it lasts without a heartbeat.
    on_expiry : OnExpiry
    note : str
        The holder's words.
    taken_utc, until_utc : datetime
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
