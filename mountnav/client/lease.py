"""Leases held by a program: taken, kept by heartbeats in the background, given back at the end."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Self

import httpx

from mountnav.client import requests
from mountnav.client.failures import ServiceError
from mountnav.client.requests import Request
from mountnav.client.results import LeaseState
from mountnav.client.sending import Known
from mountnav.tasks import begun, fault_words

if TYPE_CHECKING:
    from mountnav.client.async_client import AsyncClient
    from mountnav.client.client import Client

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
