"""From a URL to a mount, from a name to a fake: the one place that knows which families exist."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from difflib import get_close_matches
from importlib.metadata import entry_points
from typing import Any, Protocol, cast
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from mountnav.devices import Camera, Mount
from mountnav.errors import BadRequest, BadSettings
from mountnav.parsing import repeated
from mountnav.simulation.mechanics import Machine, Mechanics
from mountnav.sky.coordinates import Site

GROUP = "mountnav.mounts"
_OWN = {
    "alpaca": "drivers.alpaca.family:mount_from",
    "indi": "drivers.indi.family:mount_from",
    "ioptron": "drivers.ioptron.family:mount_from",
    "lx200": "drivers.lx200.family:mount_from",
    "nexstar": "drivers.nexstar.family:mount_from",
    "skywatcher": "drivers.skywatcher.family:mount_from",
    "synscan": "drivers.nexstar.family:synscan_from",
}
_CAMERAS = {"alpaca": "drivers.alpaca.family:camera_from", "indi": "drivers.indi.family:camera_from"}
_SERVERS = {"indi": 7624}
"""Drivers that talk to a server by its host, naming a device there; the port if none is given."""
_WEB = {"http": 11111, "https": 443}
"""Drivers' servers that speak HTTP have these ports if none is given."""
_DATAGRAMS = ("skywatcher",)
_PORTS = {"lx200": 9999, "nexstar": 2000, "synscan": 11882, "ioptron": 8899, "skywatcher": 11880}
"""Ports that are usual for these families' network adapters: for advice only."""
_MAKERS = {
    "meade": "lx200",
    "autostar": "lx200",
    "losmandy": "lx200",
    "zwo": "lx200",
    "am3": "lx200",
    "tenmicron": "lx200",
    "astrophysics": "lx200",
    "celestron": "nexstar",
    "eqmod": "skywatcher",
    "eqdir": "skywatcher",
    "ascom": "alpaca",
}
"""What people call a driver by."""
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
        If it is none; the advice is the form that was probably meant.
    """
    shown = _without_password(url)

    def wrong(what: str, advice: str) -> BadSettings:
        return BadSettings(f"mount URL {shown!r} {what}", advice=advice)

    if "://" not in url:
        raise wrong("names no driver", f"write {_guessed(url)}; for example {_EXAMPLE}")
    if any(byte.isspace() or not byte.isprintable() for byte in url):
        raise wrong("has blanks or invisible characters in it", "write %20 for a blank in a name")
    try:
        parts = urlsplit(url)
        port = parts.port
        pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as cause:
        raise wrong(f"can't be read: {cause}", f"for example {_EXAMPLE}") from cause
    if twice := sorted(repeated(name for name, _ in pairs)):
        raise wrong(f"says {', '.join(twice)} more than once", "say each option once")
    if parts.fragment or url.endswith("#"):
        raise wrong("has a # in it", "write %23 for a # in a name")
    if port == 0:
        raise wrong("names port 0", "ports are from 1 to 65535")
    options = dict(pairs)
    driver, _, transport = parts.scheme.partition("+")
    # packages are asked only for what isn't ours: reading what is installed takes longer than all else here
    if driver not in _OWN and driver not in drivers():
        raise wrong("names no known driver", _known_drivers(driver, transport, parts))
    host = f"[{parts.hostname}]" if parts.hostname and ":" in parts.hostname else parts.hostname
    if driver == "alpaca":
        return _alpaca_url(url, transport, host, port, options)
    if "@" in parts.netloc:
        raise wrong("has a user or a password in it", f"{driver} takes none: leave out what stands before @")
    bare = parts.path in ("", "/")
    if driver in _SERVERS:
        usual = _SERVERS[driver]
        if not transport and host and not bare:
            return MountUrl(driver, f"{host}:{port or usual}", options, unquote(parts.path.lstrip("/")))
        device = parts.path if not bare else "/Telescope%20Simulator"
        raise wrong(
            "names no device of a server", f"write {driver}://{host or 'host'}:{port or usual}{device}"
        )
    if transport == "serial" and not parts.netloc and not bare:
        return MountUrl(driver, parts.path, options)
    datagrams = transport == "udp" and driver in _DATAGRAMS
    if (transport in ("tcp", "socket") or datagrams) and host and port and bare:
        of_ports = sorted({"dtr", "rts"} & set(options))
        if of_ports:
            raise wrong(f"says {', '.join(of_ports)}", "that is of serial ports: leave it out")
        return MountUrl(driver, f"{'udp' if datagrams else 'socket'}://{host}:{port}", options)
    raise wrong(*_no_line(driver, transport, parts))


def _guessed(url: str) -> str:
    """The URL that somebody meant who gave a path, or a host and a port."""
    if re.fullmatch(r"[^/?]+:[0-9]+", url):
        return f"lx200+tcp://{url}"
    path = re.sub(r"^[a-z0-9+]+:", "", url)
    return (
        f"lx200+serial://{path}"
        if path.startswith("/")
        else "driver+serial:///dev/... or driver+tcp://host:port"
    )


def _known_drivers(driver: str, transport: str, parts: SplitResult) -> str:
    """What to write instead of a driver that there isn't."""
    known = f"known: {', '.join(drivers())}; for example {_EXAMPLE}"
    if driver == "fake":
        return (
            "the service alone starts fake mounts by their URL: start `mountnav fake-mount` and name its port"
        )
    rest = f"{parts.netloc}{parts.path}"
    # by its name, as the drivers: this room knows which there are, and they don't know each other
    if driver in _loaded("drivers.lx200.dialects:names")():
        named = f"lx200+{transport or 'serial'}://{rest}?dialect={driver}"
        return f"it is a dialect of lx200: write {named}; {known}"
    meant = _MAKERS.get(driver) or next(iter(get_close_matches(driver, drivers(), n=1)), None)
    plus = f"+{transport}" if transport else ""
    return f"did you mean {meant}{plus}://{rest}? {known}" if meant else known


def _no_line(driver: str, transport: str, parts: SplitResult) -> tuple[str, str]:
    """What is wrong with a URL that names no line, and what to write."""
    path, bare, host = parts.path, parts.path in ("", "/"), parts.netloc
    lines = f"known for {driver}: serial, socket, tcp{', udp' * (driver in _DATAGRAMS)}"
    if transport == "serial" and host:
        slashes = f"write three slashes: {driver}+serial:///{host}{path}; {lines}"
        return "names a host instead of a serial port", slashes
    if transport == "serial":
        return "names no serial port", f"write {driver}+serial:///dev/ttyUSB0; `mountnav ports` lists them"
    if transport in ("tcp", "socket") or (transport == "udp" and driver in _DATAGRAMS):
        usual = _PORTS.get(driver, 4030) if transport != "udp" else 11880
        if parts.hostname is None:
            return "names no host", f"write {driver}+{transport}://192.168.0.20:{parts.port or usual}"
        if not bare:
            return "has a path after its host", f"write {driver}+{transport}://{host}"
        # the port is wanted: which one differs between mounts
        return "names no port of its host", f"write {driver}+{transport}://{host}:{usual}, or the port it has"
    meant = f"{driver}+tcp://{host or 'host:port'}" if host else f"{driver}+serial://{path or '/dev/ttyUSB0'}"
    if not transport:
        return "doesn't say over which line", f"write {meant}; {lines}"
    return f"names the line {transport}", f"{lines}; write {meant}"


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
        Options of all: see `drivers.generic.options`.
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


_FAKES = {
    "lx200": "drivers.lx200.family",
    "nexstar": "drivers.nexstar.family",
    "synscan": "drivers.nexstar.faking_synscan",
    "ioptron": "drivers.ioptron.family",
    "skywatcher": "drivers.skywatcher.family",
}


class Faking(Protocol):
    """What the module `faking` of a family offers."""

    DIALECTS: tuple[str, ...]
    """What its fakes can speak; the first is usual. A `MACHINE` beside it tells how such mounts are built."""

    def fake_from(
        self,
        dialect: str | None,
        mechanics: Mechanics,
        faults: Iterable[Fault],
        clock: Callable[[], datetime],
        monotonic: Callable[[], float],
    ) -> WireFake:
        """Make a fake."""
        ...


def fake_protocols() -> list[str]:
    """Protocols that fakes speak."""
    return list(_FAKES)


def fake_dialects(protocol: str) -> tuple[str, ...]:
    """List the dialects of a protocol, the usual one first. Raises `BadRequest` if there is no such."""
    return _faking(protocol).DIALECTS


def fake_machine(protocol: str) -> Machine:
    """How mounts of a protocol are usually built, as far as their family says. Raises `BadRequest`."""
    built: Machine = getattr(_faking(protocol), "MACHINE", Machine())
    return built


def make_fake(
    protocol: str,
    dialect: str | None,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> WireFake:
    """Make a fake.

    Parameters
    ----------
    protocol : str
        See `protocols`.
    dialect : str or None
        See `dialects`; the usual one if None.
    mechanics : Mechanics
        What moves behind it.
    faults : iterable of Fault
    clock, monotonic : callable
        Its own clock (aware UTC), and the seconds of its timers.

    Raises
    ------
    BadRequest
        If there is no such protocol or dialect; with what there is.
    """
    faking = _faking(protocol)
    if dialect is not None and dialect not in faking.DIALECTS:
        raise BadRequest(
            f"no fake speaks the {protocol} dialect {dialect}",
            advice=f"there is: {', '.join(faking.DIALECTS)}",
        )
    return faking.fake_from(dialect, mechanics, faults, clock, monotonic)


def _faking(protocol: str) -> Faking:
    if protocol not in _FAKES:
        raise BadRequest(f"there is no fake that speaks {protocol}", advice=f"there is: {', '.join(_FAKES)}")
    return cast("Faking", importlib.import_module(_FAKES[protocol]))
