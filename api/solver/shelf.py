"""The catalogs that a settings file and a name mean."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mountnav.catalog.catalog_set import CatalogSet


def chosen_shelf(config: Path | None, only: str | None = None) -> CatalogSet:
    """Open the catalogs that a command's options name.

    Parameters
    ----------
    config : Path or None
        A settings file, of which `[catalogs]` counts.
    only : str or None
        The one catalog to use, by its name.

    Raises
    ------
    BadSettings
        The file is wrong, or names a catalog that isn't there.
    """
    from mountnav.catalog.catalog_set import open_catalogs

    use = None if only is None else (only,)
    if config is None:  # the defaults serve, which need none of the models of the settings
        return open_catalogs(use=use)
    from mountnav.settings.observatory import Settings

    return open_catalogs(Settings.load_catalogs(config).choice(), use=use)
