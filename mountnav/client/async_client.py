"""`AsyncClient`: the service's HTTP API as calls to be awaited; the same as `Client` has."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from types import TracebackType
from typing import Self, TypeVar

import httpx

from mountnav.client.calls import Calls
from mountnav.client.failures import ServiceError
from mountnav.client.following import TIMEOUT, Following
from mountnav.client.lease import AsyncLease
from mountnav.client.requests import Request
from mountnav.client.results import Job
from mountnav.client.sending import Known, Send, Steps, problem_of, sending, settings, waiting
from mountnav.client.stream import ServerEvent

T = TypeVar("T")


class AsyncClient(Calls):
    """Talks to one mountnav service, from one event loop.

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
        self._http = httpx.AsyncClient(**settings(base_url, token, timeout_s))
        self._timeout_s = timeout_s
        self.known = Known()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Release the connections."""
        await self._http.aclose()

    async def do(self, request: Request[T]) -> T:
        """Carry out a request. Raises as `Client.do`."""
        return await self._carried_out(sending(request, self.known, self._timeout_s))

    async def _carried_out(self, steps: Steps[T]) -> T:
        came: httpx.Response | httpx.TransportError | None = None
        while True:
            try:
                step = steps.send(came)
            except StopIteration as end:
                answer: T = end.value
                return answer
            if isinstance(step, Send):
                try:
                    came = await self._http.request(step.method, step.path, **step.arguments)
                except httpx.TransportError as failure:
                    came = failure
            else:
                await asyncio.sleep(step.seconds)
                came = None

    # -- jobs ------------------------------------------------------------------------------------------

    async def wait(self, job: Job | str, *, timeout_s: float | None = None) -> Job:
        """Wait for a job's end, however it ends. See `Client.wait`."""
        return await self._carried_out(waiting(job, self.known, self._timeout_s, timeout_s=timeout_s))

    async def succeeded(self, job: Job | str, *, timeout_s: float | None = None) -> Job:
        """Wait for a job's end. Raises `JobFailed` if it is not success, `TimeoutError` as `wait`."""
        steps = waiting(job, self.known, self._timeout_s, timeout_s=timeout_s, success=True)
        return await self._carried_out(steps)

    def lease(
        self,
        telescope_id: str,
        *,
        ttl_s: float = 30.0,
        on_expiry: str = "stop",
        note: str = "",
        force: bool = False,
    ) -> AsyncLease:
        """Hold a telescope: ``async with client.lease("east"): ...``. See `Client.lease`."""
        return AsyncLease(self, telescope_id, ttl_s, on_expiry, note, force)

    # -- events ----------------------------------------------------------------------------------------

    async def events(
        self,
        *,
        after: str | None = None,
        telescope: str | None = None,
        job: Job | str | None = None,
        patience_s: float = 60.0,
    ) -> AsyncIterator[ServerEvent]:
        """Events as they come, over lost connections too. See `Client.events`."""
        following = Following(after=after, telescope=telescope, job=job, patience_s=patience_s)
        while True:
            failure: httpx.TransportError | None = None
            try:
                async with self._http.stream(
                    "GET", following.path, headers=following.headers, timeout=TIMEOUT
                ) as response:
                    if response.is_error:
                        await response.aread()
                        raise ServiceError(problem_of(response), response.status_code)
                    async for line in response.aiter_lines():
                        event = following.heard(line)
                        if event is not None:
                            yield event
                            if following.over:
                                return
            except httpx.TransportError as broken:
                failure = broken
            await asyncio.sleep(following.broken(failure))
