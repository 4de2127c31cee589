"""The hand controls' family (NexStar, SynScan): how such a mount is opened, probed and faked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from drivers.family import Fakes, Family, MountUrl, Probe
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.nexstar.parking import Horizon
    from drivers.wire.exchange import Exchange
    from mountnav.devices import Epoch
    from mountnav.sky.coordinates import Site

_PARK = ("park_az_deg", "park_alt_deg")


def _open_celestron(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    """Make a mount behind a Celestron hand control (NexStar, StarSense), which speaks the equinox of date."""
    return _open(url, name, site, "nexstar", "apparent")


def _open_synscan(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    """Make a mount behind a Sky-Watcher hand control, which speaks J2000."""
    return _open(url, name, site, "synscan", "icrs")


def _open(url: MountUrl, name: str | None, site: Site | None, driver: str, epoch: Epoch) -> GenericMount:
    from drivers.generic.options import read_options
    from drivers.nexstar.language import NexstarLanguage, patience_of

    options = read_options(url.options, driver, baud=9600, timeout_s=8.0, epoch=epoch, own=_PARK)
    link = options.link(url.line, patience_of(options.timeout_s))
    language = NexstarLanguage(link, epoch=options.epoch, park=_park(options.own))
    return options.mount(language, name=name, site=site)


def _park(options: Mapping[str, str]) -> Horizon | None:
    from drivers.nexstar.parking import Horizon

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


async def _probe(exchange: Exchange) -> str:
    """Ask for an echo and a version."""
    from drivers.nexstar.codec import base

    await exchange.ask(base.echo(b"x"))
    version = await exchange.ask(base.VERSION)
    maker = "SynScan" if version.synscan else "NexStar"
    return f"{maker} hand control {version}"


def _celestron_fakes() -> Fakes:
    from drivers.nexstar.fake import CELESTRON_FAKES

    return CELESTRON_FAKES


def _synscan_fakes() -> Fakes:
    from drivers.nexstar.fake import SYNSCAN_FAKES

    return SYNSCAN_FAKES


NEXSTAR = Family(
    name="nexstar",
    open_mount=_open_celestron,
    usual_port=2000,
    also_called=("celestron",),
    # the times are chosen: two tries each, since a byte may be lost on a line that was just opened
    probe=Probe(turn=1, bauds=(9600,), deadline_s=2.5, try_s=1.2, ask=_probe),
    fakes=_celestron_fakes,
)

SYNSCAN = Family(name="synscan", open_mount=_open_synscan, usual_port=11882, fakes=_synscan_fakes)
"""Sky-Watcher's hand controls speak the same words; the probe of `NEXSTAR` finds them, too."""
