"""Puts the shelf together: the embedded catalog, those imported on this machine, those configured online."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.installed import EMBEDDED_SLUG, Installed, catalogs_folder, installed
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.shelf import Shelf
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadSettings
from mountnav.parsing import repeated

if TYPE_CHECKING:
    from mountnav.settings.catalogs import CatalogsSettings

_log = logging.getLogger(__name__)


def open_shelf(settings: CatalogsSettings | None = None, *, use: tuple[str, ...] | None = None) -> Shelf:
    """Open all catalogs that the settings allow.

    Parameters
    ----------
    settings : CatalogsSettings, optional
        Without any, all imported catalogs in the usual folder are used.
    use : tuple of str, optional
        Only these, whatever the settings say.

    Returns
    -------
    Shelf

    Raises
    ------
    BadSettings
        A catalog that is named is not there or is damaged. One that nobody names is passed over,
        and the log tells why.
    """
    folder = catalogs_folder(settings.folder if settings else None)
    sources = settings.online if settings else ()
    use = use or (settings.use if settings else None)
    if settings is not None and settings.folder is not None and not folder.is_dir():
        _log.warning("[catalogs] folder: there is no %s; only the embedded catalog is used", folder)
    found = _told_apart({one.slug: one for one in installed(folder)})
    online = {one.name for one in sources}
    clash = next((name for name in online if name in found or name == EMBEDDED_SLUG), None)
    if clash is not None:
        raise BadSettings(
            f"[catalogs]: the online catalog {clash!r} has the name of one on this machine",
            advice="give it another name",
        )
    for name in use or ():
        if name != EMBEDDED_SLUG and name not in online:
            _require(name, found, str(folder))
    opened = (_opened(one) for one in found.values() if use is None or one.slug in use)
    stores = [one for one in opened if one is not None]
    embedded = embedded_catalog()
    offline: Catalog = Shelf(embedded, stores) if stores else embedded

    def asked(name: str) -> Catalog:
        from mountnav.catalog.online import open_online  # only where one is configured

        return open_online(next(one for one in sources if one.name == name), behind=offline)

    magnitudes: Catalog | None = None
    named = settings.magnitudes_from if settings else None
    if named == EMBEDDED_SLUG:
        magnitudes = embedded
    elif named is not None:
        magnitudes = asked(named) if named in online else _require(named, found, str(folder))
    return Shelf(
        embedded,
        stores,
        [asked(one.name) for one in sources if use is None or one.name in use],
        magnitudes=magnitudes,
        use_indexed=use is None or EMBEDDED_SLUG in use,
    )


def _told_apart(found: dict[str, Installed]) -> dict[str, Installed]:
    """Two imports of the same catalog, parts of it perhaps, are called by their own names besides."""
    shared = repeated(one.store.name for one in found.values() if one.store is not None)
    return {
        slug: replace(one, store=PackedStore(one.path, f"{one.store.name} ({slug})"))
        if one.store is not None and one.store.name in shared
        else one
        for slug, one in found.items()
    }


def _require(name: str, found: dict[str, Installed], folder: str) -> Catalog:
    one = found.get(name)
    if one is None:
        there = ", ".join([EMBEDDED_SLUG, *found]) or "none"
        raise BadSettings(
            f"[catalogs]: there is no catalog {name!r} in {folder}",
            advice=f"there is: {there}; `mountnav catalog import` makes others",
        )
    if one.store is None:
        raise BadSettings(f"[catalogs]: {name} can't be used: {one.problem}", device=str(one.path))
    return one.store


def _opened(one: Installed) -> Catalog | None:
    if one.store is None:
        _log.warning("the catalog %s is passed over: %s", one.slug, one.problem)
    return one.store
