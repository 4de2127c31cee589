"""An iOptron mount from its URL's options."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.ioptron.greeting import DIALECTS
from drivers.ioptron.mount import BAUD, ioptron_language
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from drivers.registry import MountUrl


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    options = read_options(url.options, "ioptron", baud=BAUD, timeout_s=5.0, dialects=DIALECTS)
    language = ioptron_language(
        url.line,
        baud=options.baud,
        control=options.control,
        epoch=options.epoch,
        dialect=options.dialect,
        patience=options.patience,
    )
    return options.mount(language, name=name, site=site)
