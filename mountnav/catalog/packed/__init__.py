"""The packed store: one memory-mapped file for a catalog of any size."""

from mountnav.catalog.packed.store import PackedStore

__all__ = ["PackedStore"]
