"""Which dialects there are, and which of them a mount speaks: the first that recognizes its handshake."""

from __future__ import annotations

import importlib

from drivers.lx200.codec.dialect import Dialect, Handshake
from mountnav.errors import BadSettings

# the most specific first; the last recognizes anything
_WHERE = {
    "onstep": "drivers.lx200.codec.onstep:ONSTEP",
    "10micron": "drivers.lx200.codec.tenmicron:TENMICRON",
    "am5": "drivers.lx200.codec.am5:AM5",
    "am5-old": "drivers.lx200.codec.am5:AM5_OLD",
    "gemini": "drivers.lx200.codec.gemini:GEMINI",
    "ap": "drivers.lx200.codec.astro_physics:ASTRO_PHYSICS",
    "lx200gps": "drivers.lx200.codec.meade:LX200GPS",
    "autostar": "drivers.lx200.codec.meade:AUTOSTAR",
    "generic": "drivers.lx200.codec.meade:GENERIC",
    "classic": "drivers.lx200.codec.meade:CLASSIC",
    "basic": "drivers.lx200.codec.meade:BASIC",
}

_WEAK = ("generic", "classic", "basic")


def names() -> list[str]:
    """List what ``?dialect=`` may say."""
    return list(_WHERE)


def dialect_named(name: str) -> Dialect:
    """Return a dialect.

    Raises
    ------
    BadSettings
        If there is none of that name.
    """
    if name not in names():
        raise BadSettings(f"dialect={name} is unknown", advice=f"known: {', '.join(names())}")
    module, _, value = _WHERE[name].partition(":")
    dialect: Dialect = getattr(importlib.import_module(module), value)
    return dialect


def weak(dialect: Dialect) -> bool:
    """Whether a dialect is what remains when no product name is known: also that of an answer gone wrong."""
    return dialect.name in _WEAK


def recognized(handshake: Handshake) -> Dialect:
    """Return the dialect of a mount that answered so."""
    for name in names():
        dialect = dialect_named(name)
        if dialect.recognizes(handshake):
            return dialect
    raise AssertionError("the last dialect recognizes anything")
