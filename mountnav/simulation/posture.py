"""The two postures of a German mount: which axis angles look at a place, and on which side the tube hangs.

A place (h, δ) is seen with the axes at (h, δ), or through the pole at (h + 180°, 180° - δ) (in the south:
-180° - δ). The sides are named as ASCOM counts them: east is the normal posture, which looks west.
"""

from __future__ import annotations

from mountnav.devices import PierSide
from mountnav.simulation.machine import AxisAngles, Machine
from mountnav.sky.german_axes import first_axis_deg, through_pole_deg
from mountnav.sky.sphere import half_turn_deg


def side_of(dec_axis_deg: float, machine: Machine) -> PierSide:
    """Side on which the tube hangs at this angle of the declination axis; unknown for a fork."""
    if machine.mounting == "fork":
        return PierSide.UNKNOWN
    return PierSide.WEST if abs(half_turn_deg(dec_axis_deg)) > 90.0 else PierSide.EAST


def axes_at(
    ha_deg: float, dec_deg: float, machine: Machine, side: PierSide, latitude_deg: float
) -> AxisAngles:
    """Axis angles that look at a place from a side; the German hour angle axis within 180° of its middle."""
    if machine.mounting == "fork":
        return ha_deg, dec_deg
    if side is PierSide.WEST:
        return through_pole_deg(ha_deg, dec_deg, latitude_deg)
    return first_axis_deg(ha_deg), dec_deg


def flipped(axes: AxisAngles, latitude_deg: float) -> AxisAngles:
    """Axis angles that look at the same place from the other side."""
    return through_pole_deg(*axes, latitude_deg)


def within_reach(axes: AxisAngles, machine: Machine) -> bool:
    """Whether the axes turn that far; those of a fork also the other way round."""
    ha_deg, dec_deg = axes
    low, high = machine.ha_range_deg
    turns = (-360.0, 0.0, 360.0) if machine.mounting == "fork" else (0.0,)
    dec_low, dec_high = machine.dec_range_deg
    return any(low <= ha_deg + turn <= high for turn in turns) and dec_low <= dec_deg <= dec_high


def side_for(
    ha_deg: float, dec_deg: float, machine: Machine, present: PierSide, latitude_deg: float
) -> PierSide:
    """Side from which a slew looks at a place: by the machine's rule, the other one if only that reaches."""
    if machine.mounting == "fork":
        return PierSide.UNKNOWN
    wanted = PierSide.EAST if half_turn_deg(ha_deg) >= 0.0 else PierSide.WEST
    if machine.side_rule == "stay":
        wanted = present
    for side in (wanted, wanted.other):
        if within_reach(axes_at(ha_deg, dec_deg, machine, side, latitude_deg), machine):
            return side
    return wanted


def turned_near(axes: AxisAngles, near: AxisAngles, machine: Machine, shift_deg: float) -> AxisAngles:
    """Turns of the axes that a slew from `near` takes to these angles.

    Parameters
    ----------
    axes, near : (float, float)
        Motor angles; of a fork those nearest are taken, or the nearest within its limits.
    shift_deg : float
        Believed minus motor angle of the hour angle axis, which the limits count in.
    """
    if machine.mounting == "german":
        return axes
    ha_deg = near[0] + half_turn_deg(axes[0] - near[0])
    low, high = machine.ha_range_deg
    reached = [ha_deg + turn for turn in (0.0, -360.0, 360.0) if low <= ha_deg + turn + shift_deg <= high]
    if machine.at_limit != "ignore" and reached:
        ha_deg = min(reached, key=lambda one: abs(one - near[0]))
    return ha_deg, near[1] + half_turn_deg(axes[1] - near[1])
