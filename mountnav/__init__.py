"""mountnav: the sky, the mathematics, the decisions. No wire, no web."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("mountnav")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0.0.0+uninstalled"

__all__ = ["__version__"]
