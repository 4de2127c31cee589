"""Whole catalogs as their readers read them, and the errors of their positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import open_reader


def read_all(kind: str, path: Path) -> CatalogColumns:
    """All stars of all parts, in the reader's order."""
    reader = open_reader(kind, path)
    chunks = [chunk for part in reader.parts() for chunk in reader.read(part)]
    colors = [chunk.color_mag for chunk in chunks if chunk.color_mag is not None]
    return CatalogColumns(
        np.concatenate([chunk.ra_deg for chunk in chunks]),
        np.concatenate([chunk.dec_deg for chunk in chunks]),
        np.concatenate([chunk.pm_ra_cosdec_mas_yr for chunk in chunks]),
        np.concatenate([chunk.pm_dec_mas_yr for chunk in chunks]),
        np.concatenate([chunk.mag for chunk in chunks]),
        np.concatenate([chunk.error_curve for chunk in chunks]),
        np.concatenate(colors) if colors else None,
        np.concatenate([chunk.flags for chunk in chunks if chunk.flags is not None]),
    )


def sigma_mas(columns: CatalogColumns, epoch_yr: float) -> np.ndarray:
    """One sigma of each position at an epoch, mas."""
    t = epoch_yr - 2000.0
    sigma: np.ndarray = np.sqrt(columns.error_curve @ np.array([1.0, t, t * t]))
    return sigma
