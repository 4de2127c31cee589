"""Index files of astrometry.net as a star catalog."""

from __future__ import annotations

from mountnav.catalog.readers.astrometry_net.reader import open_catalog

__all__ = ["open_catalog"]
