"""The toys' family: how such a mount is opened, probed and faked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.family import Fakes, Family, MountUrl, Probe

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.wire.exchange import Exchange
    from mountnav.sky.coordinates import Site


def _open_mount(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    from drivers.generic.options import read_options
    from tests.drivers.toy.language import ToyLanguage

    options = read_options(url.options, url.driver, baud=9600, timeout_s=2.0)
    return options.mount(ToyLanguage(options.link(url.line)), name=name, site=site)


async def _probe(exchange: Exchange) -> str:
    from tests.drivers.toy import codec

    return await exchange.ask(codec.WHO)


def _fakes() -> Fakes:
    from tests.drivers.toy.fake import FAKES

    return FAKES


FAMILY = Family(
    name="toy",
    open_mount=_open_mount,
    probe=Probe(turn=9, bauds=(9600,), deadline_s=0.8, try_s=0.8, ask=_probe),
    fakes=_fakes,
)
