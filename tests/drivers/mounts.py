"""Mounts over a line, with times and settings that a test chooses; a URL opens them otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.ioptron.language import ioptron_language
from drivers.lx200.language import lx200_language
from drivers.nexstar.language import nexstar_language
from drivers.skywatcher.language import skywatcher_language
from drivers.wire.line import ByteLine
from drivers.wire.wire_log import WireLog
from mountnav.sky.coordinates import Site


def lx200_mount(
    line: str | Callable[[WireLog], ByteLine],
    *,
    name: str | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    set_clock: bool = False,
    set_site: bool = False,
    trust_on_connect: bool = True,
    **language: Any,
) -> GenericMount:
    """Make an LX200 mount; further arguments as of `lx200_language`."""
    return GenericMount(
        lx200_language(line, **language),
        name=name,
        timing=timing,
        site=site,
        set_clock=set_clock,
        set_site=set_site,
        trust_on_connect=trust_on_connect,
    )


def nexstar_mount(
    line: str | Callable[[], ByteLine],
    *,
    name: str | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    **language: Any,
) -> GenericMount:
    """Make a mount behind a hand control; further arguments as of `nexstar_language`."""
    return GenericMount(nexstar_language(line, **language), name=name, timing=timing, site=site)


def ioptron_mount(
    line: str | Callable[[], ByteLine],
    *,
    name: str | None = None,
    timing: Timing | None = None,
    site: Site | None = None,
    **language: Any,
) -> GenericMount:
    """Make an iOptron mount; further arguments as of `ioptron_language`."""
    return GenericMount(ioptron_language(line, **language), name=name, timing=timing, site=site)


def skywatcher_mount(
    line: str | Callable[[], ByteLine],
    site: Site | None,
    *,
    name: str | None = None,
    timing: Timing | None = None,
    **language: Any,
) -> GenericMount:
    """Make a mount on a motor controller; further arguments as of `skywatcher_language`."""
    return GenericMount(skywatcher_language(line, site, **language), name=name, timing=timing, site=site)
