"""Which column is what: configured, known of the table, or told by its UCD; and in which unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.answer import Column
from mountnav.catalog.online.question import named_columns
from mountnav.catalog.online.refusals import Unusable, quoted
from mountnav.catalog.online.source import OnlineSource

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
    band : str
    color_name : str
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
    source : OnlineSource

    Returns
    -------
    Roles

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
            raise Unusable(f'can\'t tell the column of {role}: set columns = {{{role} = "..."}}')
    if not band:
        raise Unusable("can't tell the band of the magnitudes: set band")
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
        raise Unusable("can't tell the epoch of its positions: set epoch_yr")
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
    raise Unusable(f'can\'t tell the column of {what}: set columns = {{mag = "..."}} and band')


def _require_true_angle(column: Column) -> None:
    """A proper motion in RA is used only if it is sure to be one on the sphere, with cos δ."""
    if not re.search(r"cos|\*", f"{column.name} {column.description}", re.IGNORECASE):
        raise Unusable(
            f"can't tell whether {column.name} is multiplied by cos(Dec): "
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
        raise Unusable(f"column {column.name} is in {quoted(unit)}, which is no {wanted}")
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
