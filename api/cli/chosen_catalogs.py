"""The catalogs that a command's options name: by name, folder, settings or environment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import config_option
from api.solver.shelf import chosen_shelf
from mountnav.errors import BadCatalog, NotFound

if TYPE_CHECKING:
    from mountnav.catalog.online import OnlineCatalog
    from mountnav.catalog.packed import PackedStore
    from mountnav.catalog.stars import Catalog
    from mountnav.settings.catalogs import CatalogsSettings, OnlineSettings

__all__ = [
    "CatalogsConfig",
    "Folder",
    "Name",
    "chosen_shelf",
    "folder_of",
    "named_catalog",
    "online_catalog",
    "online_sources",
    "opened_catalog",
]

Folder = Annotated[
    Path | None,
    typer.Option(help="Folder of imported catalogs; else that of --config, MOUNTNAV_CATALOGS, or your own."),
]
CatalogsConfig = Annotated[Path | None, config_option("Settings file: its catalogs table is used.")]
Name = Annotated[str | None, typer.Argument(help="As `list` has it; the embedded one if not given.")]


def folder_of(folder: Path | None, config: Path | None) -> Path:
    """The folder of catalogs: --folder, else that of the settings file, else the usual one.

    Raises
    ------
    BadSettings
        The settings file is wrong; it is read even where --folder is given.
    """
    from mountnav.catalog.installed import catalogs_folder

    configured = None if config is None else _settings(config).folder
    return catalogs_folder(folder if folder is not None else configured)


def online_sources(config: Path | None) -> tuple[OnlineSettings, ...]:
    """The online catalogs of a settings file; none without one. Raises `BadSettings`."""
    return () if config is None else _settings(config).online


def opened_catalog(name: str | None, folder: Path) -> PackedStore:
    """A catalog on this machine; the embedded one without a name.

    Raises
    ------
    NotFound
        There is none of that name.
    BadCatalog
        It is damaged.
    """
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.catalog.installed import EMBEDDED_SLUG, find_installed

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


def named_catalog(name: str | None, folder: Path | None, config: Path | None) -> Catalog:
    """A catalog on this machine, or an online one of the settings file.

    Raises
    ------
    Unknown, BadCatalog
        As `opened_catalog`.
    BadSettings
        The settings file is wrong.
    """
    source = next((online for online in online_sources(config) if online.name == name), None)
    return opened_catalog(name, folder_of(folder, config)) if source is None else _opened_online(source)


def online_catalog(name: str, config: Path) -> OnlineCatalog:
    """An online catalog of the settings file; nothing is asked yet.

    Raises
    ------
    NotFound
        There is none of that name.
    BadSettings
        The settings file is wrong.
    """
    sources = {online.name: online for online in online_sources(config)}
    if name not in sources:
        there = f"there are: {', '.join(sources)}" if sources else "add a [[catalogs.online]] table"
        raise NotFound(f"there is no online catalog {name!r} in {config}", advice=there)
    return _opened_online(sources[name])


def _opened_online(source: OnlineSettings) -> OnlineCatalog:
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.catalog.online import open_online

    return open_online(source.source(), behind=embedded_catalog())


def _settings(config: Path) -> CatalogsSettings:
    # importing the models of the settings file takes long: most commands need none
    from mountnav.settings.observatory import Settings

    return Settings.load_catalogs(config)
