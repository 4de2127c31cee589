"""Ephemeris tables in any form that is read: what it is, is seen from the text."""

from __future__ import annotations

from mountnav.ephemeris.csv_table import looks_like_csv, read_csv_table
from mountnav.ephemeris.horizons import looks_like_horizons, read_horizons
from mountnav.ephemeris.mpes import looks_like_mpes, read_mpes
from mountnav.ephemeris.table import Observer, Table
from mountnav.errors import BadRequest


def looks_like_table(text: str) -> bool:
    """Whether a text is a table of one of the kinds that `read_table` reads."""
    return looks_like_horizons(text) or looks_like_mpes(text) or looks_like_csv(text)


def read_table(text: str, *, made_for: Observer | None = None) -> Table:
    """Read a table of JPL's Horizons, of the MPC's ephemeris service, or a plain one (CSV).

    Parameters
    ----------
    text : str
    made_for : Observer, optional
        For pages of the MPC alone, which don't tell their observer's coordinates.

    Raises
    ------
    BadRequest
        It is none of these, or something in it is wrong or ambiguous.
    """
    if looks_like_horizons(text):
        return read_horizons(text)
    if looks_like_mpes(text):
        return read_mpes(text, made_for=made_for)
    if looks_like_csv(text):
        return read_csv_table(text)
    raise BadRequest(
        "this is no ephemeris table that is read here",
        advice="observer tables of Horizons (text or CSV), pages of the MPC's ephemeris service, "
        "and plain CSV are: docs/explanation/moving-targets.md",
    )
