"""An ephemeris of whatever a text holds: a satellite, orbital elements, or a table."""

from __future__ import annotations

from mountnav.ephemeris.elements_text import read_elements
from mountnav.ephemeris.ephemeris import Ephemeris
from mountnav.ephemeris.omm import looks_like_omm
from mountnav.ephemeris.satellite import EarthSatellite
from mountnav.ephemeris.satellite_text import read_satellites
from mountnav.ephemeris.small_body import SmallBody
from mountnav.ephemeris.table import Observer
from mountnav.ephemeris.table_text import looks_like_table, read_table
from mountnav.ephemeris.tle import looks_like_tle
from mountnav.errors import BadRequest


def ephemeris_of_text(text: str, *, made_for: Observer | None = None) -> Ephemeris:
    """The one target of a text.

    Parameters
    ----------
    text : str
        Elements of a satellite, a minor planet or a comet, or an ephemeris table, in any form that is read.
    made_for : Observer, optional
        As `read_table`.

    Raises
    ------
    BadRequest
        It is none of these, something in it is wrong, or it holds several.
    """
    if looks_like_table(text):
        return read_table(text, made_for=made_for)
    if looks_like_omm(text) or looks_like_tle(text):
        satellites = read_satellites(text)
        _require_one(len(satellites))
        return EarthSatellite(satellites[0])
    orbits = read_elements(text)
    _require_one(len(orbits))
    return SmallBody(orbits[0])


def _require_one(count: int) -> None:
    if count > 1:
        raise BadRequest(
            f"these are elements of {count} objects; one is wanted",
            advice="import the file, and ask by name: mountnav ephemeris import FILE",
        )
