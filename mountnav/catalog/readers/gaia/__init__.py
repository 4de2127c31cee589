"""Gaia extracts: what the archive, VizieR or astroquery put on disk, with the archive's column names."""

from __future__ import annotations

from mountnav.catalog.readers.gaia.reader import open_catalog

__all__ = ["open_catalog"]
