"""Stars from the network, when asked for: VizieR, VO cone searches and TAP, with a cache on disk."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.online.catalog import CachedTiles, OnlineCatalog, Prefetched
from mountnav.catalog.online.source import OnlineSource
from mountnav.catalog.stars import Catalog
from mountnav.files import cache_folder
from mountnav.settings.catalogs import OnlineSettings

__all__ = ["CachedTiles", "OnlineCatalog", "OnlineSource", "Prefetched", "open_online"]


def open_online(
    settings: OnlineSettings, *, behind: Catalog | None, cache: Path | None = None
) -> OnlineCatalog:
    """Open a catalog as it is configured. Asks nothing yet.

    Parameters
    ----------
    settings : OnlineSettings
    behind : Catalog or None
        Whose stars are taken where this one has none.
    cache : Path, optional
        Without it the user's cache: $MOUNTNAV_CACHE and so on.

    Returns
    -------
    OnlineCatalog
    """
    if cache is None:
        cache = cache_folder()
    return OnlineCatalog(OnlineSource.of(settings), cache, behind=behind)
