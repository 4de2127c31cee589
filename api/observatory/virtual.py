"""A virtual observatory: its time, begun before all else, and told with every answer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, MutableMapping
from contextlib import contextmanager
from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from mountnav.clock import in_virtual_time, utc_now, virtual_time
from mountnav.night.daylight import dark_from
from mountnav.settings.demo import DemoSettings
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Site

HEADER = "Mountnav-Virtual"

_Message = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Message]]
_Send = Callable[[_Message], Awaitable[None]]
_App = Callable[[_Message, _Receive, _Send], Awaitable[None]]


class VirtualView(BaseModel):
    """What tells a virtual observatory from a real one: fake mounts, in a time of its own."""

    model_config = ConfigDict(extra="forbid")

    utc: datetime = Field(description="The virtual present.")
    speed: float = Field(description="Virtual seconds in a second.")


def virtual_view() -> VirtualView | None:
    """Tell of the virtual time that this process lives in; None under the real sky."""
    virtual = virtual_time()
    return None if virtual is None else VirtualView(utc=virtual(), speed=virtual.speed)


def begin_of(demo: DemoSettings, site: Site) -> datetime:
    """When the virtual time begins, aware UTC."""
    if isinstance(demo.at, datetime):
        return demo.at
    return utc_now() if demo.at is None else dark_from(utc_now(), site)


@contextmanager
def virtual_days(demo: DemoSettings, site: Site) -> Iterator[FastClock]:
    """Let this process live in the time that `demo` says; before the service is built, until it has ended.

    Raises
    ------
    BadSettings
        When it lives in a virtual time already.
    """
    clock = FastClock(demo.speed, begin_of(demo, site))
    with in_virtual_time(clock):
        yield clock


class VirtualHeader:
    """ASGI: says with every answer that it is of a virtual observatory; whatever face gives it."""

    def __init__(self, app: _App) -> None:
        self._app = app

    async def __call__(self, scope: _Message, receive: _Receive, send: _Send) -> None:
        """Serve one connection."""

        async def told(message: _Message) -> None:
            if message["type"] == "http.response.start":
                view = virtual_view()
                if view is not None:
                    words = f"utc={view.utc.isoformat(timespec='milliseconds')}, speed={view.speed:g}"
                    message["headers"] = [
                        *message.get("headers", ()),
                        (HEADER.lower().encode(), words.encode("ascii")),
                    ]
            await send(message)

        await self._app(scope, receive, told if scope["type"] == "http" else send)
