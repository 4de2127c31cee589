"""mountnav: the sky, the mathematics, the decisions. No wire, no web."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    # asked for when it is wanted: the reader of package metadata takes longer to import than numpy's core
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("mountnav")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0+uninstalled"
