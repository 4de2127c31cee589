"""A server's VOTable as plain columns: errors in it are raised, roles and units of the columns are found.

Measured and read traps: VizieR says ``QUERY_STATUS`` ERROR, or ``INFO name="Error"``, with HTTP status 200;
TAP puts OVERFLOW behind the table; cone searches put their error into a PARAM; proxies send HTML; a
connection that ends early leaves a table that parses up to the cut [CATALOGS, §0].
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.request import Got, NotAnswered, Overflow, Unusable, named_columns, quoted
from mountnav.catalog.online.source import OnlineSource

_START = re.compile(rb"<(\w+:)?VOTABLE[\s>]")
_END = re.compile(rb"</(\w+:)?VOTABLE\s*>\s*(<!--.*?-->\s*)*$", re.DOTALL)
_SNIFFED_BYTES = 8192
"""Start of an answer in which <VOTABLE must stand: comments and an XML head come before it; chosen by hand.
Halved, an answer with a long comment at its head would be refused."""
_ENOUGH_OF_THE_END_BYTES = 2048
"""End of an answer in which </VOTABLE> must stand, comments after it included; chosen by hand. An answer
without it was cut off."""
_HTML = re.compile(rb"<(!doctype\s+html|html[\s>])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    ucd : str
        Lower case; empty if it has none.
    unit : str
        As written.
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
            "a web page"
            if _HTML.search(start)
            else f"not a VOTable ({quoted(got.content_type) or 'no type'})"
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


Array = NDArray[np.float64]

_UNIT_OF = {
    "ra": "deg",
    "dec": "deg",
    "e_ra": "mas",
    "e_dec": "mas",
    "e_total": "mas",
    "pm_ra": "mas/yr",
    "pm_dec": "mas/yr",
    "e_pm_ra": "mas/yr",
    "e_pm_dec": "mas/yr",
    "mean_epoch_ra": "yr",
    "mean_epoch_dec": "yr",
}
"""Others are magnitudes."""
_SPELLINGS = {
    "mas.yr-1": "mas/yr",
    "mas.yr**-1": "mas/yr",
    "mas yr-1": "mas/yr",
    "milliarcsec/yr": "mas/yr",
    '"': "arcsec",
    '"/yr': "arcsec/yr",
    "arcsec.yr-1": "arcsec/yr",
    "degrees": "deg",
    "degree": "deg",
    "year": "yr",
    "jyear": "yr",
    "a": "yr",
    "'yr'": "yr",
    "mag(ab)": "mag",
    "mag(vega)": "mag",
    "dex": "mag",
}
_BY_UCD = {
    # new and old forms: UCD1+ and UCD1
    "ra": ("pos.eq.ra;meta.main", "pos_eq_ra_main", "pos.eq.ra"),
    "dec": ("pos.eq.dec;meta.main", "pos_eq_dec_main", "pos.eq.dec"),
    "e_ra": ("stat.error;pos.eq.ra", "stat.error;pos.eq.ra;meta.main"),
    "e_dec": ("stat.error;pos.eq.dec", "stat.error;pos.eq.dec;meta.main"),
    "pm_ra": ("pos.pm;pos.eq.ra", "pos_eq_pmra"),
    "pm_dec": ("pos.pm;pos.eq.dec", "pos_eq_pmdec"),
    "e_pm_ra": ("stat.error;pos.pm;pos.eq.ra",),
    "e_pm_dec": ("stat.error;pos.pm;pos.eq.dec",),
}
_BANDS = ("V", "R", "B", "I")
"""In which order a magnitude is looked for by its UCD, ``phot.mag;em.opt.V`` and so on."""
_FRAMES = ("icrs", "eq_fk5", "fk5", "")


@dataclass(frozen=True, slots=True)
class Roles:
    """The columns of an answer by what they are, in the unit of each role.

    Attributes
    ----------
    values : dict
        Role to values; an absent role has no entry. Lengths mas, years yr, places deg.
    epoch_yr : float
        Julian year of the positions.
    by_name : dict
        All columns, for `FlagRule`.
    is_single : bool
        Positions are in single precision.
    """

    values: dict[str, Array]
    band: str
    color_name: str
    epoch_yr: float
    by_name: dict[str, Column] = field(repr=False)
    is_single: bool = False


def roles_of(columns: Sequence[Column], source: OnlineSource) -> Roles:
    """Tell what the columns of an answer are.

    Parameters
    ----------
    columns : sequence of Column
        At least one.

    Raises
    ------
    Unusable
        Something that must be known can't be told; says what to configure.
    """
    by_name = {one.name: one for one in columns}
    values: dict[str, Array] = {}
    frames: list[Column] = []
    known = source.known
    if known is not None:
        for role, names in known.roles.items():
            found = [_in_unit(role, by_name[name], "") for name in names if name in by_name]
            if found:
                values[role] = _first_given(found)
                frames += [by_name[name] for name in names if name in by_name and role == "ra"]
    else:
        for role in _BY_UCD:
            column = _with_ucd(columns, _BY_UCD[role])
            if column is not None and role not in source.columns:
                if role == "pm_ra":
                    _require_true_angle(column)
                values[role] = _in_unit(role, column, "")
                frames += [column] if role == "ra" else []
    band = source.band or (known.band if known else "")
    if known is None and "mag" not in source.columns:
        band, values["mag"] = _magnitude(columns, source.band)
    for role, (name, unit) in named_columns(source).items():
        values.pop(role, None)
        if name:
            if name not in by_name:
                raise Unusable(f"there is no column {name}, which `columns` calls {role}")
            values[role] = _in_unit(role, by_name[name], unit)
            frames = [by_name[name]] if role == "ra" else frames
    for role in ("ra", "dec", "mag"):
        if role not in values:
            raise Unusable(f'can\'t determine the column of {role}: set columns = {{{role} = "..."}}')
    if not band:
        raise Unusable("can't determine the band of the magnitudes: set band")
    for frame in (one.frame for one in frames):
        if frame.lower() not in _FRAMES:
            raise Unusable(f"positions are in {quoted(frame)}, not ICRS: use another table or columns")
    return Roles(
        values=_both_or_neither(values),
        band=band,
        color_name=known.color_name if known else ("color" if "color" in values else ""),
        epoch_yr=_epoch_yr(source, frames),
        by_name=by_name,
        is_single=any(one.is_single for one in frames),
    )


def _epoch_yr(source: OnlineSource, positions: list[Column]) -> float:
    if source.epoch_yr is not None:
        return source.epoch_yr
    if source.known is not None:
        return source.known.epoch_yr
    told = {one.epoch_yr for one in positions if one.epoch_yr is not None}
    if len(told) != 1:
        raise Unusable("can't determine the epoch of its positions: set epoch_yr")
    return float(told.pop())


def _with_ucd(columns: Sequence[Column], ucds: tuple[str, ...]) -> Column | None:
    for ucd in ucds:
        found = [one for one in columns if one.ucd == ucd and one.is_number]
        if len(found) == 1 or (found and "meta.main" in ucd):
            return found[0]
        if found:
            raise Unusable(
                f"several columns have the UCD {ucd} ({', '.join(one.name for one in found)}): set columns"
            )
    return None


def _magnitude(columns: Sequence[Column], band: str | None) -> tuple[str, Array]:
    for one in (band,) if band else _BANDS:
        wanted = {
            f"phot.mag;em.opt.{one}".lower(),
            f"phot_jhn_{one}".lower(),
            f"phot.mag;em.ir.{one}".lower(),
        }
        found = [column for column in columns if column.ucd in wanted and column.is_number]
        if found:
            return one, _in_unit("mag", found[0], "")
    what = f"a magnitude of band {band}" if band else "the magnitude"
    raise Unusable(f'can\'t determine the column of {what}: set columns = {{mag = "..."}} and band')


def _require_true_angle(column: Column) -> None:
    """A proper motion in RA is used only if it is sure to be one on the sphere, with cos δ."""
    if not re.search(r"cos|\*", f"{column.name} {column.description}", re.IGNORECASE):
        raise Unusable(
            f"can't determine whether {column.name} is multiplied by cos(Dec): "
            f'set columns = {{pm_ra = "{column.name}"}} if it is, {{pm_ra = "", pm_dec = ""}} if not'
        )


def _in_unit(role: str, column: Column, given: str) -> Array:
    """Values of a column in the unit of its role."""
    if not column.is_number:
        raise Unusable(f"column {column.name} holds text, not numbers in {_UNIT_OF.get(role, 'mag')}")
    wanted = _UNIT_OF.get(role, "mag")
    unit = (given or column.unit).strip()
    if not unit:
        # cone searches give degrees by their standard; magnitudes and years are hardly anything else
        if wanted in ("mas", "mas/yr"):
            raise Unusable(
                f'column {column.name} has no unit: set columns = {{{role} = "{column.name} [{wanted}]"}}'
            )
        return np.asarray(column.values, dtype=np.float64)
    scale = _scale(unit, wanted)
    if scale is None:
        raise Unusable(f"column {column.name} is in {quoted(unit)}, which is not in {wanted}")
    return np.asarray(column.values * scale, dtype=np.float64)


def _scale(unit: str, wanted: str) -> float | None:
    from astropy import units

    plain = _SPELLINGS.get(unit.lower().replace(" ", ""), _SPELLINGS.get(unit.lower(), unit))
    if plain == wanted:
        return 1.0
    parsed = units.Unit(plain, parse_strict="silent")
    if isinstance(parsed, units.UnrecognizedUnit) or wanted == "mag":
        return None
    try:
        return float(parsed.to(units.Unit(wanted)))
    except units.UnitConversionError:
        return None


def _first_given(found: list[Array]) -> Array:
    values = found[0]
    for other in found[1:]:
        values = np.where(np.isnan(values), other, values)
    return values


def _both_or_neither(values: dict[str, Array]) -> dict[str, Array]:
    for one, other in (("pm_ra", "pm_dec"), ("e_pm_ra", "e_pm_dec")):
        if (one in values) != (other in values):
            values.pop(one, None)
            values.pop(other, None)
    return values
