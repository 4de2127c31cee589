"""Where a German mount's two axes must stand to look at a place, and what they look at: plain geometry.

The axes are counted as *turns*, in degrees, as EQMod counts them [INDI eqmod]: the first is 0 with the
counterweight down and grows towards forward counts, the second is 90 with the tube along the polar axis.
Below 90 the tube hangs on one side of the pier, above 90 on the other. In the north the first axis runs
forward with the sky, in the south backward. Home is (0, 90) everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.devices import PierSide
from mountnav.sky.sphere import half_turn_deg

HOME_SECOND_DEG = 90.0


@dataclass(frozen=True, slots=True)
class Turns:
    """How far the two axes are turned, deg; the second may lie anywhere from -90 to 270."""

    first_deg: float
    second_deg: float

    def plus(self, other: Turns) -> Turns:
        """Add turn by turn."""
        return Turns(self.first_deg + other.first_deg, self.second_deg + other.second_deg)

    def minus(self, other: Turns) -> Turns:
        """Subtract turn by turn."""
        return Turns(self.first_deg - other.first_deg, self.second_deg - other.second_deg)


HOME = Turns(0.0, HOME_SECOND_DEG)


@dataclass(frozen=True, slots=True)
class Sight:
    """What a mount looks at: geometric hour angle (-180, 180] and declination, deg, and from which side."""

    ha_deg: float
    dec_deg: float
    side: PierSide


def sky_sign(latitude_deg: float) -> int:
    """+1 where the first axis runs forward with the sky, -1 in the south."""
    return 1 if latitude_deg >= 0.0 else -1


def side_of(turns: Turns, latitude_deg: float) -> PierSide:
    """Side of the pier on which the tube hangs; the west one looks east."""
    near = turns.second_deg <= HOME_SECOND_DEG
    return PierSide.WEST if near is (sky_sign(latitude_deg) > 0) else PierSide.EAST


def sight(turns: Turns, latitude_deg: float) -> Sight:
    """Tell what axes that stand so look at."""
    sign = sky_sign(latitude_deg)
    if turns.second_deg <= HOME_SECOND_DEG:
        ha_deg, dec_deg = sign * (turns.first_deg - 90.0), sign * turns.second_deg
    else:
        ha_deg, dec_deg = sign * (turns.first_deg + 90.0), sign * (180.0 - turns.second_deg)
    if abs(dec_deg) > 90.0:
        # below the other pole: no stand of a mount, but no place beyond a pole either
        ha_deg, dec_deg = ha_deg + 180.0, (180.0 if dec_deg > 0.0 else -180.0) - dec_deg
    return Sight(half_turn_deg(ha_deg), dec_deg, side_of(turns, latitude_deg))


def turns_at(ha_deg: float, dec_deg: float, side: PierSide, latitude_deg: float) -> Turns:
    """Tell how the axes stand that look at a place from a side; the first within half a turn."""
    sign = sky_sign(latitude_deg)
    near = (side is PierSide.WEST) is (sign > 0)
    if near:
        return Turns(half_turn_deg(sign * ha_deg + 90.0), sign * dec_deg)
    return Turns(half_turn_deg(sign * ha_deg - 90.0), 180.0 - sign * dec_deg)


def other_side(side: PierSide) -> PierSide:
    """The side after a flip."""
    return PierSide.EAST if side is PierSide.WEST else PierSide.WEST


def side_for(
    ha_deg: float, dec_deg: float, present: PierSide, latitude_deg: float, *, past_deg: float
) -> PierSide:
    """Choose the side from which a place is looked at: the one whose counterweight stays down.

    Parameters
    ----------
    ha_deg, dec_deg : float
    present : PierSide
        It is kept when the counterweight would rise above the horizontal by no more than `past_deg`: a place
        just past the meridian needs no flip.
    latitude_deg, past_deg : float
    """
    if rise_deg(turns_at(ha_deg, dec_deg, present, latitude_deg)) <= past_deg:
        return present
    return other_side(present)


def rise_deg(turns: Turns) -> float:
    """By how much the counterweight stands above the horizontal, deg; negative when it hangs below."""
    return abs(turns.first_deg) - 90.0
