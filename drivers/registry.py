"""From a URL to a mount: the one place that knows which drivers exist."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from urllib.parse import parse_qsl, urlsplit

from mountnav.errors import BadSettings
from mountnav.navigation.devices import Mount

GROUP = "mountnav.mounts"
_OWN = {"lx200": "drivers.lx200.opening:mount_from"}
_EXAMPLE = "lx200+serial:///dev/ttyUSB0?baud=9600 or lx200+socket://host:port"


@dataclass(frozen=True, slots=True)
class MountUrl:
    """A mount's URL, taken apart.

    Attributes
    ----------
    driver : str
        Which driver.
    line : str
        What pyserial opens: a device path or ``socket://host:port``.
    options : mapping of str to str
        What stood after ``?``.
    """

    driver: str
    line: str
    options: Mapping[str, str]


def drivers() -> list[str]:
    """List the drivers that a URL may name: our own and those other packages offer."""
    return sorted({*_OWN, *(entry.name for entry in entry_points(group=GROUP))})


def read_url(url: str) -> MountUrl:
    """Take a mount's URL apart.

    Raises
    ------
    BadSettings
        If it is none, with what is allowed.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
        options = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)))
    except ValueError as cause:
        raise BadSettings(f"mount URL {url!r}: {cause}", advice=f"for example {_EXAMPLE}") from cause
    driver, _, transport = parts.scheme.partition("+")
    if driver not in drivers():
        raise BadSettings(
            f"mount URL {url!r} names no known driver",
            advice=f"known: {', '.join(drivers())}; for example {_EXAMPLE}",
        )
    if transport == "serial" and not parts.netloc and parts.path not in ("", "/"):
        return MountUrl(driver, parts.path, options)
    if transport == "socket" and parts.hostname and port and parts.path in ("", "/"):
        host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
        return MountUrl(driver, f"socket://{host}:{port}", options)
    raise BadSettings(
        f"mount URL {url!r} names no line", advice=f"known: serial, socket; for example {_EXAMPLE}"
    )


def open_mount(url: str, *, name: str | None = None) -> Mount:
    """Make a mount from its URL; it is not connected before its `open`.

    Parameters
    ----------
    url : str
        ``driver+serial:///device/path?option=value`` or ``driver+socket://host:port``. Options of
        lx200: ``baud``, ``timeout_s``, ``epoch`` (apparent, icrs), ``poll_s``, ``slew_timeout_s``.
    name : str, optional
        For messages; the address by default.

    Raises
    ------
    BadSettings
        If the URL or an option makes no sense; the advice tells what does.
    """
    parts = read_url(url)
    return _factory(parts.driver)(parts, name)


def _factory(driver: str) -> Callable[[MountUrl, str | None], Mount]:
    if driver in _OWN:
        module, _, function = _OWN[driver].partition(":")
        make: Callable[[MountUrl, str | None], Mount] = getattr(importlib.import_module(module), function)
        return make
    (entry,) = (entry for entry in entry_points(group=GROUP) if entry.name == driver)
    made: Callable[[MountUrl, str | None], Mount] = entry.load()
    return made
