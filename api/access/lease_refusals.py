"""What is said to those whom a lease keeps out: another holds the telescope, or their own lease is over."""

from __future__ import annotations

from secrets import compare_digest

from api.access.callers import Caller
from api.access.keys import sha256_of
from api.access.lease import Lease
from api.http.faults import Refused, problem

_HOLD = "wait, ask its holder, or break it: POST /v1/telescopes/{id}/lease with force, role configure"
_TAKE = "see where the telescope stands, then take it anew: POST /v1/telescopes/{id}/lease"


def holds(caller: Caller, lease: Lease) -> bool:
    """Whether a caller shows the secret of a lease."""
    return caller.lease_id is not None and compare_digest(sha256_of(caller.lease_id), lease.secret_sha256)


def kept_out(caller: Caller, telescope_id: str, lease: Lease | None, left_s: float) -> Refused:
    """Say why a caller is not let through.

    Parameters
    ----------
    caller : Caller
    telescope_id : str
    lease : Lease or None
        What is in force.
    left_s : float
        How long that lasts.

    Returns
    -------
    Refused
        409 ``leased``: another holds it. 409 ``lease-lost``: the caller shows a lease that is none any more,
        whoever holds the telescope now: it must not go on in the belief that the telescope is its own.
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


__all__ = ["holds", "kept_out", "leased"]
