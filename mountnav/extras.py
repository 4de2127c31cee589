"""Packages that only some users need: what is missing is told with the command that brings it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from mountnav.errors import BadRequest, MountnavError

Extra = Literal[
    "dask", "gaia", "gwcs", "otel", "parquet", "plots", "postgresql", "raw", "remote", "s3", "tls"
]
"""Names of the extras, as ``pip install 'mountnav[NAME]'`` takes them."""


@contextmanager
def extra(name: Extra, what: str, error: type[MountnavError] = BadRequest) -> Iterator[None]:
    """Import what an extra brings within this; without it the user is told.

    Parameters
    ----------
    what : str
        What needs it, in the plural: "Parquet files".
    error : type, optional
        What is raised where it is missing, as callers expect it.

    Examples
    --------
    >>> with extra("plots", "plots"):
    ...     import math
    """
    try:
        yield
    except ImportError as missing:
        package = (missing.name or "a package").partition(".")[0]
        raise error(
            f"{what} need {package}, which is not installed", advice=f"pip install 'mountnav[{name}]'"
        ) from missing
