"""What is read from a Gaia extract: quantities, their units and epoch; the interface of its file formats."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from numpy.typing import NDArray

from mountnav.errors import BadCatalog

_WITHOUT = "take it from the Gaia archive with the columns ra, dec, ref_epoch and phot_g_mean_mag at least"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity and its names, all in lower case: the Gaia archive's first, then VizieR's.

    Attributes
    ----------
    names : tuple of str
        Where two of them are there, the first counts.
    unit : str
        "deg", "mas", "mas/yr", "yr", "mag", or empty for what has none.
    kind : str
        "number", "truth", "text" or "whole" (an integer that must not lose digits).
    """

    names: tuple[str, ...]
    unit: str = ""
    kind: str = "number"


QUANTITIES: dict[str, Quantity] = {
    "ra": Quantity(("ra", "ra_icrs", "radeg"), "deg"),
    "dec": Quantity(("dec", "de_icrs", "dedeg"), "deg"),
    "ref_epoch": Quantity(("ref_epoch", "refepoch"), "yr"),
    "ra_error": Quantity(("ra_error", "e_ra_icrs", "e_radeg"), "mas"),
    "dec_error": Quantity(("dec_error", "e_de_icrs", "e_dedeg"), "mas"),
    "pmra": Quantity(("pmra",), "mas/yr"),
    "pmdec": Quantity(("pmdec", "pmde"), "mas/yr"),
    "pmra_error": Quantity(("pmra_error", "e_pmra"), "mas/yr"),
    "pmdec_error": Quantity(("pmdec_error", "e_pmde"), "mas/yr"),
    "g": Quantity(("phot_g_mean_mag", "gmag"), "mag"),
    "bp": Quantity(("phot_bp_mean_mag", "bpmag"), "mag"),
    "rp": Quantity(("phot_rp_mean_mag", "rpmag"), "mag"),
    "bp_rp": Quantity(("bp_rp", "bp-rp"), "mag"),
    "ruwe": Quantity(("ruwe",)),
    "duplicated": Quantity(("duplicated_source", "dup"), kind="truth"),
    "solved": Quantity(("astrometric_params_solved", "solved")),
    "variable": Quantity(("phot_variable_flag", "varflag"), kind="text"),
    "galaxy": Quantity(("in_galaxy_candidates", "gal"), kind="truth"),
    "non_single": Quantity(("non_single_star", "nss")),
    "source_id": Quantity(("source_id", "source"), kind="whole"),
    "designation": Quantity(("designation", "dr3name"), kind="text"),
}

REQUIRED = ("ra", "dec", "g")

_SPELLINGS: dict[str, frozenset[str]] = {
    "deg": frozenset({"deg", "degree", "degrees", "degs", "°"}),
    "mas": frozenset({"mas", "marcsec", "milliarcsec", "milliarcsecond", "milliarcseconds"}),
    "mas/yr": frozenset(
        {"mas/yr", "mas/a", "mas/year", "mas.yr**-1", "mas*yr**-1", "mas.yr-1", "masyr-1", "masyr**-1"}
        | {"masyr^-1", "mas.yr^-1", "yr-1mas", "yr**-1.mas", "yr^-1mas"}
    ),
    "yr": frozenset({"yr", "a", "year", "years", "julianyear", "julianyears", "jyear"}),
    "mag": frozenset({"mag", "mags", "magnitude", "mag(vega)"}),
}


def found_columns(file: str, names: Iterable[str]) -> dict[str, str]:
    """Find the quantities in a file.

    Parameters
    ----------
    file : str
        For messages.
    names : iterable of str
        The columns as the file has them; their case doesn't matter.

    Returns
    -------
    dict
        Name of the column by quantity.

    Raises
    ------
    BadCatalog
        A required one isn't there, or there are two columns of one name.
    """
    by_lower: dict[str, str] = {}
    twice = set()
    for name in names:
        lower = name.strip().lower()
        if lower in by_lower:
            twice.add(lower)
        by_lower[lower] = name
    found = {}
    for key, quantity in QUANTITIES.items():
        for name in quantity.names:
            if name in by_lower:
                if name in twice:
                    raise BadCatalog(f"has two columns {name!r}", device=file, advice="remove one of them")
                found[key] = by_lower[name]
                break
    missing = [" or ".join(QUANTITIES[key].names) for key in REQUIRED if key not in found]
    if missing:
        raise BadCatalog(
            f"has no column {', none '.join(missing)}; there are: {_shortened(by_lower.values())}",
            device=file,
            advice=_WITHOUT,
        )
    return found


def require_unit(file: str, column: str, quantity: Quantity, unit: str) -> None:
    """Check the unit that a file states.

    Parameters
    ----------
    file, column : str
        For the message.
    unit : str
        Empty where the file tells none: then the archive's unit holds.

    Raises
    ------
    BadCatalog
        It is another unit, or one that isn't understood.
    """
    told = unit.strip()
    if not quantity.unit or not told:
        return
    # Gaia's own FITS files of the first release write "Angle[deg]"
    bracketed = re.search(r"\[(.*)\]\s*$", told)
    plain = re.sub(r"[\s'\"]+", "", bracketed[1] if bracketed else told).lower()
    if plain not in _SPELLINGS[quantity.unit]:
        raise BadCatalog(
            f"column {column!r} is in {told!r}, expected {quantity.unit!r}",
            device=file,
            advice="save it in the archive's units",
        )


def _shortened(names: Iterable[str]) -> str:
    listed = list(names)
    return ", ".join(listed[:20]) + (f" and {len(listed) - 20} more" if len(listed) > 20 else "")


RELEASE_EPOCHS_YR = {"1": 2015.0, "2": 2015.5, "3": 2016.0}
"""Reference epochs of the data releases [Gaia archive, gaia_source.ref_epoch]; EDR3 is as DR3."""
VIZIER_EPOCHS_YR = {"337": 2015.0, "345": 2015.5, "350": 2016.0, "355": 2016.0}
"""Of VizieR's catalogs I/337 (DR1), I/345 (DR2), I/350 (EDR3), I/355 (DR3) [their ReadMe: RA_ICRS at Ep]."""
EARLIEST_YR, LATEST_YR = 1980.0, 2100.0
"""What a column of epochs may hold: people move their extracts, and days or seconds are far off."""

ADVICE = (
    "ten years of proper motion depend on it: add ref_epoch to the query's columns (or, from VizieR, save it "
    "as a VOTable, which tells the epoch)"
)

_RELEASE = re.compile(r"gaia[ _]*e?dr([123])(?!\d)", re.IGNORECASE)
_VIZIER = re.compile(r"\bI[/_](337|345|350|355)(?!\d)")
_EPOCH = re.compile(r"\bEp(?:och)?\s*=\s*J?(20[123]\d(?:\.\d+)?)(?!\d)", re.IGNORECASE)
# J2000 is an equinox as a rule, no epoch of Gaia's
_YEAR = re.compile(r"^\s*J?\s*(20[123]\d(?:\.\d*)?)\s*$", re.IGNORECASE)


def epoch_of_label(label: str) -> float | None:
    """Read an epoch such as "J2016.0" or "2016"; None if it is none that can be Gaia's."""
    year = _YEAR.match(label)
    return float(year[1]) if year else None


def epoch_in_texts(file: str, texts: Iterable[str]) -> float | None:
    """Look for the epoch in what a file states about itself.

    Parameters
    ----------
    file : str
        For the message.
    texts : iterable of str
        Descriptions, comments, the query, the release.

    Returns
    -------
    float or None
        Julian year; None if nothing tells it.

    Raises
    ------
    BadCatalog
        Two different epochs are told.
    """
    found: set[float] = set()
    for text in texts:
        found |= {RELEASE_EPOCHS_YR[release] for release in _RELEASE.findall(text)}
        found |= {VIZIER_EPOCHS_YR[number] for number in _VIZIER.findall(text)}
        found |= {float(year) for year in _EPOCH.findall(text)}
    if len(found) > 1:
        raise BadCatalog(
            f"has several epochs, {', '.join(str(year) for year in sorted(found))}, and has no column "
            "ref_epoch",
            device=file,
            advice=ADVICE,
        )
    return found.pop() if found else None


def unknown_epoch(file: str) -> BadCatalog:
    """Make the error for a file that doesn't state the epoch of its positions."""
    return BadCatalog("doesn't give the epoch of its positions", device=file, advice=ADVICE)


@dataclass(frozen=True, slots=True)
class Described:
    """What the YAML says.

    Attributes
    ----------
    columns : dict
        Its entry by column name.
    fields : dict
        The other entries.
    """

    columns: Mapping[str, Mapping[str, Any]]
    fields: Mapping[str, Any]

    def unit(self, name: str) -> str:
        """Unit of a column; empty if none is stated."""
        return str(self.columns.get(name, {}).get("unit", "") or "")

    def epoch_yr(self, ra_column: str) -> float | None:
        """Epoch of the column's coordinate system, as the Gaia archive notes it."""
        meta = self.columns.get(ra_column, {}).get("meta")
        label = meta.get("CoosysEpoch") if isinstance(meta, dict) else None
        return None if label is None else epoch_of_label(str(label))

    def texts(self) -> list[str]:
        """Everything it says in words."""
        return [str(entry.get("description", "")) for entry in self.columns.values()] + [
            str(value) for value in self.fields.values()
        ]


def described_columns(text: str) -> Described:
    """Read the YAML; what can't be read is passed over."""
    if not text.strip():
        return Described({}, {})
    from astropy.table.meta import YamlParseError, get_header_from_yaml

    try:
        header = get_header_from_yaml(text.splitlines())
    except (YamlParseError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return Described({}, {})
    if not isinstance(header, dict):
        return Described({}, {})
    entries = header.get("datatype")
    columns = {
        str(entry["name"]): entry
        for entry in (entries if isinstance(entries, list) else [])
        if isinstance(entry, dict) and "name" in entry
    }
    meta = header.get("meta")
    return Described(columns, meta if isinstance(meta, dict) else {})


LARGEST_CHUNK = 400_000
"""Stars in a chunk, below what `Reader.read` promises."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows of a file that are read as a whole.

    Attributes
    ----------
    first, end : int
        Rows, row groups or bytes, as the format counts.
    """

    first: int
    end: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Block:
    """Some rows of a file.

    Attributes
    ----------
    values : dict
        Arrays by quantity, shape (n,): numbers and truth values (1, 0) as float64, NaN where there is none;
        whole numbers as int64, 0 where there is none; texts as str.
    error_at : callable
        Makes the error for a row of the block: (row, expected, found) -> BadCatalog.
    """

    values: dict[str, NDArray[Any]]
    error_at: Callable[[int, str, str], BadCatalog]


@dataclass(frozen=True, slots=True)
class Layout:
    """What the head of a file states.

    Attributes
    ----------
    columns : dict
        The file's column by quantity (keys of `mountnav.catalog.readers.gaia.tables.QUANTITIES`).
    epoch_yr : float or None
        Where no column has it: as told by the coordinate system, a description, the release.
    """

    columns: Mapping[str, str]
    epoch_yr: float | None = field(default=None)


class TableFile(Protocol):
    """A table on disk."""

    @property
    def layout(self) -> Layout:
        """What its head states."""
        ...

    def pieces(self) -> Sequence[Piece]:
        """The file in pieces that are read one by one, in a fixed order."""
        ...

    def blocks(self, piece: Piece, quantities: Sequence[str]) -> Iterator[Block]:
        """The rows of a piece, some at a time, with the quantities asked for. Raises `BadCatalog`."""
        ...
