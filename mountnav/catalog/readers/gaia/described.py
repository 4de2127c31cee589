"""Column descriptions in astropy's YAML: at the head of ECSV files, and in the Parquet files it writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mountnav.catalog.readers.gaia.epochs import epoch_of_label


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
        """Unit of a column; empty if none is told."""
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
    """Read the YAML; what can't be read tells nothing.

    Parameters
    ----------
    text : str

    Returns
    -------
    Described
    """
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
