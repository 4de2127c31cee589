"""UCAC4's zone files: 113,780,093 stars to magnitude 16, with motions and errors [CATALOGS, Formats §3]."""

from __future__ import annotations

from mountnav.catalog.readers.ucac4.reader import Ucac4Reader, open_catalog

__all__ = ["Ucac4Reader", "open_catalog"]
