"""One way to say where a catalog's file goes wrong: the offset, what was expected, what is there."""

from __future__ import annotations

from mountnav.errors import BadCatalog

COPY_AGAIN = "the file is damaged or of another kind: copy it again from where it came"


def malformed_at(
    file: str, offset: int, expected: str, found: str, *, unit: str = "byte", advice: str = COPY_AGAIN
) -> BadCatalog:
    """Make the error.

    Parameters
    ----------
    file : str
        Name of the file.
    offset : int
        Where it goes wrong.
    expected, found : str
        What should be there, and what is.
    unit : str
        What `offset` counts: "byte", "line", "row".

    Returns
    -------
    BadCatalog
        To be raised by the caller.
    """
    return BadCatalog(f"at {unit} {offset}: expected {expected}, found {found}", device=file, advice=advice)
