"""The iOptron family: how such a mount is opened, probed and faked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.family import Fakes, Family, MountUrl, Probe

if TYPE_CHECKING:
    from drivers.generic.mount import GenericMount
    from drivers.wire.exchange import Exchange
    from mountnav.sky.coordinates import Site


def _open_mount(url: MountUrl, name: str | None, site: Site | None) -> GenericMount:
    from drivers.generic.options import read_options
    from drivers.ioptron.codec.greeting import COMMAND_SETS
    from drivers.ioptron.language import BAUD, IoptronLanguage

    options = read_options(url.options, "ioptron", baud=BAUD, timeout_s=5.0, dialects=COMMAND_SETS)
    language = IoptronLanguage(options.link(url.line), epoch=options.epoch, dialect=options.dialect)
    return options.mount(language, name=name, site=site)


async def _probe(exchange: Exchange) -> str:
    """Ask for the model number and the command set."""
    from drivers.ioptron.codec import v3
    from drivers.ioptron.codec.greeting import GREETING, model

    number = await exchange.ask(v3.MODEL)
    words = await exchange.ask(GREETING)
    name = model(number, words.name).name or "mount"
    return f"iOptron {name} ({number}), command set {words.name}"


def _fakes() -> Fakes:
    from drivers.ioptron.fake import FAKES

    return FAKES


FAMILY = Family(
    name="ioptron",
    open_mount=_open_mount,
    usual_port=8899,
    # v3 mounts; hand controllers 8407, 8408 and v2 mounts
    probe=Probe(turn=4, bauds=(115_200, 9600), deadline_s=0.8, try_s=0.8, ask=_probe),
    fakes=_fakes,
)
