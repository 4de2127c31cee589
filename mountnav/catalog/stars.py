"""Stars round a place at an epoch: the one shape in which every catalog answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stars:
    """Catalog stars, brightest first; each array has shape (n,).

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS, moved to `epoch_yr` by proper motion.
    sigma_arcsec
        One-sigma position error per coordinate at `epoch_yr`.
    mag
        Magnitude in `band`.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        Proper motion; NaN where the catalog has none.
    epoch_yr
        Julian year the positions hold for.
    source
        Which catalog.
    """

    ra_deg: Array
    dec_deg: Array
    sigma_arcsec: Array
    mag: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    epoch_yr: float
    band: str
    source: str

    def __len__(self) -> int:
        return int(self.ra_deg.size)


class Catalog(Protocol):
    """What a catalog can do. The solver and the simulator know nothing else."""

    @property
    def name(self) -> str:
        """Name for provenance."""
        ...

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first."""
        ...
