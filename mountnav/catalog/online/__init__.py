"""Stars from the network, when asked for: VizieR, VO cone searches and TAP, with a cache on disk."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.online.catalog import CachedTiles, OnlineCatalog, Prefetched
from mountnav.catalog.online.source import OnlineSource
from mountnav.catalog.stars import Catalog
from mountnav.files import cache_folder

__all__ = ["CachedTiles", "OnlineCatalog", "OnlineSource", "Prefetched", "open_online"]


def open_online(source: OnlineSource, *, behind: Catalog | None, cache: Path | None = None) -> OnlineCatalog:
    """Open an online catalog. Asks nothing yet.

    Parameters
    ----------
    behind : Catalog or None
        Whose stars are taken where this one has none.
    cache : Path, optional
        Without it the user's cache: $MOUNTNAV_CACHE and so on.
    """
    if cache is None:
        cache = cache_folder()
    return OnlineCatalog(source, cache, behind=behind)
