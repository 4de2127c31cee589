"""What is read from a Gaia extract, under which names, and in which unit it must come."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

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
    """Check the unit that a file tells.

    Parameters
    ----------
    file, column : str
        For the message.
    quantity : Quantity
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
