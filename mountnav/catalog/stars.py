"""Stars round a place at an epoch: the one shape in which every catalog answers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]


class StarFlag(IntFlag):
    """What a catalog warns of; the bits of `Stars.flags`."""

    NO_PROPER_MOTION = 1
    """Stands where it was when it was observed."""
    DOUBTFUL = 2
    """The catalog itself doubts it: seen once, an artifact perhaps, a failed fit."""
    DOUBLE = 4
    """A double star or a blend: the place is a photocenter."""
    EXTENDED = 8
    """A galaxy or nebula rather than a star."""
    NO_MAGNITUDE = 16
    """`mag` is a stand-in (faint), no measurement."""
    OTHER_BAND = 32
    """`mag` is of another band than `Stars.band`, brought to it roughly: no use for photometry."""
    VARIABLE = 64
    """Known to vary."""
    STAND_IN = 128
    """`mag` is in the catalog's band, but of a coarser kind than its other magnitudes."""


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
    band
        The photometric band of `mag`.
    source
        Which catalog.
    color_mag
        Color index `color_name`; NaN where unknown.
    flags
        Bits of `StarFlag`.
    color_name
        "B-V", "BP-RP"; empty if the catalog has no colors.
    steps
        How these stars came here, for provenance: what was asked, what failed, what was taken instead.
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
    color_mag: Array = field(default_factory=lambda: np.zeros(0))
    flags: Flags = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    color_name: str = ""
    steps: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # a catalog without colors or flags needs not say so for each star
        if self.color_mag.size != self.ra_deg.size and self.color_mag.size == 0:
            object.__setattr__(self, "color_mag", np.full(self.ra_deg.size, np.nan))
        if self.flags.size != self.ra_deg.size and self.flags.size == 0:
            object.__setattr__(self, "flags", np.zeros(self.ra_deg.size, dtype=np.uint8))

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Stars:
        """Some of the stars.

        Parameters
        ----------
        chosen : ndarray of int or bool
            Which, in the order wanted.
        """
        return replace(
            self,
            ra_deg=self.ra_deg[chosen],
            dec_deg=self.dec_deg[chosen],
            sigma_arcsec=self.sigma_arcsec[chosen],
            mag=self.mag[chosen],
            pm_ra_cosdec_mas_yr=self.pm_ra_cosdec_mas_yr[chosen],
            pm_dec_mas_yr=self.pm_dec_mas_yr[chosen],
            color_mag=self.color_mag[chosen],
            flags=self.flags[chosen],
        )

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
