"""The catalogs that a command's options name: by name, folder, settings or environment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mountnav.catalog.catalog_set import CatalogSet, open_catalogs
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.installed import EMBEDDED_SLUG, catalogs_folder, find_installed
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadCatalog, Unknown

if TYPE_CHECKING:
    from mountnav.catalog.online import OnlineCatalog
    from mountnav.settings.catalogs import CatalogsSettings, OnlineSettings


def folder_of(folder: Path | None, config: Path | None) -> Path:
    """The folder of catalogs: --folder, else that of the settings file, else the usual one.

    Raises
    ------
    BadSettings
        The settings file is wrong; it is read even where --folder is given.
    """
    configured = None if config is None else _settings(config).folder
    return catalogs_folder(folder if folder is not None else configured)


def online_sources(config: Path | None) -> tuple[OnlineSettings, ...]:
    """The online catalogs of a settings file; none without one. Raises `BadSettings`."""
    return () if config is None else _settings(config).online


def opened(name: str | None, folder: Path) -> PackedStore:
    """A catalog on this machine; the embedded one without a name.

    Raises
    ------
    Unknown
        There is none of that name.
    BadCatalog
        It is damaged.
    """
    if name is None or name == EMBEDDED_SLUG:
        return embedded_catalog()
    found = find_installed(folder, name)
    if found.store is None:
        raise BadCatalog(
            f"can't be used: {found.problem}",
            device=name,
            advice=f"import it again, or remove it: mountnav catalog remove {name}",
        )
    return found.store


def named(name: str | None, folder: Path | None, config: Path | None) -> Catalog:
    """A catalog on this machine, or an online one of the settings file.

    Raises
    ------
    Unknown, BadCatalog
        As `opened`.
    BadSettings
        The settings file is wrong.
    """
    source = next((one for one in online_sources(config) if one.name == name), None)
    return opened(name, folder_of(folder, config)) if source is None else _opened_online(source)


def online_catalog(name: str, config: Path) -> OnlineCatalog:
    """An online catalog of the settings file; nothing is asked yet.

    Raises
    ------
    Unknown
        There is none of that name.
    BadSettings
        The settings file is wrong.
    """
    sources = {one.name: one for one in online_sources(config)}
    if name not in sources:
        there = f"there are: {', '.join(sources)}" if sources else "add a [[catalogs.online]] table"
        raise Unknown(f"there is no online catalog {name!r} in {config}", advice=there)
    return _opened_online(sources[name])


def _opened_online(source: OnlineSettings) -> OnlineCatalog:
    from mountnav.catalog.online import open_online

    return open_online(source.source(), behind=embedded_catalog())


def _settings(config: Path) -> CatalogsSettings:
    # the models of the settings file are dear to import: most commands need none
    from mountnav.settings.observatory import Settings

    return Settings.load_catalogs(config)


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
    use = None if only is None else (only,)
    if config is None:
        # the defaults need none of the models of the settings file, which are dear to import
        return open_catalogs(use=use)
    from mountnav.settings.observatory import Settings

    return open_catalogs(Settings.load_catalogs(config).choice(), use=use)
