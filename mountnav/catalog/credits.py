"""Credit and terms of use of the embedded and imported catalogs (docs/reference/catalog-licenses.md)."""

from __future__ import annotations

from mountnav.catalog.readers import credit_of
from mountnav.catalog.readers.kind import Credit

__all__ = ["EMBEDDED", "credit_of"]

EMBEDDED = Credit(
    "BSD-2-Clause, as Debian's package tycho2 has it; TYCHO2-NOTICE.txt goes wherever the data goes",
    "The Tycho-2 Catalogue: Høg et al., A&A 355, L27 (2000); observations of the ESA Hipparcos satellite.",
)
