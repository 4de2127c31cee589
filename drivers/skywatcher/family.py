"""The Sky-Watcher motor controllers' family: how such a mount is opened, probed and faked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from drivers.family import Fakes, Family, MountUrl, Probe
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.skywatcher.axes import SkywatcherSettings
    from drivers.wire.exchange import Exchange
    from mountnav.sky.coordinates import Site

_RANGES = {
    "past_meridian_deg": (0.0, 30.0),
    "tracking_past_deg": (0.0, 60.0),
    "lowest_altitude_deg": (-90.0, 89.0),
    "guide_rate": (0.05, 0.95),
    "goto_deg_s": (0.1, 30.0),
    "goto_deg_s2": (0.1, 60.0),
}
"""What the own options of its URL may be: the smallest and the largest value of each."""


def _open_mount(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    from drivers.generic.options import read_options
    from drivers.skywatcher.language import BAUD, PATIENCE, SkywatcherLanguage
    from drivers.wire.exchange import Patience

    options = read_options(url.options, "skywatcher", baud=BAUD, timeout_s=PATIENCE.deadline_s, own=_RANGES)
    if options.epoch != "apparent":
        raise BadSettings(
            "epoch=icrs makes no sense for skywatcher", advice="leave it out: its position is computed here"
        )
    if options.set_clock or options.set_site:
        raise BadSettings(
            "set_clock and set_site make no sense for skywatcher", advice="it has neither clock nor site"
        )
    timeout_s = options.timeout_s
    patience = Patience(timeout_s, min(PATIENCE.try_s, timeout_s), PATIENCE.quiet_s)
    settings = _settings(options.own, settle_s=2.0 * options.timing.poll_s + 0.2)
    if site is None:
        raise BadSettings(
            "a Sky-Watcher motor controller has no coordinates of its own: its "
            "mount can't be driven without a site",
            advice="set latitude and longitude of the telescope",
        )
    language = SkywatcherLanguage(options.link(url.line, patience), site, settings)
    return options.mount(language, name=name, site=site)


def _settings(options: Mapping[str, str], *, settle_s: float) -> SkywatcherSettings:
    from drivers.skywatcher.axes import SkywatcherSettings

    values: dict[str, float] = {}
    for option, text in options.items():
        low, high = _RANGES[option]
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise BadSettings(f"{option}={text} makes no sense", advice=f"a number from {low:g} to {high:g}")
        values[option] = value
    return SkywatcherSettings(settle_s=settle_s, **values)


async def _probe(exchange: Exchange) -> str:
    """Ask for the board and its counts per turn."""
    from drivers.skywatcher import codec

    board = await exchange.ask(codec.board())
    await exchange.ask(codec.counts_per_turn(codec.Axis.HOUR_ANGLE))
    return f"{board.text} (motor controller)"


def _fakes() -> Fakes:
    from drivers.skywatcher.fake import FAKES

    return FAKES


FAMILY = Family(
    name="skywatcher",
    open_mount=_open_mount,
    # Sky-Watcher's WiFi adapters, which speak UDP
    usual_port=11880,
    takes_datagrams=True,
    also_called=("eqmod", "eqdir"),
    # EQDIR cables; mounts with a USB socket
    probe=Probe(turn=2, bauds=(9600, 115_200), deadline_s=0.6, try_s=0.6, ask=_probe),
    fakes=_fakes,
)
