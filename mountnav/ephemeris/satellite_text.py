"""Elements of Earth satellites in any form that is read: what it is, is seen from the text."""

from __future__ import annotations

from mountnav.ephemeris.omm import looks_like_omm, read_omm
from mountnav.ephemeris.satellite import SatelliteElements
from mountnav.ephemeris.tle import looks_like_tle, read_tle
from mountnav.errors import BadRequest


def read_satellites(text: str) -> tuple[SatelliteElements, ...]:
    """Two-line elements (with names or without), or orbit mean-elements messages (XML, JSON, KVN, CSV).

    Raises
    ------
    BadRequest
        It is none of these, or something in it is wrong.
    """
    if looks_like_omm(text):
        return read_omm(text)
    if looks_like_tle(text):
        return read_tle(text)
    raise BadRequest(
        "these are no elements of an Earth satellite that are read here",
        advice="two-line elements with their checksums are, and OMM as XML, JSON, KVN or CSV",
    )
