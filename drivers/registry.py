"""From a URL to a mount: the one place that knows which drivers exist."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from mountnav.errors import BadSettings
from mountnav.navigation.devices import Camera, Mount
from mountnav.sky.coordinates import Site

GROUP = "mountnav.mounts"
_OWN = {
    "alpaca": "drivers.alpaca.opening:mount_from",
    "indi": "drivers.indi.opening:mount_from",
    "ioptron": "drivers.ioptron.opening:mount_from",
    "lx200": "drivers.lx200.opening:mount_from",
    "nexstar": "drivers.nexstar.opening:mount_from",
    "skywatcher": "drivers.skywatcher.opening:mount_from",
    "synscan": "drivers.nexstar.opening:synscan_from",
}
_CAMERAS = {"alpaca": "drivers.alpaca.opening:camera_from", "indi": "drivers.indi.opening:camera_from"}
_SERVERS = {"indi": 7624}
"""Drivers that talk to a server by its host, naming a device there; the port if none is given."""
_WEB = {"http": 11111, "https": 443}
"""Drivers' servers that speak HTTP have these ports if none is given."""
_DATAGRAMS = ("skywatcher",)
_EXAMPLE = (
    "lx200+serial:///dev/ttyUSB0?baud=9600, nexstar+tcp://host:port, indi://host:7624/Telescope%20Simulator "
    "or alpaca+http://host:11111/telescope/0"
)


@dataclass(frozen=True, slots=True)
class MountUrl:
    """A device's URL, taken apart.

    Attributes
    ----------
    driver : str
        Which driver.
    line : str
        What a line opens: a device path, ``socket://host:port`` or ``udp://host:port``; of a server
        ``host:port``, of one that speaks HTTP ``http://host:port``.
    options : mapping of str to str
        What stood after ``?``.
    device : str
        Of a server: which of its devices.
    user, password : str
        Of a server that speaks HTTP and wants to know who we are.
    """

    driver: str
    line: str
    options: Mapping[str, str]
    device: str = ""
    user: str = ""
    password: str = field(default="", repr=False)


def drivers() -> list[str]:
    """List the drivers that a URL may name: our own and those other packages offer."""
    return sorted({*_OWN, *(entry.name for entry in entry_points(group=GROUP))})


def read_url(url: str) -> MountUrl:
    """Take a device's URL apart.

    Raises
    ------
    BadSettings
        If it is none, with what is allowed.
    """
    shown = _without_password(url)
    try:
        parts = urlsplit(url)
        port = parts.port
        options = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)))
    except ValueError as cause:
        raise BadSettings(f"mount URL {shown!r}: {cause}", advice=f"for example {_EXAMPLE}") from cause
    driver, _, transport = parts.scheme.partition("+")
    if driver not in drivers():
        raise BadSettings(
            f"mount URL {shown!r} names no known driver",
            advice=f"known: {', '.join(drivers())}; for example {_EXAMPLE}",
        )
    bare = parts.path in ("", "/")
    host = f"[{parts.hostname}]" if parts.hostname and ":" in parts.hostname else parts.hostname
    if driver == "alpaca":
        return _alpaca_url(url, transport, host, port, options)
    if driver in _SERVERS:
        if not transport and host and not bare:
            line = f"{host}:{port or _SERVERS[driver]}"
            return MountUrl(driver, line, options, unquote(parts.path.lstrip("/")))
        raise BadSettings(
            f"mount URL {shown!r} names no device of a server",
            advice=f"for example {driver}://host:{_SERVERS[driver]}/Telescope%20Simulator",
        )
    if transport == "serial" and not parts.netloc and not bare:
        return MountUrl(driver, parts.path, options)
    if transport in ("tcp", "socket") and host and port and bare:
        return MountUrl(driver, f"socket://{host}:{port}", options)
    if transport == "udp" and host and port and bare and driver in _DATAGRAMS:
        return MountUrl(driver, f"udp://{host}:{port}", options)
    known = "serial, socket, tcp" + ", udp" * (driver in _DATAGRAMS)
    raise BadSettings(
        f"mount URL {shown!r} names no line", advice=f"known for {driver}: {known}; for example {_EXAMPLE}"
    )


def _alpaca_url(
    url: str, transport: str, host: str | None, port: int | None, options: Mapping[str, str]
) -> MountUrl:
    parts = urlsplit(url)
    if transport in _WEB and host and re.fullmatch(r"/(telescope|camera)/[0-9]{1,9}", parts.path):
        line = f"{transport}://{host}:{port or _WEB[transport]}"
        user, password = unquote(parts.username or ""), unquote(parts.password or "")
        return MountUrl("alpaca", line, options, parts.path[1:], user, password)
    raise BadSettings(
        f"URL {_without_password(url)!r} names no device of an Alpaca server",
        advice="for example alpaca+http://host:11111/telescope/0, alpaca+https://user:password@host/camera/0",
    )


def _without_password(url: str) -> str:
    """For messages."""
    return re.sub(r"(?<=://)[^/]*@", "…@", url)


def open_mount(url: str, *, name: str | None = None, site: Site | None = None) -> Mount:
    """Make a mount from its URL; it is not connected before its `open`.

    Parameters
    ----------
    url : str
        ``driver+serial:///device/path?option=value``, ``driver+tcp://host:port``,
        ``indi://host:port/device`` or ``alpaca+http://user:password@host:port/telescope/0``.
        Options of all: see `drivers.mount_options`.
    name : str, optional
        For messages; the address by default.
    site : Site, optional
        Ours, to be compared with the mount's; mounts that know no sky can't do without.

    Raises
    ------
    BadSettings
        If the URL or an option makes no sense; the advice tells what does.
    """
    parts = read_url(url)
    made: Mount = _factory(parts.driver)(parts, name, site)
    return made


def open_camera(url: str, *, name: str | None = None) -> Camera:
    """Make a camera from its URL; it is not connected before its `open`.

    Parameters
    ----------
    url : str
        ``indi://host:port/device`` or ``alpaca+http://host:port/camera/0``.
    name : str, optional
        For messages; the address by default.

    Raises
    ------
    BadSettings
        If the URL or an option makes no sense.
    """
    parts = read_url(url)
    if parts.driver not in _CAMERAS:
        raise BadSettings(f"{parts.driver} has no cameras", advice=f"known: {', '.join(_CAMERAS)}")
    made: Camera = _loaded(_CAMERAS[parts.driver])(parts, name)
    return made


def _factory(driver: str) -> Callable[..., Any]:
    if driver in _OWN:
        make = _loaded(_OWN[driver])
    else:
        (entry,) = (entry for entry in entry_points(group=GROUP) if entry.name == driver)
        make = entry.load()
    # drivers of others may not want to know where we stand
    if len(inspect.signature(make).parameters) < 3:
        return lambda url, name, _site: make(url, name)
    return make


def _loaded(dotted: str) -> Callable[..., Any]:
    module, _, function = dotted.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return found
