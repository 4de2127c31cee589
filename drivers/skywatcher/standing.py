"""From a board's counts to how the axes stand, and back: gears, the count each axis began at, and syncs.

A board that was just switched on counts both axes from 0x800000 wherever they stand; they are taken to stand
at home, the tube along the polar axis and the counterweight down. When we energize the motors the second axis
is set a quarter of a turn on, as EQMod does: from then on 0x800000 is the declination axis on the equator for
every program that reads the counts, for us after a restart too.
"""

from __future__ import annotations

from drivers.skywatcher.offsets import Offsets
from drivers.skywatcher.postures import Turns
from drivers.skywatcher.rates import Gearing
from drivers.skywatcher.words import LARGEST, POSITION_ZERO, Axis
from mountnav.errors import DeviceRefused, Refusal


class Standing:
    """How the axes stand.

    Parameters
    ----------
    latitude_deg : float
        Of the site.
    """

    def __init__(self, latitude_deg: float) -> None:
        self.offsets = Offsets(latitude_deg)
        self._gears: dict[Axis, Gearing] = {}
        self._second_zero = POSITION_ZERO

    def geared(self, gears: dict[Axis, Gearing]) -> None:
        """Take over what the board says of its gears."""
        self._gears = dict(gears)

    @property
    def second_gear(self) -> Gearing:
        """The declination motor's."""
        return self._gears[Axis.DECLINATION]

    def begin_at_home(self) -> None:
        """Counts of a board that was just switched on; what syncs have taught is void."""
        self.offsets.forget()
        self._second_zero = POSITION_ZERO - self.quarter

    def begin_as_eqmod(self) -> None:
        """Counts of a board whose motors were energized before us."""
        self._second_zero = POSITION_ZERO

    def second_moved(self, before: int, after: int) -> None:
        """The count of the second axis was set: the axis stands where it stood."""
        self._second_zero += after - before

    @property
    def quarter(self) -> int:
        """Counts of a quarter of a turn of the second axis."""
        return self._gears[Axis.DECLINATION].counts // 4

    def counted(self, first: int, second: int) -> Turns:
        """Turns as counted, syncs left out."""
        return Turns(
            self._gears[Axis.HOUR_ANGLE].turn_deg(first - POSITION_ZERO),
            self._gears[Axis.DECLINATION].turn_deg(second - self._second_zero),
        )

    def turns(self, first: int, second: int) -> Turns:
        """How the axes stand, as far as we know."""
        return self.offsets.true_turns(self.counted(first, second))

    def counts(self, turns: Turns) -> tuple[int, int]:
        """Counts at which the axes stand so.

        Raises
        ------
        DeviceRefused
            If the board can't count that far.
        """
        counted = self.offsets.counted_turns(turns)
        first = POSITION_ZERO + self._gears[Axis.HOUR_ANGLE].counts_of(counted.first_deg)
        second = self._second_zero + self._gears[Axis.DECLINATION].counts_of(counted.second_deg)
        if not (0 <= first <= LARGEST and 0 <= second <= LARGEST):
            raise DeviceRefused("the axes can't be counted so far round", reason=Refusal.LIMIT)
        return first, second
