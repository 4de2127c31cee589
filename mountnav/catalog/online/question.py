"""The request for a cone of stars, in the words of each protocol."""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import quote, urlencode

from mountnav.catalog.online.known_tables import table_proper
from mountnav.catalog.online.source import OnlineSource

MOST_ROWS = 40_000
"""Rows asked for at most; some 6 MB of XML. A tile that holds more is split."""
_UNIT = re.compile(r"\s*\[(?P<unit>[^\]]*)\]\s*$")
_PLAIN_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*$")
_RESERVED = frozenset({"of", "date", "time", "size", "position", "zone", "year", "class", "distance", "area"})
"""Names of columns that are in use and that ADQL wants in quotes."""


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle of the sky.

    Attributes
    ----------
    ra_deg, dec_deg : float
        ICRS.
    radius_deg : float
    """

    ra_deg: float
    dec_deg: float
    radius_deg: float


def question(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    """The address that asks for the stars of a circle.

    Parameters
    ----------
    source : OnlineSource
    circle : Circle
    mag_limit : float or None
        Only stars to this magnitude; what the service or the table can't limit is cut later.

    Returns
    -------
    str
        One plain GET.
    """
    return {"vizier": _vizier, "cone": _cone, "tap": _tap}[source.protocol](source, circle, mag_limit)


def named_columns(source: OnlineSource) -> dict[str, tuple[str, str]]:
    """Configured columns: role to (name, unit), the unit empty where it isn't given."""
    named: dict[str, tuple[str, str]] = {}
    for role, text in source.columns.items():
        unit = _UNIT.search(text)
        named[role] = (_UNIT.sub("", text).strip(), unit["unit"].strip() if unit else "")
    return named


def limit_column(source: OnlineSource) -> str:
    """The column by which the server can be asked for bright stars only; empty if there is none."""
    if source.protocol == "cone":
        return ""
    if "mag" in source.columns:
        return named_columns(source)["mag"][0]
    return source.known.limit_column if source.known else ""


def _vizier(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    # the ASU conventions of CDS: -c is a place, -c.rd a radius in degrees
    arguments = [
        ("-source", table_proper(source.table)),
        ("-c", f"{circle.ra_deg:.6f} {circle.dec_deg:+.6f}"),
        ("-c.eq", "J2000"),
        ("-c.rd", f"{circle.radius_deg:.6f}"),
        ("-out.max", str(MOST_ROWS)),
    ]
    arguments += [("-out", name) for name in _wanted(source, optional=True) or ["*"]]
    if mag_limit is not None and (column := limit_column(source)):
        arguments.append((column, f"<={mag_limit:g}"))
    address = source.url.rstrip("/")
    return _address(address if "/viz-bin/" in address else f"{address}/viz-bin/votable", arguments)


def _cone(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    # IVOA Simple Cone Search 1.03; MAXREC is of DALI 1.1, others ignore it
    del mag_limit
    arguments = [
        ("RA", f"{circle.ra_deg:.6f}"),
        ("DEC", f"{circle.dec_deg:.6f}"),
        ("SR", f"{circle.radius_deg:.6f}"),
        ("VERB", "3" if source.columns else "2"),
        ("MAXREC", str(MOST_ROWS)),
    ]
    return _address(source.url, arguments)


def _tap(source: OnlineSource, circle: Circle, mag_limit: float | None) -> str:
    # IVOA TAP 1.1, synchronous; ADQL 2.0
    wanted = _wanted(source, optional=False)
    named = named_columns(source)
    roles = source.known.roles if source.known else {}
    ra = named["ra"][0] if "ra" in named else roles.get("ra", ("ra",))[0]
    dec = named["dec"][0] if "dec" in named else roles.get("dec", ("dec",))[0]
    query = (
        f"SELECT {', '.join(_identifier(name) for name in wanted) or '*'} FROM {_table(source.table)} "
        f"WHERE 1=CONTAINS(POINT('ICRS', {_identifier(ra)}, {_identifier(dec)}), "
        f"CIRCLE('ICRS', {circle.ra_deg:.6f}, {circle.dec_deg:.6f}, {circle.radius_deg:.6f}))"
    )
    if mag_limit is not None and (column := limit_column(source)):
        query += f" AND {_identifier(column)} <= {mag_limit:g}"
    arguments = [
        ("REQUEST", "doQuery"),
        ("LANG", "ADQL"),
        ("FORMAT", "votable"),
        ("MAXREC", str(MOST_ROWS)),
        ("QUERY", query),
    ]
    address = source.url.rstrip("/")
    return _address(address if address.endswith("/sync") else f"{address}/sync", arguments)


def _wanted(source: OnlineSource, *, optional: bool) -> list[str]:
    """Columns to ask for; none means all."""
    named = named_columns(source)
    known = source.known
    if known is None:
        # what isn't configured is found by its UCD among all columns, unless nothing is left to find
        return []
    asked = [name for name in known.columns if optional or name not in known.may_lack]
    asked += [name for name, _ in named.values() if name]
    return list(dict.fromkeys(asked))


def _identifier(name: str) -> str:
    is_plain = _PLAIN_NAME.match(name) and name.lower() not in _RESERVED
    return name if is_plain else '"' + name.replace('"', '""') + '"'


def _table(name: str) -> str:
    """Quote a table whose name is no plain one: VizieR's own names have slashes."""
    proper = table_proper(name)
    parts = proper.split(".")
    return proper if all(_PLAIN_NAME.match(part) for part in parts) else _identifier(proper)


def _address(base: str, arguments: list[tuple[str, str]]) -> str:
    joint = "" if base.endswith(("?", "&")) else "&" if "?" in base else "?"
    return f"{base}{joint}{urlencode(arguments, quote_via=quote)}"
