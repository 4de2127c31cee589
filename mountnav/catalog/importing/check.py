"""The last look before an imported catalog is put in its place: stars of the source are asked of the file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.importing.selection import Selection, rows_of
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import Part, Reader
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.sky.coordinates import Icrs

PARTS_READ = 12
STARS_OF_A_PART = 12
"""The two faintest and brightest, and others spread evenly over the first chunk."""
_RADIUS_DEG = 0.01 / 3600.0
"""Wide against the steps of the packed form (0.3 mas), narrow against the distance of any two stars."""
_MAG_STEP = 0.0011
_PM_STEP_MAS_YR = 0.11
_COLOR_STEP = 0.0011


def compare_with_source(
    store: PackedStore, reader: Reader, parts: Sequence[Part], selection: Selection
) -> int:
    """Read some parts again and ask the packed file for their stars.

    Parameters
    ----------
    store : PackedStore
        The new file.
    reader : Reader
    parts : sequence of Part
        All that went in.
    selection : Selection
        What of them.

    Returns
    -------
    int
        How many stars were compared.

    Raises
    ------
    BadCatalog
        One isn't there, or is another.
    """
    compared = 0
    for number in np.unique(np.linspace(0, len(parts) - 1, min(PARTS_READ, len(parts))).astype(int)):
        part = parts[int(number)]
        for columns in reader.read(part):
            stars = selection.of(columns)
            if stars.ra_deg.size == 0:
                continue
            for row in _spread(stars.mag):
                _compare(store, part, rows_of(stars, np.array([row])))
                compared += 1
            break  # the first chunk that holds something wanted is enough
    return compared


def _spread(mag: NDArray[np.float64]) -> list[int]:
    evenly = np.linspace(0, mag.size - 1, min(STARS_OF_A_PART - 2, mag.size)).astype(int)
    return sorted({int(row) for row in (*evenly, np.argmin(mag), np.argmax(mag))})


def _compare(store: PackedStore, part: Part, star: CatalogColumns) -> None:
    ra_deg, dec_deg, mag = float(star.ra_deg[0]), float(star.dec_deg[0]), float(star.mag[0])
    found = store.cone(Icrs(ra_deg % 360.0, dec_deg), _RADIUS_DEG, epoch_yr=store.header.epoch_yr)
    alike = _near(found.mag, mag, _MAG_STEP)
    alike &= _near(found.pm_ra_cosdec_mas_yr, float(star.pm_ra_cosdec_mas_yr[0]), _PM_STEP_MAS_YR)
    alike &= _near(found.pm_dec_mas_yr, float(star.pm_dec_mas_yr[0]), _PM_STEP_MAS_YR)
    if star.flags is not None:
        # the packed form says so of every star without a proper motion, whether its reader did or not
        still = StarFlag.NO_PROPER_MOTION if np.isnan(star.pm_dec_mas_yr[0]) else 0
        alike &= found.flags == star.flags[0] | still
    if star.color_mag is not None:
        alike &= _near(found.color_mag, float(star.color_mag[0]), _COLOR_STEP)
    if not alike.any():
        raise BadCatalog(
            f"the star of magnitude {mag:.3f} at RA {ra_deg:.7f}°, Dec {dec_deg:.7f}° of {part.name} "
            f"isn't in the file that was made of it ({len(found)} stars there, none like it)",
            device=str(store.path),
            advice="a fault of mountnav, or the source was changed meanwhile: import it again, and report it "
            "if it stays",
        )


def _near(found: NDArray[np.float64], wanted: float, step: float) -> NDArray[np.bool_]:
    alike: NDArray[np.bool_] = np.isnan(found) if np.isnan(wanted) else np.abs(found - wanted) <= step
    return alike
