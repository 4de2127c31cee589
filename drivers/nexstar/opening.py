"""Mounts behind hand controls from their URLs' options: Celestron's and Sky-Watcher's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.nexstar.mount import nexstar_language, patience_of
from drivers.nexstar.parking import Horizon
from mountnav.devices import Epoch
from mountnav.errors import BadSettings
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from drivers.registry import MountUrl

_PARK = ("park_az_deg", "park_alt_deg")


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make a mount behind a Celestron hand control (NexStar, StarSense); nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    return _mount(url, name, site, "nexstar", "apparent")


def synscan_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make a mount behind a SynScan hand control, which speaks J2000; raises as `mount_from` does."""
    return _mount(url, name, site, "synscan", "icrs")


def _mount(url: MountUrl, name: str | None, site: Site | None, driver: str, epoch: Epoch) -> GenericMount:
    options = read_options(url.options, driver, baud=9600, timeout_s=8.0, epoch=epoch, own=_PARK)
    language = nexstar_language(
        url.line,
        baud=options.baud,
        control=options.control,
        epoch=options.epoch,
        patience=options.patience_with(patience_of(options.timeout_s)),
        park=_park(options.own),
    )
    return options.mount(language, name=name, site=site)


def _park(options: Mapping[str, str]) -> Horizon | None:
    if not options:
        return None
    az_deg, alt_deg = (_angle(option, options.get(option)) for option in _PARK)
    if abs(alt_deg) > 90.0:
        raise BadSettings(f"park_alt_deg={alt_deg:g} is beyond the zenith", advice="-90 to 90")
    return Horizon(az_deg % 360.0, alt_deg)


def _angle(option: str, text: str | None) -> float:
    try:
        value = math.nan if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadSettings(
            f"{option}={text} makes no sense", advice="both park_az_deg and park_alt_deg, degrees"
        )
    return value
