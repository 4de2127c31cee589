"""The version of mountnav that runs."""

from __future__ import annotations


def version() -> str:
    """The version of the installed package; of a source tree that was never installed "0.0.0+uninstalled"."""
    # imported when it is asked for: the reader of package metadata takes longer to import than numpy's core
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed("mountnav")
    except PackageNotFoundError:
        return "0.0.0+uninstalled"
