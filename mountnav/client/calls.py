"""The calls that both clients have, by the functions that make their requests; at once, or to be awaited."""

from __future__ import annotations

import functools
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any, Concatenate, Generic, ParamSpec, TypeVar, overload

from mountnav.client import requests
from mountnav.client.requests import Request

if TYPE_CHECKING:
    from mountnav.client.async_client import AsyncClient
    from mountnav.client.client import Client

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
    capabilities = Call(requests.capabilities)
    health = Call(requests.health)
    lease_state = Call(requests.lease_state)
    order = Call(requests.order)
    slew = Call(requests.slew)
    center = Call(requests.center)
    look = Call(requests.look)
    recover = Call(requests.recover)
    first_light = Call(requests.first_light)
    park = Call(requests.park)
    unpark = Call(requests.unpark)
    cancel = Call(requests.cancel)
    stop = Call(requests.stop)
    stop_all = Call(requests.stop_all)


__all__ = ["Call", "Calls"]
