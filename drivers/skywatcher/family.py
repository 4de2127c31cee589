"""The Sky-Watcher motor controllers' family: how such a mount is opened, probed and faked."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING

from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.skywatcher import codec
from drivers.skywatcher.axes import SkywatcherSettings
from drivers.skywatcher.codec import Axis
from drivers.skywatcher.fake import BOARDS, FakeSkywatcher
from drivers.skywatcher.mount import BAUD, PATIENCE, skywatcher_language
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.errors import BadRequest, BadSettings, DeviceGarbled, DeviceSilent
from mountnav.simulation.mechanics import Machine, Mechanics
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from drivers.registry import MountUrl


_RANGES = {
    "past_meridian_deg": (0.0, 30.0),
    "tracking_past_deg": (0.0, 60.0),
    "lowest_altitude_deg": (-90.0, 89.0),
    "guide_rate": (0.05, 0.95),
    "goto_deg_s": (0.1, 30.0),
    "goto_deg_s2": (0.1, 60.0),
}


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If there is no site, an option is unknown, or its value makes no sense.
    """
    options = read_options(url.options, "skywatcher", baud=BAUD, timeout_s=PATIENCE.deadline_s, own=_RANGES)
    if options.epoch != "apparent":
        raise BadSettings(
            "epoch=icrs makes no sense for skywatcher", advice="leave it out: its place is reckoned by us"
        )
    if options.set_clock or options.set_site:
        raise BadSettings(
            "set_clock and set_site make no sense for skywatcher", advice="it has neither clock nor site"
        )
    timeout_s = options.timeout_s
    language = skywatcher_language(
        url.line,
        site,
        baud=options.baud,
        control=options.control,
        patience=options.patience_with(Patience(timeout_s, min(PATIENCE.try_s, timeout_s), PATIENCE.quiet_s)),
        settings=_settings(options.own, settle_s=2.0 * options.timing.poll_s + 0.2),
    )
    return options.mount(language, name=name, site=site)


def _settings(options: Mapping[str, str], *, settle_s: float) -> SkywatcherSettings:
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


BAUDS = (9600, 115_200)
"""EQDIR cables; mounts with a USB socket."""

_PATIENCE = Patience(deadline_s=0.6, try_s=0.6, quiet_s=0.1)


async def probe(line: ByteLine) -> str | None:
    """Ask an opened line for its board and its counts per turn; what answers in words, or None.

    Raises
    ------
    DeviceMissing
        If the line is lost.
    """
    exchange = Exchange(line, _PATIENCE)
    try:
        board = await exchange.ask(codec.board())
        await exchange.ask(codec.counts_per_turn(Axis.HOUR_ANGLE))
    except (DeviceSilent, DeviceGarbled):
        return None
    return f"{board.text} (motor controller)"


MACHINE = Machine(mounting="german", starts_at="home", tracks_at_start=False)
"""How the mechanics behind such a fake are built at the least."""
DIALECTS: tuple[str, ...] = tuple(BOARDS)
MOVES: tuple[bytes, ...] = (b":J",)
"""Beginnings of commands that start a motion; syncs never reach the wire."""
STOPS: tuple[bytes, ...] = (b":K", b":L")
"""Beginnings of commands that stop one."""


def fake_from(
    dialect: str | None,
    mechanics: Mechanics,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeSkywatcher:
    """Make a fake; `mechanics` should be built like `MACHINE`.

    Raises
    ------
    BadRequest
        If there is no such dialect.
    """
    board = BOARDS.get(dialect or DIALECTS[0])
    if board is None:
        raise BadRequest(f"no Sky-Watcher mount {dialect!r}", advice=f"one of {', '.join(DIALECTS)}")
    return FakeSkywatcher(mechanics, board=board, faults=faults, clock=clock, monotonic=monotonic)
