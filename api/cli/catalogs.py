"""The shelf of catalogs that a command works with."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.at_hand import open_shelf
from mountnav.catalog.shelf import Shelf


def chosen_shelf(config: Path | None, only: str | None = None) -> Shelf:
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
    use = None if only is None else (only,)
    if config is None:
        # the defaults need none of the models of the settings file, which are dear to import
        return open_shelf(use=use)
    from mountnav.settings.observatory import Settings

    return open_shelf(Settings.load_catalogs(config), use=use)
