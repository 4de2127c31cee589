"""How a mount gets rates beside the sidereal one wrong: what it keeps of those that it was ordered.

Each fault is one that real mounts and drivers have had: a sign (ASCOM's own simulator), a unit (seconds of
right ascension for seconds of arc, 15.04; per sidereal second, 1.0027; a gear's factor, 220), axes for each
other, a rate that is taken and not kept, or kept until a slew or a flip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mountnav.errors import BadSettings

Rates = tuple[float, float]
"""Of the right ascension, not times cos δ, and of the declination; in the unit that they are given in."""


@dataclass(frozen=True, slots=True)
class RateFault:
    """One fault.

    Attributes
    ----------
    ra_factor, dec_factor : float
        What it keeps, over what it was ordered: -1 the wrong way, 0 not at all.
    swapped : bool
        It takes each for the other; before the factors.
    reads_zero : bool
        Read back, its rates are zero; else they are the ordered ones, whatever it keeps.
    lost_by_slew, lost_by_flip : bool
        After a slew, or after it has changed sides, it tracks as for a star; read back they are as ordered.
    unturned : bool
        It turns its declination axis the same way on both sides of the pier.

    Raises
    ------
    BadSettings
        If a factor isn't finite.
    """

    ra_factor: float = 1.0
    dec_factor: float = 1.0
    swapped: bool = False
    reads_zero: bool = False
    lost_by_slew: bool = False
    lost_by_flip: bool = False
    unturned: bool = False

    def __post_init__(self) -> None:
        for factor in (self.ra_factor, self.dec_factor):
            if not math.isfinite(factor):
                raise BadSettings(f"a rate's factor is {factor}", advice="a finite number")

    def kept(self, rates: Rates) -> Rates:
        """The rates that it keeps when it is ordered these."""
        ra, dec = reversed(rates) if self.swapped else rates
        return self.ra_factor * ra, self.dec_factor * dec


def kept_rates(faults: tuple[RateFault, ...], rates: Rates) -> Rates:
    """The rates that a mount with these faults keeps when it is ordered some."""
    for fault in faults:
        rates = fault.kept(rates)
    return rates
