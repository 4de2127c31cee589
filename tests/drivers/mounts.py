"""Mounts over a line, with times and settings that a test chooses; a URL opens them otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.ioptron.language import BAUD, IoptronLanguage
from drivers.lx200.codec.greeting import dialect_named
from drivers.lx200.language import Lx200Language
from drivers.nexstar.language import NexstarLanguage, patience_of
from drivers.skywatcher.language import PATIENCE, SkywatcherLanguage
from drivers.wire.exchange import Patience
from drivers.wire.line import ByteLine
from drivers.wire.link import link_to
from drivers.wire.wire_log import WireLog
from mountnav.sky.coordinates import Site

Line = str | Callable[[WireLog], ByteLine]


def lx200_mount(
    line: Line,
    *,
    name: str | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    set_clock: bool = False,
    set_site: bool = False,
    trust_on_connect: bool = True,
    baud: int = 9600,
    patience: Patience | None = None,
    dialect: str | None = None,
    **language: Any,
) -> GenericMount:
    """Make an LX200 mount; further arguments as of `Lx200Language`."""
    spoken = None if dialect is None else dialect_named(dialect)
    return GenericMount(
        Lx200Language(link_to(line, baud=baud, patience=patience), spoken, **language),
        name=name,
        timing=timing,
        site=site,
        set_clock=set_clock,
        set_site=set_site,
        trust_on_connect=trust_on_connect,
    )


def nexstar_mount(
    line: Line,
    *,
    name: str | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    baud: int = 9600,
    patience: Patience | None = None,
    **language: Any,
) -> GenericMount:
    """Make a mount behind a hand control; further arguments as of `NexstarLanguage`."""
    link = link_to(line, baud=baud, patience=patience or patience_of(8.0))
    return GenericMount(NexstarLanguage(link, **language), name=name, timing=timing, site=site)


def ioptron_mount(
    line: Line,
    *,
    name: str | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    baud: int = BAUD,
    patience: Patience | None = None,
    **language: Any,
) -> GenericMount:
    """Make an iOptron mount; further arguments as of `IoptronLanguage`."""
    link = link_to(line, baud=baud, patience=patience)
    return GenericMount(IoptronLanguage(link, **language), name=name, timing=timing, site=site)


def skywatcher_mount(
    line: Line,
    site: Site,
    *,
    name: str | None = None,
    timing: Timing | None = None,
    baud: int = 9600,
    patience: Patience = PATIENCE,
    **language: Any,
) -> GenericMount:
    """Make a mount on a motor controller; further arguments as of `SkywatcherLanguage`."""
    link = link_to(line, baud=baud, patience=patience)
    return GenericMount(SkywatcherLanguage(link, site, **language), name=name, timing=timing, site=site)
