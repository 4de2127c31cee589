"""The catalog that comes with mountnav: Tycho-2 with supplement 1, good for every sky without a network."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.companion_colors import COLORS_SUFFIX
from mountnav.errors import BadSettings

EMBEDDED_PATH = Path(__file__).parent / "data" / "tycho2.mnc"
EMBEDDED_SHA256 = "ea144a25dcab5d2a6b317783a958ec148064980990296a72414dcf6abb8a5bd9"
EMBEDDED_COLORS_SHA256 = "8f7dfe5766c2390d2aae7fa102027d6e6a283c94371e22e88c3f48d36292edeb"
"""Of tycho2.colors beside it, which `PackedStore` finds by itself."""


@cache
def embedded_catalog() -> PackedStore:
    """Tycho-2 with its colors, memory-mapped; opened once per process.

    Returns
    -------
    PackedStore
        Safe to share between threads.

    Raises
    ------
    BadSettings
        The data file is missing or damaged.
    """
    if not EMBEDDED_PATH.is_file():
        raise BadSettings(
            f"the embedded star catalog is missing: {EMBEDDED_PATH}",
            advice="reinstall mountnav, or build the file: python tools/build_tycho2.py (tools/README.md)",
        )
    return PackedStore(EMBEDDED_PATH)


def verify_embedded() -> None:
    """Compare the embedded files with the hashes written down here; takes part of a second.

    Raises
    ------
    BadSettings
        A file is missing, damaged, or not the one this version was made with.
    """
    embedded_catalog().verify(EMBEDDED_SHA256)
    colors = EMBEDDED_PATH.with_suffix(COLORS_SUFFIX)
    try:
        found = hashlib.sha256(colors.read_bytes()).hexdigest()
    except OSError as refused:
        found = str(refused.strerror)
    if found != EMBEDDED_COLORS_SHA256:
        raise malformed_at(
            str(colors),
            0,
            f"a file of sha256 {EMBEDDED_COLORS_SHA256}",
            found,
            advice="reinstall mountnav, or build the file: python tools/build_tycho2.py (tools/README.md)",
        )
