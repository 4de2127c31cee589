"""`Client`: the service's HTTP API as calls that block."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx

from mountnav.client.calls import Calls
from mountnav.client.failures import ServiceError
from mountnav.client.following import TIMEOUT, Following
from mountnav.client.lease import Lease
from mountnav.client.requests import Request
from mountnav.client.results import Job
from mountnav.client.sending import Known, Send, Steps, problem_of, sending, settings, waiting
from mountnav.client.stream import ServerEvent

T = TypeVar("T")


class Client(Calls):
    """Talks to one mountnav service; may be used from several threads.

    Parameters
    ----------
    base_url : str
        Such as ``http://127.0.0.1:8000``.
    token : str, optional
        API key.
    timeout_s : float
        For each answer; waiting for a job has its own.
    """

    def __init__(self, base_url: str, *, token: str | None = None, timeout_s: float = 10.0) -> None:
        self._http = httpx.Client(**settings(base_url, token, timeout_s))
        self._timeout_s = timeout_s
        self.known = Known()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the connections."""
        self._http.close()

    def do(self, request: Request[T]) -> T:
        """Carry out a request.

        Raises
        ------
        ServiceError
            If the service answers with a problem.
        httpx.TransportError
            If there is no answer after all attempts. An order may be given again with the same key.
        """
        return self._carried_out(sending(request, self.known, self._timeout_s))

    def _carried_out(self, steps: Steps[T]) -> T:
        came: httpx.Response | httpx.TransportError | None = None
        while True:
            try:
                step = steps.send(came)
            except StopIteration as end:
                answer: T = end.value
                return answer
            if isinstance(step, Send):
                try:
                    came = self._http.request(step.method, step.path, **step.arguments)
                except httpx.TransportError as failure:
                    came = failure
            else:
                time.sleep(step.seconds)
                came = None

    # -- jobs ------------------------------------------------------------------------------------------

    def wait(self, job: Job | str, *, timeout_s: float | None = None) -> Job:
        """Wait for a job's end, however it ends.

        Parameters
        ----------
        job : Job or str
            The job or its id.
        timeout_s : float, optional
            Give it up after so long; the job goes on.

        Raises
        ------
        TimeoutError
            If it has not ended by then.
        """
        return self._carried_out(waiting(job, self.known, self._timeout_s, timeout_s=timeout_s))

    def succeeded(self, job: Job | str, *, timeout_s: float | None = None) -> Job:
        """Wait for a job's end. Raises `JobFailed` if it is not success, `TimeoutError` as `wait`."""
        steps = waiting(job, self.known, self._timeout_s, timeout_s=timeout_s, success=True)
        return self._carried_out(steps)

    def lease(
        self,
        telescope_id: str,
        *,
        ttl_s: float = 30.0,
        on_expiry: str = "stop",
        note: str = "",
        force: bool = False,
    ) -> Lease:
        """Hold a telescope: ``with client.lease("east"): ...``; kept by heartbeats in the background.

        Parameters
        ----------
        telescope_id : str
        ttl_s : float
            It lasts so long when the heartbeats end.
        on_expiry : {"stop", "park", "keep-tracking"}
            What the service does then.
        note : str
            For people who meet it.
        force : bool
            Break another's lease; needs the role configure.
        """
        return Lease(self, telescope_id, ttl_s, on_expiry, note, force)

    # -- events ----------------------------------------------------------------------------------------

    def events(
        self,
        *,
        after: str | None = None,
        telescope: str | None = None,
        job: Job | str | None = None,
        patience_s: float = 60.0,
    ) -> Iterator[ServerEvent]:
        """Events as they come, over lost connections too: none is told twice, a lost one shows as a ``gap``.

        Parameters
        ----------
        after : str, optional
            Go on after the event with this id; from now on if left out (of a job: from its beginning).
        telescope, job : optional
            Of one alone; the events of a job end with it.
        patience_s : float
            So long a lost connection is tried again.

        Raises
        ------
        ServiceError
            If the service answers with a problem.
        httpx.TransportError
            If it can't be reached any more.
        """
        following = Following(after=after, telescope=telescope, job=job, patience_s=patience_s)
        while True:
            failure: httpx.TransportError | None = None
            try:
                with self._http.stream(
                    "GET", following.path, headers=following.headers, timeout=TIMEOUT
                ) as response:
                    if response.is_error:
                        response.read()
                        raise ServiceError(problem_of(response), response.status_code)
                    for line in response.iter_lines():
                        event = following.heard(line)
                        if event is not None:
                            yield event
                            if following.over:
                                return
            except httpx.TransportError as broken:
                failure = broken
            time.sleep(following.broken(failure))

    def wire(self, telescope_id: str, *, after: int = 0) -> list[dict[str, Any]]:
        """Messages between driver and mount with numbers above `after`; from 0 on with a header in front."""
        response = self._http.get(f"/v1/telescopes/{telescope_id}/wire", params={"after": after})
        if response.is_error:
            raise ServiceError(problem_of(response), response.status_code)
        return [json.loads(line) for line in response.text.splitlines()]

    def _json(self, method: str, path: str, **arguments: Any) -> dict[str, Any]:
        """Send a request once, and read its answer."""
        response = self._http.request(method, path, **arguments)
        if response.is_error:
            raise ServiceError(problem_of(response), response.status_code)
        body: dict[str, Any] = response.json() if response.content else {}
        return body
