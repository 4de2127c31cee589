"""A VOTable as servers send it becomes plain columns; every way of saying "error" in it is heard.

Measured and read traps: VizieR says ``QUERY_STATUS`` ERROR, or ``INFO name="Error"``, with HTTP status 200;
TAP puts OVERFLOW behind the table; cone searches put their error into a PARAM; proxies send HTML; a
connection that ends early leaves a table that parses up to the cut [CATALOGS, §0].
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.getting import Got
from mountnav.catalog.online.refusals import NotAnswered, Overflow, Unusable, quoted

_START = re.compile(rb"<(\w+:)?VOTABLE[\s>]")
_END = re.compile(rb"</(\w+:)?VOTABLE\s*>\s*(<!--.*?-->\s*)*$", re.DOTALL)
_SNIFFED_BYTES = 8192
_ENOUGH_OF_THE_END_BYTES = 2048
_HTML = re.compile(rb"<(!doctype\s+html|html[\s>])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    name : str
    ucd : str
        Lower case; empty if it has none.
    unit : str
        As written.
    description : str
    epoch_yr : float or None
        Of the coordinate system it refers to.
    frame : str
        Name of that system, such as "ICRS" or "eq_FK5"; empty if it refers to none.
    values : ndarray, shape (n,)
        float64 with NaN where there is none; text as str.
    is_single : bool
        The server gives it in single precision.
    """

    name: str
    ucd: str
    unit: str
    description: str
    epoch_yr: float | None
    frame: str
    values: NDArray[Any]
    is_single: bool = False

    @property
    def is_number(self) -> bool:
        """Whether `values` are numbers."""
        return self.values.dtype.kind == "f"


def columns_of(got: Got, *, asked_rows: int) -> tuple[Column, ...]:
    """Read an answer.

    Parameters
    ----------
    got : Got
    asked_rows : int
        The most rows asked for: as many are taken for a cut answer.

    Returns
    -------
    tuple of Column
        None if the server has nothing there and says so without a table.

    Raises
    ------
    NotAnswered
        An HTTP error.
    Unusable
        No VOTable, or an error inside it.
    Overflow
        It is cut.
    """
    body = got.body.strip()
    start = body[:_SNIFFED_BYTES]
    if not _START.search(start):
        if got.status >= 400:
            raise NotAnswered(f"HTTP status {got.status}{_said(start, got)}")
        what = (
            "a web page" if _HTML.search(start) else f"no VOTable ({quoted(got.content_type) or 'no type'})"
        )
        raise Unusable(f"its answer is {what}{_said(start, got)}")
    if b"<!ENTITY" in start:
        raise Unusable("its answer defines XML entities, which no catalog needs")
    if not _END.search(body[-_ENOUGH_OF_THE_END_BYTES:]):
        raise NotAnswered("the answer was cut in the middle")
    document = _parsed(body)
    _heed(document, got.status)
    tables = [(one, of) for of in _resources(document) for one in of.tables]
    if not tables:
        return ()
    table = next((one for one, of in tables if of.type == "results"), tables[0][0])
    rows = len(table.array)
    if rows >= asked_rows or rows in _USUAL_LIMITS:
        raise Overflow(f"its answer ends after {rows} rows")
    systems = {one.ID: one for one in document.iter_coosys()}
    return tuple(_column(one, table.array, systems.get(one.ref)) for one in table.fields)


_USUAL_LIMITS = frozenset(k * 10**p for p in (3, 4, 5) for k in (1, 2, 3, 5))
"""Where servers cut without a word; a tile that really has so many stars is split in vain."""


def _parsed(body: bytes) -> Any:
    from astropy.io import votable

    try:
        # "ignore": other people's tables are sloppy; what is used of them is checked afterwards
        return votable.parse(io.BytesIO(body), verify="ignore")
    except Exception as broken:  # astropy's reader lets through whatever its parts raise
        raise Unusable(f"its VOTable can't be read: {quoted(str(broken))}") from broken


def _resources(owner: Any) -> Iterator[Any]:
    for resource in owner.resources:
        yield resource
        yield from _resources(resource)


def _statements(document: Any) -> Iterator[tuple[str, str, str]]:
    """All INFO and PARAM elements, wherever they stand: name, value, text."""
    owners = [document, *_resources(document)]
    owners += [table for owner in owners[1:] for table in owner.tables]
    for owner in owners:
        for one in (*owner.infos, *owner.params):
            name = one.name or one.ID or ""
            yield name.lower(), str(one.value or ""), str(getattr(one, "content", None) or "")


def _heed(document: Any, status: int) -> None:
    """Refuse an answer that says error or overflow in any of the ways that are in use."""
    said = list(_statements(document))
    errors = [quoted(f"{value} {text}") for name, value, text in said if name == "error"]
    errors += [
        quoted(text) for name, value, text in said if name == "query_status" and value.upper() == "ERROR"
    ]
    if errors:
        words = next((one for one in errors if one), "no reason given")
        raise Unusable(f"the server says ERROR: {words}")
    if status >= 400:
        raise NotAnswered(f"HTTP status {status}")
    for name, value, text in said:
        is_status = name == "query_status" and value.upper() == "OVERFLOW"
        if is_status or (name == "warning" and "truncated" in f"{value} {text}".lower()):
            raise Overflow(f"the server says OVERFLOW {quoted(text or value)}".rstrip())


def _column(field: Any, rows: Any, system: Any) -> Column:
    raw = rows[field.ID]
    if raw.dtype.kind in "iufb" and raw.ndim == 1:
        values = np.where(np.ma.getmaskarray(raw), np.nan, raw.data.astype(np.float64))
    else:
        values = np.array([_text(one) for one in raw.data], dtype=str)
    return Column(
        name=field.name or field.ID,
        ucd=(field.ucd or "").lower(),
        unit="" if field.unit is None else str(field.unit),
        description=field.description or "",
        epoch_yr=None if system is None else _year(system.epoch),
        frame="" if system is None else (system.system or ""),
        values=values,
        is_single=raw.dtype == np.float32,
    )


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _year(epoch: str | None) -> float | None:
    """2016.0 from "J2016.0", "2016.000" or "2016"; None from anything else."""
    found = re.fullmatch(r"\s*J?(\d{4}(\.\d*)?)\s*", epoch or "")
    return float(found[1]) if found else None


def _said(start: bytes, got: Got) -> str:
    """The first words of an answer that is no table, if they are words."""
    if _HTML.search(start):
        title = re.search(rb"<title[^>]*>(.*?)</title>", start, re.IGNORECASE | re.DOTALL)
        words = title[1] if title else b""
    else:
        words = start if got.content_type.startswith("text/") else b""
    text = quoted(words.decode("utf-8", "replace"))
    return f": {text}" if text else ""
