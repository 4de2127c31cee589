"""`[alpaca]`, `[indi_server]`, `[lx200_server]`, `[stellarium]`, `[nova]`, `[solver_commands]`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.certificates import require_certificate_files
from mountnav.settings.networks import Network, in_networks, is_everywhere, is_loopback
from mountnav.settings.section import Section


class _HandMotions(Section):
    """How long what a program moves by hand goes on without a further word of it.

    Attributes
    ----------
    move_axis_s : float
        A motion of an axis ends by itself so long after it was ordered, s.
    offset_rates_s : float
        Rates beside the sidereal one end so long after the last order, s; it is put off while the program
        goes on talking.
    """

    move_axis_s: float = Field(default=30.0, gt=0, le=300)
    offset_rates_s: float = Field(default=900.0, ge=1, le=14_400)


class AlpacaSettings(_HandMotions):
    """`[alpaca]`: ASCOM Alpaca, on the service's own HTTP port.

    Attributes
    ----------
    discovery : bool
        Whether programs that look for Alpaca devices find this one; it listens where the service does.
    discovery_port : int
        UDP.
    open : bool
        Whether anyone who reaches the port may operate telescopes through it without a key, though keys are
        configured; else they need one (HTTP Basic, or X-API-Key).
    allow : tuple of str
        With `open`: the addresses and networks that need no key; all if none is named.
    auto_connect : bool
        Whether a telescope that the service has connected counts as connected for every client at once;
        some never ask.
    location : str
        What the management page tells of the place.
    silence_s : float
        An axis that a client moves is stopped when nothing was heard of that client for so long, s.
    move_axis_s, offset_rates_s : float
        Ends of MoveAxis and of the rate offsets: so long one MoveAxis lasts, s; offsets end at most so long
        after the client was last heard, s. How fast an axis may be moved `[telescope.following]` says.
    """

    enabled: bool = True
    discovery: bool = True
    discovery_port: int = Field(default=32227, ge=0, le=65535)
    open: bool = False
    allow: tuple[Network, ...] = Field(default=(), max_length=100)
    auto_connect: bool = True
    location: str = Field(default="", max_length=200)
    silence_s: float = Field(default=5.0, gt=0, le=60)

    def admits(self, address: str) -> bool:
        """Whether a caller from there needs no key."""
        return self.open and (not self.allow or in_networks(address, self.allow))


class _Port(Section):
    """A port of its own; on loopback, unless it is said otherwise."""

    enabled: bool = False
    host: str = "127.0.0.1"
    open: bool = Field(default=False)
    allow: tuple[Network, ...] = Field(default=(), max_length=100)

    def admits(self, address: str) -> bool:
        """Whether a caller from there may come in without a key: this machine may in any case."""
        return in_networks(address, self.allow) or (self.open and not self.allow)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)


class _Door(_Port):
    """A port without keys: anyone who reaches it operates. Only this machine does, unless it is said."""

    @model_validator(mode="after")
    def _wide_is_said(self) -> Self:
        if self.enabled and not self.is_loopback and not self.open and not self.allow:
            raise PydanticCustomError(
                "wide_without_keys",
                "listening on {host} lets every machine that reaches it move the telescope: "
                "this protocol knows no keys",
                {
                    "host": self.host,
                    "key": "host",
                    "fix": 'set host = "127.0.0.1", or name who may come, allow = ["192.168.1.0/24"], or say '
                    "open = true if the whole network is trusted",
                },
            )
        if not self.open and any(is_everywhere(one) for one in self.allow):
            raise PydanticCustomError(
                "everybody_without_keys",
                "allow lets the whole world in, and this protocol knows no keys",
                {"key": "allow", "fix": "name the networks that are meant, or say open = true as well"},
            )
        return self


class IndiServerSettings(_Door, _HandMotions):
    """`[indi_server]`: every telescope as an INDI device.

    Attributes
    ----------
    host, port
        Where it listens; port 0 takes any free one.
    open : bool
        Whether others than this machine may come in, all that reach it unless `allow` names some: the
        protocol knows no keys.
    allow : tuple of str
        Addresses and networks (``192.168.1.17``, ``192.168.1.0/24``) that may come in; this machine may in
        any case.
    move_axis_s, offset_rates_s : float
        Ends of motion keys and custom rates: a key that isn't released ends so long after it was pressed, s;
        custom rates end so long after the client that set them was last heard, s. A client that answers pings
        is heard as long as it lives; others, and those behind an `indiserver`, by what they say themselves.
    silence_s : float
        An axis is stopped when a client that answers pings has answered none for so long, s.
    telescopes : tuple of str
        Those that are shown; all if none is named.
    """

    port: int = Field(default=7624, ge=0, le=65535)
    silence_s: float = Field(default=5.0, gt=0, le=60)
    telescopes: tuple[str, ...] = Field(default=(), max_length=100)


class _OneTelescopesDoor(_Door):
    """A door behind which one telescope stands; `telescope` tells which, the first one if left out."""

    telescope: str | None = None
    read_only: bool = False


class Lx200ServerSettings(_OneTelescopesDoor):
    """`[lx200_server]`: one telescope as an LX200 over TCP, for SkySafari and many apps.

    Attributes
    ----------
    host, port
        Where it listens; port 0 takes any free one.
    open : bool
        Whether others than this machine may come in, all that reach it unless `allow` names some: the
        protocol knows no keys.
    allow : tuple of str
        Addresses and networks (``192.168.1.17``, ``192.168.1.0/24``) that may come in; this machine may in
        any case.
    telescope : str or None
        Which; the first one if left out.
    read_only : bool
        Whether it only tells where the telescope points: gotos, syncs, keys, parks and stops are refused, and
        written down.
    move_axis_s : float
        A key that isn't released ends so long after it was pressed, s.
    silence_s : float
        An axis is stopped when nothing was heard of the app's machine for so long, s: apps ask for the
        position once a second.
    """

    move_axis_s: float = Field(default=30.0, gt=0, le=300)
    silence_s: float = Field(default=4.0, gt=0, le=60)
    port: int = Field(default=4030, ge=0, le=65535)


class StellariumSettings(_OneTelescopesDoor):
    """`[stellarium]`: one telescope by Stellarium's own protocol.

    Attributes
    ----------
    host, port
        Where it listens; port 0 takes any free one.
    open : bool
        Whether others than this machine may come in, all that reach it unless `allow` names some: the
        protocol knows no keys.
    allow : tuple of str
        Addresses and networks (``192.168.1.17``, ``192.168.1.0/24``) that may come in; this machine may in
        any case.
    telescope : str or None
        Which; the first one if left out.
    read_only : bool
        Whether it only tells where the telescope points: gotos, syncs, keys, parks and stops are refused, and
        written down.
    """

    port: int = Field(default=10001, ge=0, le=65535)


class SolverCommandsSettings(Section):
    """`[solver_commands]`: astap, solve-field and so on, as `mountnav solver install` writes them.

    Attributes
    ----------
    enabled : bool
        Whether the service answers them, by a socket that only its own user can reach. It moves nothing.
    """

    enabled: bool = True


class NovaSettings(_Port):
    """`[nova]`: the web API of nova.astrometry.net, for programs that have images solved by it.

    Attributes
    ----------
    host, port
        Where it listens; port 0 takes any free one.
    open : bool
        Whether everybody who reaches the port may have images solved, whatever key he sends. Else a key of
        mountnav's with the role solve (or operate, configure) is needed where there are keys, and where there
        are none, only this machine is served.
    max_upload_mb : float
        Longest upload, MB.
    queue : int
        Uploads at a time, those being received and solved among them; beyond it 429.
    keep_minutes : float
        After so long an upload and all that came of it is forgotten.
    budget_s : float
        Processor time for identifying one image, s; see `[solving] budget_s`.
    tls : {"off", "self", "files"}
        https: with a certificate that mountnav makes itself, or with that of `certificate` and
        `certificate_key`.
    certificate, certificate_key : Path or None
        PEM files.
    """

    port: int = Field(default=8080, ge=0, le=65535)
    max_upload_mb: float = Field(default=128.0, gt=0, le=4096)
    queue: int = Field(default=16, ge=1, le=64)
    keep_minutes: float = Field(default=60.0, gt=0, le=1440)
    budget_s: float = Field(default=30.0, gt=0, le=120)
    tls: Literal["off", "self", "files"] = "off"
    certificate: Path | None = None
    certificate_key: Path | None = None

    @model_validator(mode="after")
    def _files_are_named(self) -> Self:
        require_certificate_files(self.tls, self.certificate, self.certificate_key)
        return self


__all__ = [
    "AlpacaSettings",
    "IndiServerSettings",
    "Lx200ServerSettings",
    "NovaSettings",
    "SolverCommandsSettings",
    "StellariumSettings",
]
