"""Packed catalogs of the invented sky: round some places, or the whole of it piece by piece."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy_healpix import healpix_to_lonlat, lonlat_to_healpix, neighbours

from mountnav.catalog.packed.format import Header
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.simulation.sky_catalogs import SkyCatalog
from mountnav.simulation.sky_cells import NSIDE
from mountnav.sky.coordinates import Icrs

_PIECE_NSIDE = 8
PIECES = 12 * _PIECE_NSIDE**2
_PIECE_RADIUS_DEG = 7.6  # a pixel's corner is at most 7.5° from its middle


def whole_sky(
    catalog: SkyCatalog, pieces: Iterable[int] = range(PIECES)
) -> Iterator[tuple[str, CatalogColumns]]:
    """All of the invented sky, piece by piece: a catalog of any size to try an import with.

    Parameters
    ----------
    catalog : SkyCatalog
        "ucac4" has a hundred million stars.
    pieces : iterable of int
        Which of the `PIECES`.

    Yields
    ------
    name : str
        Of the piece.
    columns : CatalogColumns
        A piece of 54 square degrees; each star is in one.
    """
    lon, lat = healpix_to_lonlat(np.arange(PIECES), nside=_PIECE_NSIDE, order="nested")
    each = (NSIDE // _PIECE_NSIDE) ** 2
    for piece in pieces:
        middle = Icrs(float(lon[piece].to_value(u.deg)), float(lat[piece].to_value(u.deg)))
        inner = np.arange(piece * each, (piece + 1) * each)
        # errors and motions bring stars in from the cells around
        with np.errstate(invalid="ignore"):  # where only seven are there, the eighth is -1
            around = neighbours(inner, NSIDE, order="nested").ravel()
        cells = np.unique(np.concatenate([inner, around]))
        found = catalog.listed(middle, _PIECE_RADIUS_DEG, cells[cells >= 0])
        columns = found.columns(catalog.kind.observed_yr)
        own = lonlat_to_healpix(
            columns.ra_deg * u.deg, columns.dec_deg * u.deg, nside=_PIECE_NSIDE, order="nested"
        ) == piece  # fmt: skip
        yield (
            f"piece {piece}",
            CatalogColumns(**{one.name: getattr(columns, one.name)[own] for one in fields(CatalogColumns)}),
        )


def write_store(
    path: Path, catalog: SkyCatalog, cones: Sequence[tuple[Icrs, float]], *, nside: int = 64
) -> Header:
    """Pack what a catalog states of some pieces of the invented sky.

    Parameters
    ----------
    path : Path
        The file to write.
    catalog : SkyCatalog
    cones : sequence of (Icrs, float)
        Centers and radii in degrees.
    nside : int
        As for `mountnav.catalog.packed.packing.pack`.

    Returns
    -------
    Header
        As written.
    """
    kind = catalog.kind
    columns = catalog.columns(cones)
    return pack(
        columns,
        path,
        name=catalog.name,
        band=kind.band,
        epoch_yr=kind.epoch_yr,
        nside=nside,
        color_name=kind.color_name,
        made_from=f"an invented sky, seed {catalog.seed}",
    )
