"""Star databases of ASTAP and HNSKY: a folder of area files (.1476 or .290), or one of them."""

from mountnav.catalog.readers.astap.reader import open_catalog

__all__ = ["open_catalog"]
