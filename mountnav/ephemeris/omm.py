"""Orbit mean-elements messages (CCSDS 502.0-B) of Earth satellites: XML, JSON, KVN and CSV.

Only what SGP4 takes is read: the center is the Earth, the frame TEME, the theory SGP4, times UTC.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Final
from xml.etree import ElementTree

from mountnav.ephemeris.satellite import SatelliteElements
from mountnav.errors import BadRequest
from mountnav.parsing import json_of

_FIELDS: Final = {
    "mean_motion_rev_day": "MEAN_MOTION",
    "eccentricity": "ECCENTRICITY",
    "inclination_deg": "INCLINATION",
    "node_deg": "RA_OF_ASC_NODE",
    "perigee_deg": "ARG_OF_PERICENTER",
    "mean_anomaly_deg": "MEAN_ANOMALY",
}
_MAYBE: Final = {
    "bstar": "BSTAR",
    "motion_dot_rev_day2": "MEAN_MOTION_DOT",
    "motion_ddot_rev_day3": "MEAN_MOTION_DDOT",
}
_REQUIRED: Final = (
    ("CENTER_NAME", ("EARTH",)),
    ("REF_FRAME", ("TEME",)),
    ("TIME_SYSTEM", ("UTC",)),
    ("MEAN_ELEMENT_THEORY", ("SGP4", "SGP/SGP4")),
)
"""What a message has to say where it says it; Celestrak's JSON and CSV leave it out, being nothing else."""
MOST_NAME: Final = 80
"""Letters of a name that are kept."""
_MOST_XML_DEPTH: Final = 20
"""How deep elements of the XML lie at most; an OMM's have seven. Doubled, nothing changes."""


def looks_like_omm(text: str) -> bool:
    """Whether a text is an OMM in any of its forms."""
    head = text.lstrip()[:4000]
    if head.startswith("<"):
        return "omm" in head.lower()
    if head.startswith(("{", "[")):
        return '"MEAN_MOTION"' in text
    return re.search(r"(?m)^[ \t]*CCSDS_OMM_VERS[ \t]*=|^OBJECT_NAME[ \t]*,", head) is not None


def read_omm(text: str) -> tuple[SatelliteElements, ...]:
    """Read messages; what form they are in is seen from the text.

    Raises
    ------
    BadRequest
        Broken, a field that is missing or none, or elements of another theory.
    """
    head = text.lstrip()[:1]
    if head == "<":
        records: Iterator[Mapping[str, Any]] = _of_xml(text)
    elif head in ("{", "["):
        records = _of_json(text)
    elif re.search(r"(?m)^[ \t]*CCSDS_OMM_VERS[ \t]*=", text):
        records = _of_kvn(text)
    else:
        records = _of_csv(text)
    found = tuple(_elements(record, f"message {number}") for number, record in enumerate(records, 1))
    if not found:
        raise BadRequest("there is no orbit mean-elements message in it")
    return found


def _of_xml(text: str) -> Iterator[dict[str, str]]:
    if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise BadRequest("the XML has a document type or entities of its own, which is not supported")
    parser: Any = ElementTree.XMLPullParser(("start", "end"))
    depth = 0
    fields: dict[str, str] = {}
    try:
        # it is text already: what it says of its encoding counts no more
        parser.feed(re.sub(r"^\s*<\?xml[^>]{0,200}\?>", "", text).encode("utf-8", "replace"))
        parser.close()
        for event, element in parser.read_events():
            depth += 1 if event == "start" else -1
            if depth > _MOST_XML_DEPTH:
                raise BadRequest("the XML is nested too deep")
            if event == "start":
                continue
            tag = element.tag.rpartition("}")[2]
            if tag.upper() == tag and element.text:
                if tag in fields:
                    raise BadRequest(f"the message says {tag[:40]} twice")
                fields[tag] = element.text.strip()
            if tag == "segment":
                yield fields
                fields = {}
    except (ElementTree.ParseError, LookupError, ValueError) as wrong:
        raise BadRequest(f"the XML is broken: {wrong}") from wrong


def _of_json(text: str) -> Iterator[Mapping[str, Any]]:
    try:
        found = json_of(text)
    except json.JSONDecodeError as wrong:
        raise BadRequest(f"the JSON is broken at line {wrong.lineno}: {wrong.msg}") from wrong
    for number, one in enumerate(found if isinstance(found, list) else [found], 1):
        if not isinstance(one, dict):
            raise BadRequest(f"message {number} is not a JSON object")
        yield one


def _of_kvn(text: str) -> Iterator[dict[str, str]]:
    fields: dict[str, str] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith("COMMENT"):
            continue
        key, equals, value = line.partition("=")
        key = key.strip()
        if not equals or not re.fullmatch(r"[A-Z0-9_]{1,60}", key):
            raise BadRequest(f"line {number} is not KEY = value: {line[:30]!r}")
        if key == "CCSDS_OMM_VERS" and fields:
            yield fields
            fields = {}
        if key in fields:
            raise BadRequest(f"line {number} says {key} a second time")
        # a unit may follow in brackets
        fields[key] = re.sub(r"\s*\[[^\]]{0,40}\]$", "", value.strip())
    if fields:
        yield fields


def _of_csv(text: str) -> Iterator[dict[str, str]]:
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        header: list[str] | None = None
        for row in reader:
            if not row:
                continue
            if header is None:
                header = [one.strip().lstrip("﻿") for one in row]
                if len(set(header)) != len(header):
                    raise BadRequest("the CSV has a column twice")
                continue
            if len(row) != len(header):
                raise BadRequest(f"line {reader.line_num} has {len(row)} fields, the header {len(header)}")
            yield dict(zip(header, row, strict=True))
    except csv.Error as wrong:
        raise BadRequest(f"the CSV is broken at line {reader.line_num}: {wrong}") from wrong


def _elements(record: Mapping[str, Any], at: str) -> SatelliteElements:
    name = str(record.get("OBJECT_NAME") or "").strip()[:MOST_NAME]
    at = f"{at} ({name[:30]})" if name else at
    for key, allowed in _REQUIRED:
        told = str(record.get(key) or "").strip().upper()
        if told and told not in allowed:
            raise BadRequest(
                f"{at}: {key} is {told[:30]}, not {allowed[0]}", advice="ask for elements for SGP4"
            )
    kind = str(record.get("EPHEMERIS_TYPE") or "0").strip()
    if kind not in ("0", "2"):
        raise BadRequest(f"{at}: ephemeris type {kind[:10]} isn't SGP4", advice="ask for elements of type 0")
    values = {field: _number(record, key, at) for field, key in _FIELDS.items()}
    for field, key in _MAYBE.items():
        values[field] = _number(record, key, at) if record.get(key) not in (None, "") else 0.0
    number = record.get("NORAD_CAT_ID")
    norad_id = 0
    if number not in (None, ""):
        if not re.fullmatch(r"\s*[0-9]{1,9}\s*", str(number)):
            raise BadRequest(f"{at}: NORAD_CAT_ID {str(number)[:20]!r} is not a catalog number")
        norad_id = int(str(number).strip())
    return SatelliteElements(
        name=name or f"satellite {norad_id}",
        norad_id=norad_id,
        epoch_utc=_epoch(record.get("EPOCH"), at),
        international_id=str(record.get("OBJECT_ID") or "").strip()[:20],
        **values,
    )


def _number(record: Mapping[str, Any], key: str, at: str) -> float:
    value = record.get(key)
    text = str(value).strip() if isinstance(value, str | int | float) and not isinstance(value, bool) else ""
    if not re.fullmatch(r"[+-]?[0-9]{0,12}(?:\.[0-9]{0,20})?(?:[eE][+-]?[0-9]{1,2})?", text) or not re.search(
        r"[0-9]", text
    ):
        raise BadRequest(f"{at}: {key} is {str(value)[:24]!r}, no number")
    try:
        return float(text)
    except ValueError as wrong:
        raise BadRequest(f"{at}: {key} is {text[:24]!r}, no number") from wrong


def _epoch(value: object, at: str) -> datetime:
    text = str(value or "").strip()
    if by_day := re.fullmatch(r"([0-9]{4})-([0-9]{3})T(.+)", text):
        # CCSDS's day of the year
        try:
            text = f"{datetime.strptime(f'{by_day[1]} {by_day[2]}', '%Y %j'):%Y-%m-%d}T{by_day[3]}"
        except ValueError:
            text = ""
    match = re.fullmatch(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(\.\d{1,12})?Z?", text, re.ASCII)
    try:
        if match is None:
            raise ValueError
        whole = datetime.fromisoformat(match[1]).replace(tzinfo=UTC)
        return whole.replace(microsecond=min(round(float(match[2] or 0.0) * 1e6), 999_999))
    except ValueError:
        raise BadRequest(f"{at}: EPOCH is {str(value)[:30]!r}, no time") from None
