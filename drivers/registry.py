"""From a URL to a mount, from a name to a fake: the one place that knows which families exist."""

from __future__ import annotations

import importlib
import inspect
import re
import time
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from difflib import get_close_matches
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

from drivers.family import Fakes, Family, MountUrl, UrlParts
from mountnav.clock import utc_now
from mountnav.devices import Camera, Mount, Rotator
from mountnav.errors import BadRequest, BadSettings
from mountnav.parsing import repeated
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from drivers.fakes.faults import Fault
    from drivers.fakes.wire_fake import WireFake
    from mountnav.simulation.mechanics import Machine, Mechanics

__all__ = [
    "GROUP",
    "MountUrl",
    "drivers",
    "fake_dialects",
    "fake_machine",
    "fake_protocols",
    "fakes",
    "families",
    "family",
    "make_fake",
    "open_camera",
    "open_mount",
    "open_rotator",
    "read_url",
]

GROUP = "mountnav.mounts"
"""Entry points of other packages: each is a `Family`, or a function that makes a mount of a `MountUrl`."""

_FAMILIES = {
    "lx200": "drivers.lx200.family:FAMILY",
    "nexstar": "drivers.nexstar.family:NEXSTAR",
    "synscan": "drivers.nexstar.family:SYNSCAN",
    "ioptron": "drivers.ioptron.family:FAMILY",
    "skywatcher": "drivers.skywatcher.family:FAMILY",
    "indi": "drivers.indi.family:FAMILY",
    "alpaca": "drivers.alpaca.family:FAMILY",
}
"""Our own drivers: the name that a URL says, and where its record is. Fakes are listed in this order."""

_EXAMPLE = (
    "lx200+serial:///dev/ttyUSB0?baud=9600, nexstar+tcp://host:port, indi://host:7624/Telescope%20Simulator "
    "or alpaca+http://host:11111/telescope/0"
)


# -- families --------------------------------------------------------------------------------------


def drivers() -> list[str]:
    """List the drivers that a URL may name: our own and those other packages offer."""
    return sorted({*_FAMILIES, *(entry.name for entry in entry_points(group=GROUP))})


def families() -> Iterator[Family]:
    """Go through the records of our own families."""
    return (family(name) for name in _FAMILIES)


def family(name: str) -> Family:
    """Return the record of a driver, our own or another package's.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    if name in _FAMILIES:
        module, _, value = _FAMILIES[name].partition(":")
        own: Family = getattr(importlib.import_module(module), value)
        return own
    for entry in entry_points(group=GROUP, name=name):
        found = entry.load()
        return found if isinstance(found, Family) else Family(name=name, open_mount=_with_site(found))
    raise KeyError(name)


def _is_known(name: str) -> bool:
    # packages are asked only for what isn't ours: reading what is installed takes longer than all else here
    return name in _FAMILIES or name in drivers()


def _with_site(make: Callable[..., Any]) -> Callable[..., Any]:
    """Drivers of others may not want to know where we stand."""
    if len(inspect.signature(make).parameters) < 3:
        return lambda url, name, _site: make(url, name)
    return make


# -- URLs ------------------------------------------------------------------------------------------


def read_url(url: str) -> MountUrl:
    """Take a device's URL apart.

    Raises
    ------
    BadSettings
        If it is none; the advice is the form that was probably meant.
    """
    shown = re.sub(r"(?<=://)[^/]*@", "…@", url)

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
    driver, _, transport = parts.scheme.partition("+")
    if not _is_known(driver):
        raise wrong("names no known driver", _known_drivers(driver, transport, parts))
    spoken = family(driver)
    split = UrlParts(
        shown=shown,
        driver=driver,
        transport=transport,
        address=parts.netloc,
        host=f"[{parts.hostname}]" if parts.hostname and ":" in parts.hostname else parts.hostname,
        port=port,
        path=parts.path,
        options=dict(pairs),
        user=unquote(parts.username or ""),
        password=unquote(parts.password or ""),
    )
    return spoken.read_url(split, spoken)


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
    own = list(families())
    for one in own:
        if driver in one.dialect_names():
            named = f"{one.name}+{transport or 'serial'}://{rest}?dialect={driver}"
            return f"it is a dialect of {one.name}: write {named}; {known}"
    called = {word: one.name for one in own for word in one.also_called}
    meant = called.get(driver) or next(iter(get_close_matches(driver, drivers(), n=1)), None)
    plus = f"+{transport}" if transport else ""
    return f"did you mean {meant}{plus}://{rest}? {known}" if meant else known


# -- devices ---------------------------------------------------------------------------------------


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
    return family(parts.driver).open_mount(parts, name, site)


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
    make = _made_by_some(parts.driver, "cameras", lambda one: one.open_camera)
    return make(parts, name)


def open_rotator(url: str, *, name: str | None = None) -> Rotator:
    """Make a rotator from its URL; it is not connected before its `open`.

    Parameters
    ----------
    url : str
        ``indi://host:port/device`` or ``alpaca+http://host:port/rotator/0``.
    name : str, optional
        For messages; the address by default.

    Raises
    ------
    BadSettings
        If the URL or an option makes no sense.
    """
    parts = read_url(url)
    make = _made_by_some(parts.driver, "rotators", lambda one: one.open_rotator)
    return make(parts, name)


Make = TypeVar("Make")


def _made_by_some(driver: str, what: str, of: Callable[[Family], Make | None]) -> Make:
    """What a family makes besides mounts. Raises `BadSettings` for one that doesn't, with those that do."""
    make = of(family(driver))
    if make is None:
        known = sorted(one.name for one in families() if of(one) is not None)
        raise BadSettings(f"{driver} has no {what}", advice=f"known: {', '.join(known)}")
    return make


# -- fakes -----------------------------------------------------------------------------------------


def fake_protocols() -> list[str]:
    """Protocols that our fakes speak."""
    return [one.name for one in families() if one.fakes is not None]


def fakes(protocol: str) -> Fakes:
    """Return the fakes of a protocol. Raises `BadRequest` if there are none."""
    found = family(protocol).fakes if _is_known(protocol) else None
    if found is None:
        raise BadRequest(
            f"there is no fake that speaks {protocol}", advice=f"there is: {', '.join(fake_protocols())}"
        )
    return found()


def fake_dialects(protocol: str) -> tuple[str, ...]:
    """List the dialects of a protocol, the usual one first. Raises `BadRequest` if there is no such."""
    return fakes(protocol).dialects


def fake_machine(protocol: str) -> Machine:
    """How mounts of a protocol are usually built, as far as their family says. Raises `BadRequest`."""
    from mountnav.simulation.mechanics import Machine

    return fakes(protocol).machine or Machine()


def make_fake(
    protocol: str,
    dialect: str | None,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime] = utc_now,
    monotonic: Callable[[], float] = time.monotonic,
) -> WireFake:
    """Make a fake.

    Parameters
    ----------
    protocol : str
        See `fake_protocols`; another package's family can be named, too.
    dialect : str or None
        See `fake_dialects`; the usual one if None.
    mechanics : Mechanics
        What moves behind it.
    faults : iterable of Fault
        What goes wrong on its line.
    clock, monotonic : callable
        Its own clock (aware UTC), and the seconds of its timers.

    Raises
    ------
    BadRequest
        If there is no such protocol or dialect; with what there is.
    """
    spoken = fakes(protocol)
    if dialect is not None and dialect not in spoken.dialects:
        raise BadRequest(
            f"no fake speaks the {protocol} dialect {dialect}",
            advice=f"there is: {', '.join(spoken.dialects)}",
        )
    return spoken.make(
        dialect or spoken.dialects[0], mechanics, faults=faults, clock=clock, monotonic=monotonic
    )
