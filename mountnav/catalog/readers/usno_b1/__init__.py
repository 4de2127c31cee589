"""USNO-B1.0's zone files: a billion stars to V = 21 from photographic plates [CATALOGS, Formats §4]."""

from __future__ import annotations

from mountnav.catalog.readers.usno_b1.reader import UsnoB1Reader, open_catalog

__all__ = ["UsnoB1Reader", "open_catalog"]
