"""From a folder of toy files to columns of stars."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.kind import Part
from mountnav.errors import BadCatalog

_SIGMA_MAS = 500.0
"""Position error per coordinate that the toy catalog states for all its stars."""
_SIGMA_PM_MAS_YR = 20.0
"""It has no proper motions: so much a year its stars may have moved, and their errors grow by it."""


class ToyReader:
    """Implements `mountnav.catalog.readers.kind.Reader`; each file is a part."""

    name = "The Toy Catalog"
    band = "V"
    color_name = ""
    epoch_yr = 2000.0

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = files
        self.made_from = f"toy: {len(files)} files"

    def parts(self) -> Sequence[Part]:
        """The files in the order of their names."""
        return [Part(file.name, file, file.stat().st_size) for file in self._files]

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a file."""
        try:
            ra_deg, dec_deg, mag = np.loadtxt(part.path, ndmin=2, unpack=True)
        except ValueError as fault:
            raise BadCatalog(
                f"{fault}", device=str(part.path), advice="each line is: RA Dec V, in degrees and magnitudes"
            ) from fault
        unknown = np.full(ra_deg.size, np.nan)
        sigma = np.full(ra_deg.size, _SIGMA_MAS)
        growth = np.full(ra_deg.size, _SIGMA_PM_MAS_YR)
        epoch = np.full(ra_deg.size, self.epoch_yr)
        yield CatalogColumns(
            ra_deg=ra_deg,
            dec_deg=dec_deg,
            pm_ra_cosdec_mas_yr=unknown,
            pm_dec_mas_yr=unknown,
            mag=mag,
            error_curve=error_curve((sigma, sigma), (growth, growth), (epoch, epoch)),
        )


def open_catalog(path: Path) -> ToyReader:
    """Open a toy file, or a folder of them. Raises `BadCatalog` if there is none."""
    files = sorted(path.glob("*.toy")) if path.is_dir() else [path]
    if not files:
        raise BadCatalog(
            "no toy files (*.toy) here", device=str(path), advice="give the folder that holds them"
        )
    return ToyReader(files)
