"""`Client` and `AsyncClient`: the service's HTTP API as calls, with leases kept by heartbeats.

`Client` blocks, `AsyncClient` is awaited; both have the same calls, declared once by the functions that make
their requests. A lease is acquired, kept by heartbeats in the background, and released at the end.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from types import TracebackType
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar, overload

import httpx

from mountnav.client import requests
from mountnav.client.failures import ServiceError
from mountnav.client.requests import Request
from mountnav.client.results import Job, LeaseState
from mountnav.client.sending import Known, Send, Steps, problem_of, sending, settings, waiting
from mountnav.client.stream import TIMEOUT, Following, ServerEvent
from mountnav.tasks import begun, fault_words

__all__ = ["Call", "Calls"]


T = TypeVar("T")
P = ParamSpec("P")


class Call(Generic[P, T]):
    """A method that carries out the requests that a function makes, as its client does.

    Parameters
    ----------
    make : callable
        One of `mountnav.client.requests`.
    """

    def __init__(self, make: Callable[P, Request[T]]) -> None:
        self._make = make

        @functools.wraps(make)
        def of_a_client(client: Any, /, *args: P.args, **kwargs: P.kwargs) -> object:
            return client.do(make(*args, **kwargs))

        self._of_a_client = of_a_client

    @overload
    def __get__(self, client: None, owner: type[object]) -> Callable[Concatenate[Any, P], object]: ...
    @overload
    def __get__(self, client: Client, owner: type[object]) -> Callable[P, T]: ...
    @overload
    def __get__(self, client: AsyncClient, owner: type[object]) -> Callable[P, Coroutine[Any, Any, T]]: ...
    def __get__(self, client: Client | AsyncClient | None, owner: type[object]) -> object:
        if client is None:
            return self._of_a_client
        carry_out = client.do

        @functools.wraps(self._make)
        def call(*args: P.args, **kwargs: P.kwargs) -> object:
            return carry_out(self._make(*args, **kwargs))

        return call


class Calls:
    """Questions and orders: what each asks and answers stands in `mountnav.client.requests`."""

    telescopes = Call(requests.telescopes)
    telescope = Call(requests.telescope)
    jobs = Call(requests.jobs)
    job = Call(requests.job)
    objects = Call(requests.objects)
    forecast = Call(requests.forecast)
    capabilities = Call(requests.capabilities)
    health = Call(requests.health)
    lease_state = Call(requests.lease_state)
    order = Call(requests.order)
    slew = Call(requests.slew)
    center = Call(requests.center)
    look = Call(requests.look)
    recover = Call(requests.recover)
    first_light = Call(requests.first_light)
    follow = Call(requests.follow)
    move_axis = Call(requests.move_axis)
    offset_rates = Call(requests.offset_rates)
    park = Call(requests.park)
    unpark = Call(requests.unpark)
    cancel = Call(requests.cancel)
    next_panel = Call(requests.next_panel)
    stop = Call(requests.stop)
    stop_all = Call(requests.stop_all)
    reload = Call(requests.reload)


_BEATS = 4
"""So often a lease is kept within the time it lasts."""
_GONE = (401, 403, 404, 409)
"""Answers to a heartbeat after which there is nothing left to keep."""


class _Held:
    """What both kinds of lease are: how they are asked for, and what has become of them."""

    def __init__(self, telescope_id: str, ttl_s: float, on_expiry: str, note: str, force: bool) -> None:
        self.telescope_id = telescope_id
        self.ttl_s = ttl_s
        self.lost: ServiceError | None = None
        """Why it is not held any more, as the service said to a heartbeat; None as long as it is."""
        self.silent: httpx.TransportError | None = None
        """Why the last heartbeat had no answer; None if it had one."""
        self._secret = ""
        self._asked = requests.take_lease(
            telescope_id, ttl_s=ttl_s, on_expiry=on_expiry, note=note, force=force
        )

    @property
    def held(self) -> bool:
        """Whether it was held when the service last answered; not before it is taken and after it ends."""
        return bool(self._secret) and self.lost is None

    def _taken(self, state: LeaseState, known: Known) -> None:
        self.lost = self.silent = None
        self._secret = known.leases[self.telescope_id] = state["lease"]

    def _given_back(self, known: Known) -> Request[LeaseState] | None:
        """Carry it no more; what the service has to be told, if it still holds it."""
        known.leases.pop(self.telescope_id, None)
        secret, self._secret = self._secret, ""
        return None if self.lost is not None else requests.release_lease(self.telescope_id, secret)

    def _heard(self, failure: ServiceError | httpx.TransportError | None) -> None:
        """Take in what came of a heartbeat."""
        if failure is None:
            self.silent = None
        elif isinstance(failure, httpx.TransportError):
            self.silent = failure
        elif failure.status in _GONE:
            self.lost = failure

    def require(self) -> None:
        """Raise what the service said, if the lease is lost: before anything that counts on it."""
        if self.lost is not None:
            raise self.lost


class Lease(_Held):
    """A telescope in the hands of this program; a context. Orders of its client carry it by themselves.

    A thread sends the heartbeats. When the program dies, the service does what `on_expiry` says.
    """

    def __init__(
        self, client: Client, telescope_id: str, ttl_s: float, on_expiry: str, note: str, force: bool
    ) -> None:
        super().__init__(telescope_id, ttl_s, on_expiry, note, force)
        self._client = client
        self._ended = threading.Event()
        self._beating: threading.Thread | None = None

    def __enter__(self) -> Self:
        """Take it. Raises `ServiceError` ``leased`` if somebody else holds it."""
        self._taken(self._client.do(self._asked), self._client.known)
        self._ended.clear()
        self._beating = threading.Thread(target=self._beat, name=f"lease-{self.telescope_id}", daemon=True)
        self._beating.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it back; what runs goes on."""
        self._ended.set()
        if self._beating is not None:
            self._beating.join()
        release = self._given_back(self._client.known)
        if release is not None:
            with contextlib.suppress(ServiceError, httpx.TransportError):
                # if that fails it runs out by itself
                self._client.do(release)

    def _beat(self) -> None:
        while self.lost is None and not self._ended.wait(self.ttl_s / _BEATS):
            try:
                self._client.do(requests.keep_lease(self.telescope_id, self._secret))
                self._heard(None)
            except (ServiceError, httpx.TransportError) as failure:
                self._heard(failure)


class AsyncLease(_Held):
    """As `Lease`, for an `AsyncClient`; a task sends the heartbeats."""

    def __init__(
        self, client: AsyncClient, telescope_id: str, ttl_s: float, on_expiry: str, note: str, force: bool
    ) -> None:
        super().__init__(telescope_id, ttl_s, on_expiry, note, force)
        self._client = client
        self._beating: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        """Take it. Raises `ServiceError` ``leased`` if somebody else holds it."""
        self._taken(await self._client.do(self._asked), self._client.known)
        self._beating = begun(self._beat(), f"lease-{self.telescope_id}", died=self._died)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it back; what runs goes on."""
        if self._beating is not None:
            self._beating.cancel()
            # not `await`: that the program itself is cancelled meanwhile must not be taken for the end of it
            await asyncio.wait({self._beating})
        release = self._given_back(self._client.known)
        if release is not None:
            with contextlib.suppress(ServiceError, httpx.TransportError):
                # if that fails it runs out by itself
                await self._client.do(release)

    def _died(self, fault: Exception) -> None:
        """No heartbeat goes out any more: it will run out."""
        self.lost = ServiceError({"title": "no heartbeats", "detail": fault_words(fault)}, 0)

    async def _beat(self) -> None:
        while self.lost is None:
            await asyncio.sleep(self.ttl_s / _BEATS)
            try:
                await self._client.do(requests.keep_lease(self.telescope_id, self._secret))
                self._heard(None)
            except (ServiceError, httpx.TransportError) as failure:
                self._heard(failure)


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
            Id of the telescope, as the settings name it.
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
