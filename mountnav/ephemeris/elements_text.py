"""Orbital elements in any form that is read: what it is, is seen from the text."""

from __future__ import annotations

import json
from typing import Any

from mountnav.ephemeris.elements import OrbitElements
from mountnav.ephemeris.mpc import read_mpc_json, read_mpc_lines
from mountnav.ephemeris.sbdb import looks_like_sbdb, read_sbdb
from mountnav.errors import BadRequest
from mountnav.parsing import json_of


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
    if text.lstrip()[:1] in ("{", "["):
        try:
            found = json_of(text)
        except json.JSONDecodeError as wrong:
            raise BadRequest(f"the JSON is broken at line {wrong.lineno}: {wrong.msg}") from wrong
        return tuple(_of_json(found))
    found_lines = tuple(read_mpc_lines(text.splitlines()))
    if not found_lines:
        raise BadRequest("there are no orbital elements in it")
    return found_lines


def _of_json(found: Any) -> list[OrbitElements]:
    if isinstance(found, dict) and looks_like_sbdb(found):
        return [read_sbdb(found)]
    if isinstance(found, dict) and isinstance(found.get("mpc_orb"), dict):
        found = found["mpc_orb"]
    records = found if isinstance(found, list) else [found]
    made = []
    for number, record in enumerate(records, 1):
        if not isinstance(record, dict):
            raise BadRequest(f"record {number} is no JSON object")
        inner = record.get("mpc_orb")
        made.append(read_mpc_json(inner if isinstance(inner, dict) else record, f"record {number}"))
    if not made:
        raise BadRequest("there are no orbital elements in it")
    return made
