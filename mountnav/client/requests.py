"""Requests as values: what goes out, whether it may go out again, and what the answer is. No I/O.

Both clients carry out the same ones. A request may be sent again after a lost answer if that changes nothing:
questions, stops, cancelling; and orders, by the Idempotency-Key that each carries from its making on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, TypeVar
from urllib.parse import quote
from uuid import uuid4

from mountnav.client import orders
from mountnav.client.orders import Order
from mountnav.client.results import (
    Capabilities,
    Forecast,
    Health,
    Job,
    LeaseState,
    NextPanel,
    Reloaded,
    SkyObject,
    StopAll,
    Stopped,
    TelescopeState,
)
from mountnav.client.targets import Target, icrs

T = TypeVar("T")
ANSWER_S = 10.0
"""Patience with an answer, beyond what it was asked to wait."""


@dataclass(frozen=True, slots=True)
class Request(Generic[T]):
    """One request.

    Attributes
    ----------
    method, path : str
        HTTP method, and path from the service's address.
    params : mapping
        Query parameters.
    body : object
        JSON; None for none.
    headers : mapping
        Headers beside those that the client always sends.
    again : bool
        Whether it may be sent again when its answer was lost.
    wait_s : float
        So long the service was asked to wait before it answers.
    telescope : str or None
        Whose lease goes with it.
    answer : type
        Of the result, for the type checker alone.
    """

    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    body: object = None
    headers: Mapping[str, str] = field(default_factory=dict)
    again: bool = True
    wait_s: float = 0.0
    telescope: str | None = None
    answer: Callable[[Any], T] | None = None


def _id(name: str) -> str:
    return quote(name, safe="")


def _of(telescope_id: str, rest: str = "") -> str:
    return f"/v1/telescopes/{_id(telescope_id)}{rest}"


def _id_of(job: Job | str) -> str:
    return job if isinstance(job, str) else job["id"]


# -- questions -------------------------------------------------------------------------------------


def telescopes() -> Request[list[TelescopeState]]:
    """State of all telescopes. Asks no device."""
    return Request("GET", "/v1/telescopes")


def telescope(telescope_id: str) -> Request[TelescopeState]:
    """State of one telescope. Asks no device; one that has not changed is not sent again (ETag)."""
    return Request("GET", _of(telescope_id))


def jobs(telescope_id: str | None = None, *, count: int = 100) -> Request[list[Job]]:
    """Jobs still remembered, newest first: of one telescope, or all."""
    path = "/v1/jobs" if telescope_id is None else _of(telescope_id, "/jobs")
    return Request("GET", path, {"count": count})


def job(job_id: Job | str, *, wait_s: float = 0.0) -> Request[Job]:
    """A job; with `wait_s`, when it has ended or that time has passed."""
    params = {"wait": wait_s} if wait_s else {}
    return Request("GET", f"/v1/jobs/{_id(_id_of(job_id))}", params, wait_s=wait_s)


def objects(q: str = "", *, count: int = 20) -> Request[list[SkyObject]]:
    """Bright objects by name, with where they stand now; an empty name: the brightest."""
    return Request("GET", "/v1/objects", {"q": q, "count": count})


def forecast(telescope_id: str, target: Target, *, hours: float = 12.0) -> Request[Forecast]:
    """What will happen to a target: rises, sets, meridian, the Sun's cone, limits. Orders nothing."""
    return Request("POST", _of(telescope_id, "/forecast"), body={"target": target, "hours": hours})


def capabilities() -> Request[Capabilities]:
    """What the service can do: kinds of jobs, skills of telescopes, faces."""
    return Request("GET", "/v1/capabilities")


def health() -> Request[Health]:
    """Whether it is ready, and if not, why not."""
    return Request("GET", "/v1/health")


def lease_state(telescope_id: str) -> Request[LeaseState]:
    """Who holds a telescope, until when."""
    return Request("GET", _of(telescope_id, "/lease"))


# -- orders ----------------------------------------------------------------------------------------


def order(
    telescope_id: str,
    what: Order,
    *,
    wait_s: float = 0.0,
    supersede: bool = False,
    key: str | None = None,
) -> Request[Job]:
    """Give an order; the job, which has begun.

    Parameters
    ----------
    telescope_id : str
        Id of the telescope, as the settings name it.
    what : dict
        One of `mountnav.client.orders`.
    wait_s : float
        Wait so long for the job's end before the answer.
    supersede : bool
        End the job that holds the telescope; else that is a `ServiceError` ``busy``.
    key : str, optional
        Idempotency-Key: a program that may be killed keeps its own, so that the next run of it gives the
        same order no second time. One is made if left out.
    """
    params: dict[str, Any] = {"wait": wait_s} if wait_s else {}
    if supersede:
        params["supersede"] = "true"
    return Request(
        "POST",
        _of(telescope_id, "/jobs"),
        params,
        what,
        {"Idempotency-Key": key or uuid4().hex},
        wait_s=wait_s,
        telescope=telescope_id,
    )


def _place(ra_deg: float | None, dec_deg: float | None, target: Target | None) -> Target:
    if target is not None and ra_deg is None and dec_deg is None:
        return target
    if target is None and ra_deg is not None and dec_deg is not None:
        return icrs(ra_deg, dec_deg)
    raise TypeError("either ra_deg and dec_deg (ICRS), or a target")


def slew(
    telescope_id: str,
    ra_deg: float | None = None,
    dec_deg: float | None = None,
    *,
    target: Target | None = None,
    wait_s: float = 0.0,
    supersede: bool = False,
    key: str | None = None,
) -> Request[Job]:
    """Start a slew to an ICRS place or a target; the job."""
    what = orders.slew(_place(ra_deg, dec_deg, target))
    return order(telescope_id, what, wait_s=wait_s, supersede=supersede, key=key)


def center(
    telescope_id: str,
    ra_deg: float | None = None,
    dec_deg: float | None = None,
    *,
    target: Target | None = None,
    wait_s: float = 0.0,
    supersede: bool = False,
    key: str | None = None,
    **options: Any,
) -> Request[Job]:
    """Start a centering on an ICRS place or a target; the job. Options as of `orders.center`."""
    what = orders.center(_place(ra_deg, dec_deg, target), **options)
    return order(telescope_id, what, wait_s=wait_s, supersede=supersede, key=key)


def look(telescope_id: str, *, wait_s: float = 0.0, key: str | None = None, **options: Any) -> Request[Job]:
    """Start a look; the job. Options: exposure_s, persistent."""
    return order(telescope_id, orders.look(**options), wait_s=wait_s, key=key)


def recover(telescope_id: str, *, wait_s: float = 0.0, key: str | None = None) -> Request[Job]:
    """Start the recovery of a mount that doesn't know where it points; the job. Moves nothing."""
    return order(telescope_id, orders.recover(), wait_s=wait_s, key=key)


def first_light(telescope_id: str, *, wait_s: float = 0.0, key: str | None = None) -> Request[Job]:
    """Start a telescope's first light; the job. Moves it a little, within its limits."""
    return order(telescope_id, orders.first_light(), wait_s=wait_s, key=key)


def park(
    telescope_id: str, *, wait_s: float = 0.0, supersede: bool = False, key: str | None = None
) -> Request[Job]:
    """Start parking; the job."""
    return order(telescope_id, orders.park(), wait_s=wait_s, supersede=supersede, key=key)


def unpark(telescope_id: str, *, wait_s: float = 0.0, key: str | None = None) -> Request[Job]:
    """Be ready to move again; the job."""
    return order(telescope_id, orders.unpark(), wait_s=wait_s, key=key)


def follow(
    telescope_id: str,
    target: Target,
    *,
    wait_s: float = 0.0,
    supersede: bool = False,
    key: str | None = None,
    **options: Any,
) -> Request[Job]:
    """Start to follow a target that moves; the job. Options as of `orders.follow`: an end is one of them."""
    what = orders.follow(target, **options)
    return order(telescope_id, what, wait_s=wait_s, supersede=supersede, key=key)


def move_axis(
    telescope_id: str,
    axis: Literal["primary", "secondary"],
    rate_deg_s: float,
    *,
    for_s: float | None = None,
    job: Job | str | None = None,
    supersede: bool = False,
) -> Request[Job]:
    """Move an axis on for a moment; the job, in which it goes on as long as this is called again in time.

    It is never sent again by itself: a motion that comes late is one that nobody wants any more. So give the
    first one's `job` with all that follow: they are refused once that has ended. 0 ends it.
    """
    what = orders.move_axis(axis, rate_deg_s, for_s=for_s, job_id=None if job is None else _id_of(job))
    given = order(telescope_id, what, supersede=supersede)
    return replace(given, again=False)


def offset_rates(
    telescope_id: str,
    ra_arcsec_s: float,
    dec_arcsec_s: float,
    *,
    for_s: float | None = None,
    wait_s: float = 0.0,
    supersede: bool = False,
    key: str | None = None,
) -> Request[Job]:
    """Track at rates beside the sidereal one, up to an end; the job. Rates as of `orders.offset_rates`."""
    what = orders.offset_rates(ra_arcsec_s, dec_arcsec_s, for_s=for_s)
    return order(telescope_id, what, wait_s=wait_s, supersede=supersede, key=key)


# -- ends ------------------------------------------------------------------------------------------


def cancel(job_id: Job | str) -> Request[Job]:
    """End a job; the mount is stopped. Twice is fine."""
    return Request("DELETE", f"/v1/jobs/{_id(_id_of(job_id))}")


def next_panel(job_id: Job | str) -> Request[NextPanel]:
    """Say that the camera is through with a frame of a mosaic's panel. Never sent twice: each counts."""
    telescope = None if isinstance(job_id, str) else job_id["telescope"]
    path = f"/v1/jobs/{_id(_id_of(job_id))}/next"
    return Request("POST", path, again=False, telescope=telescope)


def stop(telescope_id: str) -> Request[Stopped]:
    """Stop all motion now; never refused as busy or leased."""
    return Request("POST", _of(telescope_id, "/stop"))


def stop_all() -> Request[StopAll]:
    """Stop all telescopes now."""
    return Request("POST", "/v1/stop")


def reload() -> Request[Reloaded]:
    """Have the service read its settings again: telescopes are added, changed and taken out."""
    return Request("POST", "/v1/reload")


# -- leases ----------------------------------------------------------------------------------------


def take_lease(
    telescope_id: str, *, ttl_s: float, on_expiry: str, note: str, force: bool
) -> Request[LeaseState]:
    """Take a telescope. Not sent again after a lost answer: the secret would be lost with it."""
    body = {"ttl_s": ttl_s, "on_expiry": on_expiry, "note": note, "force": force}
    return Request("POST", _of(telescope_id, "/lease"), body=body, again=False, telescope=telescope_id)


def keep_lease(telescope_id: str, secret: str) -> Request[LeaseState]:
    """The holder's heartbeat."""
    return Request("PUT", _of(telescope_id, "/lease"), headers={LEASE_HEADER: secret})


def release_lease(telescope_id: str, secret: str) -> Request[LeaseState]:
    """Give a telescope back."""
    return Request("DELETE", _of(telescope_id, "/lease"), headers={LEASE_HEADER: secret})


LEASE_HEADER = "Mountnav-Lease"


def events_path(telescope_id: str | None, job_id: str | None) -> str:
    """Of the stream of one job, of one telescope, or of all."""
    if job_id is not None:
        return f"/v1/jobs/{_id(job_id)}/events"
    return "/v1/events" if telescope_id is None else _of(telescope_id, "/events")
