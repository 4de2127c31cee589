"""Which side of the pier a letter means, and which way a motor has to turn there: pure rules."""

from __future__ import annotations

from drivers.nexstar.handsets import Tracking
from drivers.nexstar.passthrough import Axis
from mountnav.devices import Direction, PierSide

_POLE_DEG = 89.999


def side_of(letter: str, dec_deg: float, *, mirrored: bool) -> PierSide:
    """Tell where the tube hangs: W says that it looks west, so it hangs in the east [INDI celestrongps].

    Parameters
    ----------
    letter : str
        E or W [NexStar p].
    dec_deg : float
        At the very pole it means nothing.
    mirrored : bool
        Whether this hand control has the letters the other way round on this hemisphere.
    """
    if abs(dec_deg) > _POLE_DEG:
        return PierSide.UNKNOWN
    return PierSide.EAST if (letter == "W") is not mirrored else PierSide.WEST


def motor_for(direction: Direction, side: PierSide | None, mode: Tracking | None) -> tuple[Axis, int]:
    """Which motor moves the tube there, and which way it turns: 1 or -1.

    West is the way it tracks. The declination motor's plus raises the declination where the tube looks east,
    and lowers it where it looks west [INDI celestrongps MoveNS].
    """
    if direction in (Direction.NORTH, Direction.SOUTH):
        up = 1 if direction is Direction.NORTH else -1
        return Axis.DEC, -up if side is PierSide.EAST else up
    west = 1 if direction is Direction.WEST else -1
    return Axis.RA, -west if mode is Tracking.EQUATORIAL_SOUTH else west
