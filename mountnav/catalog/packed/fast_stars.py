"""Stars that move far: a few thousand are looked at in each query, so that the rest needs little padding.

Barnard's star moves 4.6′ in 27 years. A query of 0.3° that had to be padded by that would read 40 % more
stars on 113 million (CPU: 5 %), one of a deeper catalog more still. And any single error in a source, a
motion of 1000 arcsec/yr, would make every query a wide one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import DEC_STEP_DEG, PM_STEP_MAS_YR, RA_STEP_DEG
from mountnav.catalog.space_motion import motion_vectors, unit_vectors

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FAST_LIMITS_MAS_YR = (500.0, 1000.0, 2000.0, 3276.6)
"""What "fast" may mean; the last is what a record can hold."""
MOST_FAST = 10_000
"""Looking at so many takes 0.04 ms. The sky has about 5000 stars above 0.5 arcsec/yr; a catalog made from old
plates claims more."""


def fast_limit(counts: Sequence[int]) -> tuple[float, int]:
    """Choose what fast means for a catalog.

    Parameters
    ----------
    counts : sequence of int
        How many of its stars are faster than each of `FAST_LIMITS_MAS_YR`.

    Returns
    -------
    (float, int)
        The lowest limit [mas/yr] that leaves no more than `MOST_FAST` stars, else the highest; their number.
    """
    for limit, count in zip(FAST_LIMITS_MAS_YR, counts, strict=True):
        if count <= MOST_FAST:
            return limit, count
    return FAST_LIMITS_MAS_YR[-1], counts[-1]


@dataclass(frozen=True, slots=True)
class FastStars:
    """Place and motion of the fast stars of a packed file.

    Attributes
    ----------
    rows
        Their numbers in the section ``stars``, rising; shape (n,).
    places
        Unit vectors at the file's epoch, shape (3, n).
    motions
        rad/yr, shape (3, n).
    """

    rows: Indices
    places: Array
    motions: Array

    @classmethod
    def of(cls, fast: NDArray[np.void]) -> FastStars:
        """From the section ``fast`` of version 2."""
        ra_deg, dec_deg = fast["ra"] * RA_STEP_DEG, fast["dec"] * DEC_STEP_DEG
        pm_ra, pm_dec = fast["pm_ra"] * PM_STEP_MAS_YR, fast["pm_dec"] * PM_STEP_MAS_YR
        return cls(
            fast["star"].astype(np.int64),
            unit_vectors(ra_deg, dec_deg),
            motion_vectors(ra_deg, dec_deg, pm_ra, pm_dec),
        )

    def near(self, axis: Array, radius_rad: float, years: float) -> Indices:
        """Rows of those that may be in a cone after some years.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the center.
        radius_rad, years : float
        """
        fastest_rad = float(np.sqrt((self.motions**2).sum(axis=0).max(initial=0.0))) * abs(years)
        if radius_rad + fastest_rad < np.pi / 2:
            some = np.flatnonzero(axis @ self.places >= np.cos(radius_rad + fastest_rad + 1e-6))
        else:
            some = np.arange(self.rows.size)
        moved = self.places[:, some] + self.motions[:, some] * years
        chord = moved / np.sqrt((moved**2).sum(axis=0)) - axis[:, np.newaxis]
        # a little more than the cone: the last word is spoken where all stars are judged
        reach = 2.0 * np.sin(min(radius_rad + 1e-6, np.pi) / 2.0)
        rows: Indices = self.rows[some[(chord**2).sum(axis=0) <= reach**2 * (1.0 + 1e-12)]]
        return rows
