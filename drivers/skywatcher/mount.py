"""A mount on a Sky-Watcher motor controller: its language over a line of its own, driven like all mounts."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import urlsplit

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.skywatcher.axes import SkywatcherSettings
from drivers.skywatcher.language import SkywatcherLanguage
from drivers.wire.exchange import Patience
from drivers.wire.line import ByteLine, ControlLines, SerialLine, UdpLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.errors import BadSettings
from mountnav.sky.coordinates import Site

BAUD = 9600
"""Of EQDIR cables; mounts with a USB socket speak at 115200 [SKYWATCHER]."""

PATIENCE = Patience(deadline_s=3.0, try_s=0.8, quiet_s=0.05)
"""A real board answers within 17 ms (an owner's 2000 exchanges); datagrams are lost now and then."""


def skywatcher_language(
    line: str | Callable[[], ByteLine],
    site: Site | None,
    *,
    baud: int = BAUD,
    control: ControlLines | None = None,
    patience: Patience = PATIENCE,
    settings: SkywatcherSettings | None = None,
) -> SkywatcherLanguage:
    """Make the language over a line of its own; nothing is opened yet.

    Parameters
    ----------
    line : str or callable
        Device path, ``socket://host:port`` or ``udp://host:port``, or a function that makes a `ByteLine`.
    site : Site
        Where the mount stands.
    baud : int
        Speed of a serial port.
    control : ControlLines, optional
        Of a serial port.
    patience : Patience
        For one question.
    settings : SkywatcherSettings, optional

    Raises
    ------
    BadSettings
        Without a site: the controller knows no sky, so we must know where it stands.
    """
    if site is None:
        raise BadSettings(
            "a Sky-Watcher motor controller knows no sky: its mount can't be driven without a site",
            advice="set latitude and longitude of the telescope",
        )
    log = WireLog()
    return SkywatcherLanguage(Link(_line(line, baud, log, control), patience, log), site, settings)


def _line(
    line: str | Callable[[], ByteLine], baud: int, log: WireLog, control: ControlLines | None
) -> ByteLine:
    if not isinstance(line, str):
        return line()
    parts = urlsplit(line)
    if parts.scheme == "udp" and parts.hostname and parts.port:
        return UdpLine(parts.hostname, parts.port, log=log)
    return SerialLine(line, baud=baud, log=log, control=control)


def skywatcher_mount(
    line: str | Callable[[], ByteLine],
    site: Site | None,
    *,
    name: str | None = None,
    baud: int = BAUD,
    patience: Patience = PATIENCE,
    settings: SkywatcherSettings | None = None,
    timing: Timing | None = None,
) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Parameters
    ----------
    line, site, baud, patience, settings
        As of `skywatcher_language`.
    name : str, optional
        For messages; the address by default.
    timing : Timing, optional

    Raises
    ------
    BadSettings
        Without a site.
    """
    language = skywatcher_language(line, site, baud=baud, patience=patience, settings=settings)
    return GenericMount(language, name=name, timing=timing, site=site)
