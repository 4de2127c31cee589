"""Siril's local Gaia catalog: the astrometric extract of DR3, one file for the whole sky or chunks of it."""

from mountnav.catalog.readers.siril.reader import open_catalog

__all__ = ["open_catalog"]
