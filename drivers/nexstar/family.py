"""The hand controls' family (NexStar, SynScan): how such a mount is opened, probed and faked."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING

from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.nexstar.codec import base
from drivers.nexstar.codec.handsets import STARSENSE, Handset, Version
from drivers.nexstar.fake import AVX, FakeNexstar
from drivers.nexstar.mount import nexstar_language, patience_of
from drivers.nexstar.parking import Horizon
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.devices import Epoch
from mountnav.errors import BadRequest, BadSettings, DeviceGarbled, DeviceSilent
from mountnav.simulation.mechanics import Machine, Mechanics
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


BAUDS = (9600,)

_PATIENCE = Patience(deadline_s=2.5, try_s=1.2, quiet_s=0.1)
_LETTER = b"x"


async def probe(line: ByteLine) -> str | None:
    """Ask an opened line for an echo and a version; what answers in words, or None.

    Raises
    ------
    DeviceMissing
        If the line is lost.
    """
    exchange = Exchange(line, _PATIENCE)
    try:
        await exchange.ask(base.echo(_LETTER))
        version = await exchange.ask(base.VERSION)
    except (DeviceSilent, DeviceGarbled):
        return None
    maker = "SynScan" if version.synscan else "NexStar"
    return f"{maker} hand control {version}"


_HANDSETS = {
    "nexstar": AVX,
    # a CGEM before version 5: whole-hour zones, sync and pier side
    "nexstar-4": Handset(Version(4, 21), None, 14, Version(6, 17)),
    # the first hand controls: four digits, no sync, no clock, no pulses
    "nexstar-old": Handset(Version(1, 2)),
    "starsense": Handset(Version(1, 20), STARSENSE, 23, Version(7, 13)),
}
DIALECTS: tuple[str, ...] = tuple(_HANDSETS)
MOVES: tuple[bytes, ...] = (b"r", b"R", b"b", b"B", b"s", b"S", b"P\x03\x10\x26", b"P\x03\x11\x26")
"""Beginnings of commands that are sent once for each order: goto, sync, guide pulse."""
STOPS: tuple[bytes, ...] = (b"M",)
MACHINE = Machine(mounting="german")


def fake_from(
    dialect: str | None,
    mechanics: Mechanics,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeNexstar:
    """Make the fake of a dialect; the first of `DIALECTS` if None.

    Raises
    ------
    BadRequest
        If there is no such dialect.
    """
    handset = _HANDSETS.get(dialect or DIALECTS[0])
    if handset is None:
        raise BadRequest(f"there is no NexStar dialect {dialect}", advice=f"known: {', '.join(DIALECTS)}")
    return FakeNexstar(mechanics, handset=handset, faults=faults, clock=clock, monotonic=monotonic)
