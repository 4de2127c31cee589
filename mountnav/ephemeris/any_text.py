"""Texts that hold an ephemeris, in any form that is read: what each is, is seen from the text.

Three kinds: elements of a satellite, orbital elements, tables of places by time.
"""

from __future__ import annotations

import json
from typing import Any

from mountnav.ephemeris.csv_table import looks_like_csv, read_csv_table
from mountnav.ephemeris.elements import OrbitElements
from mountnav.ephemeris.ephemeris import Ephemeris
from mountnav.ephemeris.horizons import looks_like_horizons, read_horizons
from mountnav.ephemeris.mpc import SHORTEST_COMET_LINE, read_mpc_json, read_mpc_lines
from mountnav.ephemeris.mpes import looks_like_mpes, read_mpes
from mountnav.ephemeris.omm import looks_like_omm, read_omm
from mountnav.ephemeris.satellite import EarthSatellite, SatelliteElements
from mountnav.ephemeris.sbdb import looks_like_sbdb, read_sbdb, require_orbit
from mountnav.ephemeris.small_body import SmallBody
from mountnav.ephemeris.table import Observer, Table
from mountnav.ephemeris.tle import looks_like_tle, read_tle
from mountnav.errors import BadRequest
from mountnav.parsing import json_of


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
    text = without_mark(text)
    if looks_like_table(text):
        return read_table(text, made_for=made_for)
    if looks_like_omm(text) or looks_like_tle(text):
        satellites = read_satellites(text)
        _require_one(len(satellites))
        return EarthSatellite(satellites[0])
    orbits = read_elements(text)
    _require_one(len(orbits))
    return SmallBody(orbits[0])


def without_mark(text: str) -> str:
    """The text without the mark that some programs write at its beginning (U+FEFF)."""
    return text.removeprefix("\ufeff")


def _require_one(count: int) -> None:
    if count > 1:
        raise BadRequest(
            f"these are elements of {count} objects; exactly one is needed",
            advice="import the file, and ask by name: mountnav ephemeris import FILE",
        )


def read_satellites(text: str) -> tuple[SatelliteElements, ...]:
    """Two-line elements (with names or without), or orbit mean-elements messages (XML, JSON, KVN, CSV).

    Raises
    ------
    BadRequest
        It is none of these, or something in it is wrong.
    """
    text = without_mark(text)
    if looks_like_omm(text):
        return read_omm(text)
    if looks_like_tle(text):
        return read_tle(text)
    raise BadRequest(
        "these are not elements of an Earth satellite that mountnav reads",
        advice="two-line elements with their checksums are, and OMM as XML, JSON, KVN or CSV",
    )


def read_elements(text: str) -> tuple[OrbitElements, ...]:
    """Elements of minor planets and comets.

    Parameters
    ----------
    text : str
        Lines of MPCORB.DAT or CometEls.txt, JSON of the MPC (a record, or a list of them), or an answer of
        JPL's SBDB.

    Raises
    ------
    BadRequest
        It is none of these, or something in it is wrong.
    """
    text = without_mark(text)
    if text.lstrip()[:1] in ("{", "["):
        try:
            found = json_of(text)
        except json.JSONDecodeError as wrong:
            raise BadRequest(f"the JSON is broken at line {wrong.lineno}: {wrong.msg}") from wrong
        return tuple(_of_json(found))
    if text.strip() and max(len(line.rstrip()) for line in text.splitlines()) < SHORTEST_COMET_LINE:
        raise BadRequest(
            f"it is in none of the forms that are read: {text.strip()[:40]!r} ...", advice=_FORMS
        )
    found_lines = tuple(read_mpc_lines(text.splitlines()))
    if not found_lines:
        raise BadRequest("there are no orbital elements in it")
    return found_lines


_FORMS = (
    "elements of the MPC (MPCORB, CometEls, JSON), of JPL's SBDB, TLE, OMM, tables of Horizons and the MPES, "
    "and CSV with a line of column names are"
)


def _of_json(found: Any) -> list[OrbitElements]:
    if isinstance(found, dict):
        require_orbit(found)
    if isinstance(found, dict) and looks_like_sbdb(found):
        return [read_sbdb(found)]
    if isinstance(found, dict) and isinstance(found.get("mpc_orb"), dict):
        found = found["mpc_orb"]
    records = found if isinstance(found, list) else [found]
    made = []
    for number, record in enumerate(records, 1):
        if not isinstance(record, dict):
            raise BadRequest(f"record {number} is not a JSON object")
        inner = record.get("mpc_orb")
        made.append(read_mpc_json(inner if isinstance(inner, dict) else record, f"record {number}"))
    if not made:
        raise BadRequest("there are no orbital elements in it")
    return made


def looks_like_table(text: str) -> bool:
    """Whether a text is a table of one of the kinds that `read_table` reads."""
    text = without_mark(text)
    return looks_like_horizons(text) or looks_like_mpes(text) or looks_like_csv(text)


def read_table(text: str, *, made_for: Observer | None = None) -> Table:
    """Read a table of JPL's Horizons, of the MPC's ephemeris service, or a plain one (CSV).

    Parameters
    ----------
    made_for : Observer, optional
        For pages of the MPC alone, which don't tell their observer's coordinates.

    Raises
    ------
    BadRequest
        It is none of these, or something in it is wrong or ambiguous.
    """
    text = without_mark(text)
    if looks_like_horizons(text):
        return read_horizons(text)
    if looks_like_mpes(text):
        return read_mpes(text, made_for=made_for)
    if looks_like_csv(text):
        return read_csv_table(text)
    raise BadRequest(
        "this is not an ephemeris table that mountnav reads",
        advice="observer tables of Horizons (text or CSV), pages of the MPC's ephemeris service, "
        "and plain CSV are: `mountnav docs moving-targets`",
    )
