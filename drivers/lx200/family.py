"""The LX200 family: how such a mount is opened, probed and faked."""

from __future__ import annotations

import contextlib
from collections.abc import Collection
from typing import TYPE_CHECKING

from drivers.family import Fakes, Family, MountUrl, Probe
from mountnav.errors import DeviceGarbled, DeviceSilent

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.wire.exchange import Exchange
    from mountnav.sky.coordinates import Site


def _open_mount(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    from drivers.generic.options import read_options
    from drivers.lx200.codec.greeting import dialect_named
    from drivers.lx200.language import Lx200Language

    options = read_options(url.options, "lx200", baud=9600, timeout_s=5.0, dialects=_dialect_names())
    dialect = None if options.dialect is None else dialect_named(options.dialect)
    epoch = options.epoch if "epoch" in url.options else None
    language = Lx200Language(options.link(url.line), dialect, epoch=epoch)
    return options.mount(language, name=name, site=site)


def _dialect_names() -> Collection[str]:
    from drivers.lx200.codec.greeting import names

    return names()


async def _probe(exchange: Exchange) -> str:
    """Ask for a product and a place."""
    from drivers.lx200.codec import base

    product = ""
    # a true classic keeps silent: a readable place shows it as well
    with contextlib.suppress(DeviceSilent, DeviceGarbled):
        product = await exchange.ask(base.PRODUCT)
    await exchange.ask(base.GET_RA)
    await exchange.ask(base.GET_DEC)
    return f"LX200: {product}" if product else "LX200, without a product name"


def _fakes() -> Fakes:
    from drivers.lx200.fake.dialects import FAKES

    return FAKES


FAMILY = Family(
    name="lx200",
    open_mount=_open_mount,
    # OnStep's, see docs/reference/mounts/onstep.md; other bridges have 4030
    usual_port=9999,
    also_called=(
        "meade",
        "autostar",
        "losmandy",
        "zwo",
        "am3",
        "tenmicron",
        "astrophysics",
    ),
    dialect_names=_dialect_names,
    # mounts on USB mostly don't care about the speed
    probe=Probe(turn=3, bauds=(9600,), deadline_s=0.8, try_s=0.8, ask=_probe),
    fakes=_fakes,
)
