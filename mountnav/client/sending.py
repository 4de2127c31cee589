"""How a request is sent, as steps that either client carries out: send, read the answer, pause, send again.

No I/O: `sending` (and `waiting`, for the end of a job) yields what is to be done and is told what came of it.
A lost answer is answered by the same request with the same key; a service that is asked too often says after
how long it may be asked again.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, TypeVar

import httpx

from mountnav.client import requests
from mountnav.client.failures import JobFailed, ServiceError
from mountnav.client.requests import ANSWER_S, LEASE_HEADER, Request
from mountnav.client.results import ENDS, Job, Json

T = TypeVar("T")
# Seconds before each repeat of a request, so four attempts at most. Chosen by hand: short enough for a lost
# packet, long enough for a service that restarts. Doubled, a call to a dead service fails after 8.6 s
# instead of 4.3 s.
_PAUSES_S = (0.3, 1.0, 3.0)
# HTTP status of an answer that the client has already [RFC 9110 §15.4.5].
_NOT_MODIFIED = 304
# HTTP status of a request over its rate [RFC 6585 §4], and the longest pause, s, that is kept because the
# service asks for it (chosen by hand). Doubled, a call may block a minute for each attempt.
_TOO_MANY, _LONGEST_PAUSE_S = 429, 30.0
# Seconds that the service is asked to hold a request for a job that goes on. Chosen by hand, below the
# usual idle timeouts of proxies (60 s); doubled, such a proxy may cut it.
_WAIT_S = 30.0


@dataclass(frozen=True, slots=True)
class Send:
    """Send this now; the answer is an `httpx.Response` or an `httpx.TransportError`."""

    method: str
    path: str
    arguments: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Pause:
    """Wait so long."""

    seconds: float


@dataclass(slots=True)
class Known:
    """What a client remembers between requests.

    Attributes
    ----------
    leases : dict
        Secrets of the leases that it holds, by telescope.
    answers : dict
        Entity tag and answer, by path.
    """

    leases: dict[str, str] = field(default_factory=dict)
    answers: dict[str, tuple[str, Any]] = field(default_factory=dict)


Steps = Generator[Send | Pause, httpx.Response | httpx.TransportError | None, T]


def sending(request: Request[T], known: Known, timeout_s: float) -> Steps[T]:
    """Send a request until it is answered.

    Parameters
    ----------
    request : Request
        What is to be sent.
    known : Known
        What the client knows of the service and of its requests.
    timeout_s : float
        For each attempt, beyond what the service was asked to wait.

    Raises
    ------
    ServiceError
        If the answer is a problem.
    httpx.TransportError
        If there is no answer after all attempts, or the request can't be sent again.
    """
    send = _send(request, known, timeout_s)
    pauses = list(_PAUSES_S)
    while True:
        came = yield send
        if isinstance(came, httpx.Response):
            pause_s = _asked_to_wait(came)
            if pause_s is None or not pauses:
                return _read(came, request, known)
            pauses.pop(0)
        else:
            assert came is not None
            # what never reached the service may go out again in any case
            if not pauses or not (request.again or isinstance(came, httpx.ConnectError)):
                raise came
            pause_s = pauses.pop(0)
        yield Pause(pause_s)


def waiting(
    job: Job | str, known: Known, answer_s: float, *, timeout_s: float | None, success: bool = False
) -> Steps[Job]:
    """Ask for a job until it has ended.

    Parameters
    ----------
    job : Job or str
        The job, or its id.
    known : Known
        What the client knows of the service and of its requests.
    answer_s : float
        As `timeout_s` of `sending`.
    timeout_s : float or None
        Give it up after so long.
    success : bool
        Whether no other end will do.

    Raises
    ------
    TimeoutError
        It has not ended by then.
    JobFailed
        It ended otherwise.
    ServiceError, httpx.TransportError
        As of `sending`.
    """
    until_s = None if timeout_s is None else time.monotonic() + timeout_s
    while True:
        left_s = _WAIT_S if until_s is None else max(0.0, until_s - time.monotonic())
        now = yield from sending(requests.job(job, wait_s=min(_WAIT_S, left_s)), known, answer_s)
        if now["state"] in ENDS:
            if success and now["state"] != "succeeded":
                raise JobFailed(now)
            return now
        if until_s is not None and time.monotonic() >= until_s:
            raise TimeoutError(f"the {now['kind']} goes on after {timeout_s:.0f} s")


def _send(request: Request[T], known: Known, timeout_s: float) -> Send:
    headers = dict(request.headers)
    secret = known.leases.get(request.telescope or "")
    if secret is not None:
        headers.setdefault(LEASE_HEADER, secret)
    tag = known.answers.get(request.path)
    if request.method == "GET" and tag is not None and not request.params:
        headers["If-None-Match"] = tag[0]
    patience_s = request.wait_s + (max(timeout_s, ANSWER_S) if request.wait_s else timeout_s)
    arguments: dict[str, Any] = {"headers": headers, "timeout": patience_s, "params": dict(request.params)}
    if request.body is not None:
        arguments["json"] = request.body
    return Send(request.method, request.path, arguments)


def _asked_to_wait(response: httpx.Response) -> float | None:
    """After how long a request that was not looked at may come again; None where it was."""
    if response.status_code != _TOO_MANY:
        return None
    after = problem_of(response).get("retry_after_s")
    return min(max(float(after), 0.0), _LONGEST_PAUSE_S) if isinstance(after, (int, float)) else 1.0


def _read(response: httpx.Response, request: Request[T], known: Known) -> T:
    if response.status_code == _NOT_MODIFIED:
        kept: T = deepcopy(known.answers[request.path][1])
        return kept
    if response.is_error:
        raise ServiceError(problem_of(response), response.status_code)
    body: T = _body(response)
    tag = response.headers.get("etag")
    if request.method == "GET" and tag and not request.params:
        known.answers[request.path] = (tag, deepcopy(body))  # what was given out may be changed
    return body


def _body(response: httpx.Response) -> Any:
    try:
        return response.json() if response.content else {}
    except ValueError:
        # a proxy's page, with a status that says that all is well
        raise ServiceError(problem_of(response), response.status_code) from None


def settings(base_url: str, token: str | None, timeout_s: float) -> dict[str, Any]:
    """What an `httpx` client of either kind is made with; no proxy stands between us and the service."""
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    return {"base_url": base_url, "headers": headers, "timeout": timeout_s, "trust_env": False}


_SHOWN = 60
"""Characters that are shown of an answer of somebody else. Doubled, a line fills two of a terminal."""


def problem_of(response: httpx.Response) -> Json:
    """The problem in an answer; one of our own where something else than the service answered."""
    try:
        told = response.json()
    except ValueError:
        told = None
    if isinstance(told, dict):
        return told
    words = f"HTTP status {response.status_code}, {' '.join(response.text[:200].split())[:_SHOWN]!r}"
    return {
        "title": f"HTTP status {response.status_code}",
        "detail": f"what answers is no mountnav service: {words}",
        "advice": "another program, or a proxy, listens at that address",
    }
