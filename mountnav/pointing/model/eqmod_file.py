"""Alignment points of INDI's EQMod driver (``AlignData_EQMod Mount.xml``), read as observations.

The file has one site with its latitude, and points: sidereal time and the two right ascensions in hours, the
two declinations in degrees; *celestial* is where the tube looked, *telescope* where the motors' counts stood.
Numbers have six digits, so a right ascension beyond 10 h is rounded to 3″.

The side of the pier isn't in it. The driver's mounts are German ones, and a point is taken to be seen from
the usual side: from the east of the pier at positive hour angles, as `looks_through_pole` does for all mounts
that don't tell.
"""

from __future__ import annotations

import math
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.pointing.model.mechanical import Mechanical, folded, looks_through_pole
from mountnav.pointing.model.rigorous import direction, wrapped
from mountnav.units import DEG_PER_HOUR

_MOST_HOURS = 24.0
"""Hours of right ascension and of sidereal time lie within this amount."""
_SIGMA_ARCSEC = 2.0
"""One-sigma error of a point: six digits round two right ascensions to 1.5″ each."""
_MOST_XML_DEPTH = 8
"""Deepest nesting that is read: the driver writes four levels."""
_NUMBER = re.compile(r"\s*[+-]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eE][+-]?\d{1,3})?\s*", re.ASCII)
"""Of ASCII alone: other control characters are white space to a pattern, and none to `float`."""
_ROOT = re.compile(r"\s*(?:<\?xml[^>]{0,200}\?>\s*)?<aligndata\b")


def is_eqmod_alignment(text: str) -> bool:
    """Whether a file's text begins as the driver writes it."""
    return _ROOT.match(text) is not None


def read_eqmod_alignment(text: str, *, name: str = "file") -> Mechanical:
    """Read the points.

    Parameters
    ----------
    name : str
        Stands in the messages.

    Raises
    ------
    BadRequest
        It is no such file, or a point of it makes no sense; with its number.
    """
    root = _root_of(text, name)
    site = root.find("site")
    if root.tag != "aligndata" or site is None:
        raise BadRequest(
            f"{name} is not a file of alignment points",
            advice="INDI's EQMod driver writes one as ~/.indi/AlignData_EQMod Mount.xml",
        )
    latitude_deg = _number(site.get("lat"), 90.0, f"{name}: the site's latitude")
    points = site.findall("point")
    if not points:
        raise BadRequest(f"{name} holds no observations")
    rows = np.array([_row(point, f"{name}, point {number}") for number, point in enumerate(points, 1)])
    seen_ha_deg, seen_dec_deg, read_ha_deg, read_dec_deg = rows.T
    through = np.array(
        [looks_through_pole(PierSide.UNKNOWN, ha, "german") for ha in seen_ha_deg], dtype=np.bool_
    )
    latitude_rad = math.radians(latitude_deg)
    seen = direction(np.radians(seen_ha_deg), np.radians(seen_dec_deg))
    read_lon_rad, read_lat_rad = folded(
        direction(np.radians(read_ha_deg), np.radians(read_dec_deg)), through, latitude_rad
    )
    return Mechanical(
        kind="equatorial",
        site_latitude_rad=latitude_rad,
        seen=seen,
        beyond=through,
        read_lon_rad=wrapped(read_lon_rad),
        read_lat_rad=read_lat_rad,
        sigma_arcsec=np.full(len(rows), _SIGMA_ARCSEC),
        segment=np.zeros(len(rows), dtype=np.int64),
        segment_ids=("file",),
    )


def _root_of(text: str, name: str) -> ElementTree.Element:
    """The outermost element of a text. Raises `BadRequest` for XML that is broken or made to harm."""
    if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise BadRequest(
            f"{name}: the XML has a document type or entities of its own, which is not supported"
        )
    parser: Any = ElementTree.XMLPullParser(("start", "end"))
    depth = 0
    root: ElementTree.Element | None = None
    try:
        # it is text already: what it says of its encoding counts no more
        parser.feed(re.sub(r"^\s*<\?xml[^>]{0,200}\?>", "", text).encode("utf-8", "replace"))
        parser.close()
        for event, element in parser.read_events():
            root = element if root is None else root
            depth += 1 if event == "start" else -1
            if depth > _MOST_XML_DEPTH:
                raise BadRequest(f"{name}: the XML is nested too deep")
    except (ElementTree.ParseError, LookupError, ValueError) as wrong:
        raise BadRequest(f"{name}: the XML is broken: {wrong}") from wrong
    if root is None:
        raise BadRequest(f"{name}: the XML is empty")
    return root


def _row(point: ElementTree.Element, about: str) -> tuple[float, float, float, float]:
    """Hour angle and declination, seen and read, deg; hour angles within half a turn."""

    def value(tag: str, most: float) -> float:
        return _number(point.findtext(tag), most, f"{about}: {tag}")

    sidereal_h = value("synctime", _MOST_HOURS)
    seen_ha_h = sidereal_h - value("celestialra", _MOST_HOURS)
    read_ha_h = sidereal_h - value("telescopera", _MOST_HOURS)
    return (
        _within_half_a_turn(DEG_PER_HOUR * seen_ha_h),
        value("celestialde", 90.0),
        _within_half_a_turn(DEG_PER_HOUR * read_ha_h),
        value("telescopede", 90.0),
    )


def _within_half_a_turn(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


def _number(text: str | None, most: float, about: str) -> float:
    """A finite number of an amount up to `most`. Raises `BadRequest`."""
    value = float(text) if text is not None and _NUMBER.fullmatch(text) else math.nan
    if not abs(value) <= most:
        raise BadRequest(f"{about} is {text!r}, not a number within ±{most:g}")
    return value
