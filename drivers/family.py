"""What a family of mounts declares of itself: how its URLs read, how it is opened, probed and faked.

A family is a folder of `drivers` whose module `family` holds one `Family` record for each driver that a URL
may name, and one line in `drivers.registry`; see docs/how-to/add-a-mount-family.md. The registry reads also
the records of families that nobody opens, to list them. So a module `family` imports next to nothing: its
functions import what they need when they are called.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from datetime import datetime

    from drivers.fakes.faults import Fault
    from drivers.fakes.wire_fake import WireFake
    from drivers.wire.exchange import Exchange
    from mountnav.devices import Camera, Mount, Rotator
    from mountnav.simulation.machine import Machine
    from mountnav.simulation.mechanics import Mechanics
    from mountnav.sky.coordinates import Site


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


@dataclass(frozen=True, slots=True)
class UrlParts:
    """A device's URL as `drivers.registry.read_url` splits it, before its family reads it.

    Attributes
    ----------
    shown : str
        The whole URL for messages, without a password.
    transport : str
        What follows ``+`` in the scheme: ``serial``, ``tcp``, ``http``; empty if there is none.
    address : str
        All between ``//`` and the path.
    host : str or None
        An IPv6 address is in brackets.
    """

    shown: str
    driver: str
    transport: str
    address: str
    host: str | None
    port: int | None
    path: str
    options: Mapping[str, str]
    user: str = ""
    password: str = field(default="", repr=False)

    @property
    def bare(self) -> bool:
        """Whether it has no path."""
        return self.path in ("", "/")

    def wrong(self, what: str, advice: str) -> BadSettings:
        """Make the error that refuses this URL."""
        return BadSettings(f"mount URL {self.shown!r} {what}", advice=advice)

    def require_no_user(self) -> None:
        """Refuse a user or a password in a URL whose family takes none; raises `BadSettings`."""
        if "@" in self.address:
            raise self.wrong(
                "has a user or a password in it", f"{self.driver} takes none: leave out what stands before @"
            )


@dataclass(frozen=True, slots=True)
class Probe:
    """How to find out whether a mount of a family answers on a line, by questions that change nothing.

    Attributes
    ----------
    turn : int
        Families are asked in this order, the smallest first. Hand controls come first: they obey single
        letters, so that the others' greetings would mean orders to them (the M of ``:MountInfo#`` cancels a
        goto, its I begins to set the clock).
    bauds : tuple of int
        Usual speeds of a serial port, tried in this order.
    deadline_s, try_s : float
        For one question in all, and until it is asked again.
    ask : callable (Exchange) -> awaitable str
        Asks; what answers in words. An answer that is missing or makes no sense means that it is another
        mount: let its `DeviceError` pass.
    """

    turn: int
    bauds: tuple[int, ...]
    deadline_s: float
    try_s: float
    ask: Callable[[Exchange], Awaitable[str]]


class MakeFake(Protocol):
    """Makes a fake of one of a family's dialects over the mechanics of a telescope."""

    def __call__(
        self,
        dialect: str,
        mechanics: Mechanics,
        *,
        faults: Iterable[Fault],
        clock: Callable[[], datetime],
        monotonic: Callable[[], float],
    ) -> WireFake:
        """Make it; `dialect` is one of the family's."""
        ...


@dataclass(frozen=True, slots=True)
class Fakes:
    """The fakes of a family.

    Attributes
    ----------
    dialects : tuple of str
        What they can speak; the first is usual.
    make : callable
        See `MakeFake`.
    moves : tuple of bytes
        Beginnings of commands that move or sync: a driver sends each once for one order.
    stops : tuple of bytes
        Beginnings of commands that stop a motion.
    machine : Machine, optional
        How such mounts are usually built; the simulation's default if None.
    """

    dialects: tuple[str, ...]
    make: MakeFake
    moves: tuple[bytes, ...]
    stops: tuple[bytes, ...]
    machine: Machine | None = None


def read_line_url(parts: UrlParts, family: Family) -> MountUrl:
    """Read a URL that names a line: ``driver+serial:///path``, ``driver+tcp://host:port``, some ``+udp``.

    Raises
    ------
    BadSettings
        If it names none; the advice is the form that was probably meant.
    """
    parts.require_no_user()
    if parts.transport == "serial" and not parts.address and not parts.bare:
        return MountUrl(parts.driver, parts.path, parts.options)
    datagrams = parts.transport == "udp" and family.takes_datagrams
    if (parts.transport in ("tcp", "socket") or datagrams) and parts.host and parts.port and parts.bare:
        of_ports = sorted({"dtr", "rts"} & set(parts.options))
        if of_ports:
            raise parts.wrong(f"says {', '.join(of_ports)}", "that is of serial ports: leave it out")
        scheme = "udp" if datagrams else "socket"
        return MountUrl(parts.driver, f"{scheme}://{parts.host}:{parts.port}", parts.options)
    raise parts.wrong(*_no_line(parts, family))


def _no_line(parts: UrlParts, family: Family) -> tuple[str, str]:
    """What is wrong with a URL that names no line, and what to write."""
    driver, transport, path, address = parts.driver, parts.transport, parts.path, parts.address
    lines = f"known for {driver}: serial, socket, tcp{', udp' * family.takes_datagrams}"
    if transport == "serial" and address:
        slashes = f"write three slashes: {driver}+serial:///{address}{path}; {lines}"
        return "names a host instead of a serial port", slashes
    if transport == "serial":
        return "names no serial port", f"write {driver}+serial:///dev/ttyUSB0; `mountnav ports` lists them"
    if transport in ("tcp", "socket") or (transport == "udp" and family.takes_datagrams):
        usual = family.usual_port
        if parts.host is None:
            return "names no host", f"write {driver}+{transport}://192.168.0.20:{parts.port or usual}"
        if not parts.bare:
            return "has a path after its host", f"write {driver}+{transport}://{address}"
        # the port is wanted: which one differs between mounts
        advice = f"write {driver}+{transport}://{address}:{usual}, or the port it has"
        return "names no port of its host", advice
    meant = (
        f"{driver}+tcp://{address or 'host:port'}"
        if address
        else f"{driver}+serial://{path or '/dev/ttyUSB0'}"
    )
    if not transport:
        return "doesn't say which line to use", f"write {meant}; {lines}"
    return f"names the line {transport}", f"{lines}; write {meant}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """One driver that a URL may name.

    Attributes
    ----------
    name : str
        As in URLs, before ``+`` or ``:``.
    open_mount : callable (MountUrl, name, Site or None) -> Mount
        Makes the mount; nothing is opened yet. Raises `BadSettings` for an option that makes no sense.
    open_camera : callable (MountUrl, name) -> Camera, optional
        Likewise, where the protocol has cameras.
    open_rotator : callable (MountUrl, name) -> Rotator, optional
        Likewise, where the protocol has rotators.
    read_url : callable (UrlParts, Family) -> MountUrl
        How its URLs are read.
    usual_port : int
        Of its network adapters, or of its server. For lines it is for advice only. 4030 is what most
        LX200 adapters and programs listen on.
    takes_datagrams : bool
        Whether it can be reached over UDP, too.
    also_called : tuple of str
        What people call it by in a URL, for advice: makers, products, other programs' names of it.
    dialect_names : callable () -> collection of str
        What ``?dialect=`` may say, where people write that for the driver's name.
    probe : Probe, optional
        None: its mounts can't be found by asking.
    fakes : callable () -> Fakes, optional
        Imports the fakes when it is called.
    """

    name: str
    open_mount: Callable[[MountUrl, str | None, Site | None], Mount]
    open_camera: Callable[[MountUrl, str | None], Camera] | None = None
    open_rotator: Callable[[MountUrl, str | None], Rotator] | None = None
    read_url: Callable[[UrlParts, Family], MountUrl] = read_line_url
    usual_port: int = 4030
    takes_datagrams: bool = False
    also_called: tuple[str, ...] = ()
    dialect_names: Callable[[], Collection[str]] = tuple
    probe: Probe | None = None
    fakes: Callable[[], Fakes] | None = None
