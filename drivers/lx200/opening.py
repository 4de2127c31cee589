"""An LX200 mount from its URL's options."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.lx200.dialects import names
from drivers.lx200.mount import lx200_language

if TYPE_CHECKING:
    from drivers.registry import MountUrl
    from mountnav.sky.coordinates import Site


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    options = read_options(url.options, "lx200", baud=9600, timeout_s=5.0, dialects=names())
    language = lx200_language(
        url.line,
        baud=options.baud,
        control=options.control,
        patience=options.patience,
        dialect=options.dialect,
        epoch=options.epoch if "epoch" in url.options else None,
    )
    return options.mount(language, name=name, site=site)
