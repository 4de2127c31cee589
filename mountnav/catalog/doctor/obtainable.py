"""Star catalogs that an observatory can get: those that the kinds in `mountnav.catalog.readers` declare.

Their counts, depths and sizes are those of the catalogs' own descriptions (CDS I/259, I/284, I/322A; the
ASTAP and Siril projects' pages; a table of the sizes of index files), or estimates:
docs/how-to/catalog-doctor.md says which.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from mountnav.catalog.readers import CATALOGS
from mountnav.catalog.readers.kind import Edition

ONLINE = (
    "or, where there is a network, ask Gaia DR3 as frames come: [[catalogs.online]] "
    'with protocol = "vizier", table = "I/355"'
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObtainableCatalog(Edition):
    """An edition of a kind of catalog, with what is known of its kind.

    Attributes
    ----------
    kind : str
        Of its import: `mountnav catalog import KIND PATH`.
    terms : str
        License or terms of use, in a line.
    """

    kind: str
    terms: str

    @property
    def command(self) -> str:
        """What brings it in, once it is on a disk here."""
        return f"mountnav catalog import {self.kind} {'FILE' if self.is_one_file else 'FOLDER'}"


def obtainable_catalogs() -> tuple[ObtainableCatalog, ...]:
    """All editions of all kinds."""
    return tuple(
        ObtainableCatalog(
            **{field.name: getattr(edition, field.name) for field in fields(edition)},
            kind=kind.name,
            terms=kind.credit.terms,
        )
        for kind in CATALOGS.values()
        for edition in kind.editions
    )


def in_size(gigabytes: float) -> str:
    """A size for people: "620 MB", "2.0 GB"."""
    return f"{gigabytes * 1000:.0f} MB" if gigabytes < 1.0 else f"{gigabytes:.1f} GB"
