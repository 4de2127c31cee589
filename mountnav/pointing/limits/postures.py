"""The axes of a mount: which angles look at a place from which side, and the ways from one to another.

Axis angles of an equatorial mount are (hour angle, declination) in the normal posture; a German mount that
looks through the pole has them at (h + 180°, 180° - δ), in the south (h + 180°, -180° - δ). The counterweight
hangs down at 90° of the first axis in both postures, so it is above the horizontal below 0° and beyond 180°.
The sides are named as ASCOM counts them: east is the normal posture. Of an alt-az mount the axes are azimuth
and altitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from mountnav.devices import PierSide
from mountnav.sky.coordinates import HourAngle, Observed
from mountnav.sky.german_axes import first_axis_deg, through_pole_deg
from mountnav.sky.sphere import half_turn_deg

Mounting = Literal["german", "fork", "altaz"]

# A turn within so many degrees of half a circle may go either way round, so both ways have to be allowed.
# Chosen by hand, above the pointing errors of mounts.
_HALF_TURN_DOUBT_DEG = 5.0


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a mount stands: a place in its axes.

    Attributes
    ----------
    side : PierSide
        `UNKNOWN` for what isn't German.
    first_deg, second_deg : float
        Hour angle and declination axis, or azimuth and altitude.
    """

    mounting: Mounting
    side: PierSide
    first_deg: float
    second_deg: float


@dataclass(frozen=True, slots=True)
class Way:
    """From one standing to another, each axis turning straight to its end, also beyond a whole turn."""

    start: Standing
    end: Standing

    @property
    def label(self) -> str:
        """The posture it ends in, for messages."""
        if self.end.mounting != "german":
            return ""
        flips = self.end.side is not self.start.side
        return f"{'changing to' if flips else 'staying on'} the {self.end.side} side of the pier"


def standing_at(
    place: HourAngle, seen: Observed, mounting: Mounting, side: PierSide, latitude_deg: float
) -> Standing:
    """Axis angles that look at a place.

    Parameters
    ----------
    seen : Observed
        The same place.
    side : PierSide
        German: east or west.
    """
    if mounting == "altaz":
        return Standing(mounting, PierSide.UNKNOWN, seen.az_deg, seen.alt_deg)
    first_deg, second_deg = place.ha_deg, place.dec_deg
    if mounting == "fork":
        return Standing(mounting, PierSide.UNKNOWN, first_deg, second_deg)
    if side is PierSide.WEST:
        return Standing(mounting, side, *through_pole_deg(first_deg, second_deg, latitude_deg))
    return Standing(mounting, side, first_axis_deg(first_deg), second_deg)


def side_by_rule(ha_deg: float) -> PierSide:
    """Side that German mounts take if nothing keeps them: the tube east of the pier looks west."""
    return PierSide.EAST if half_turn_deg(ha_deg) >= 0.0 else PierSide.WEST


def from_the_meridian_deg(ha_deg: float) -> float:
    """How far a hour angle is from the meridian, the lower one too."""
    return min(abs(half_turn_deg(ha_deg)), 180.0 - abs(half_turn_deg(ha_deg)))


def ways_between(start: Standing, end: Standing, first_range_deg: tuple[float, float] | None) -> list[Way]:
    """All ways that the first axis may take; all of them have to be allowed.

    A German mount never turns its axis all round. Any other goes the shortest way, and what is nearly half a
    turn away either way; one whose axis has a range stays in it, if it knows of it, and else doesn't.
    """
    if end.mounting == "german":
        return [Way(start, end)]
    turn_deg = half_turn_deg(end.first_deg - start.first_deg)
    ends = {start.first_deg + turn_deg}
    if abs(turn_deg) > 180.0 - _HALF_TURN_DOUBT_DEG:
        ends.add(start.first_deg + turn_deg - math.copysign(360.0, turn_deg))
    if first_range_deg is not None:
        shift_deg = _into(start.first_deg, first_range_deg) - start.first_deg
        ends = {one + shift_deg for one in ends}
        start = _turned(start, start.first_deg + shift_deg)
        ends.add(_into(end.first_deg, first_range_deg))
    return [Way(start, _turned(end, one)) for one in sorted(ends)]


def _turned(standing: Standing, first_deg: float) -> Standing:
    return Standing(standing.mounting, standing.side, first_deg, standing.second_deg)


def _into(angle_deg: float, range_deg: tuple[float, float]) -> float:
    """The turn of an angle that lies in a range, or nearest to its middle."""
    middle_deg = 0.5 * (range_deg[0] + range_deg[1])
    return middle_deg + half_turn_deg(angle_deg - middle_deg)
