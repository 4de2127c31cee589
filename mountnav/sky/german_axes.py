"""The axes of a German equatorial mount: the two postures in which they look at one place.

A place (h, δ) is seen in the normal posture with the axes at (h, δ), and through the pole with the axes at
(h + 180°, 180° - δ), in the south at (h + 180°, -180° - δ).
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.sphere import half_turn_deg

Angle = TypeVar("Angle", float, NDArray[np.float64])

COUNTERWEIGHT_DOWN_DEG = 90.0
"""Angle of the first axis with the counterweight straight down, in the hour angle of the normal posture: by
the convention above. The axis turns 180° either way from there and never through the opposite point."""


def first_axis_deg(angle_deg: float) -> float:
    """Bring an angle of the first axis into its range, half a turn about the counterweight down."""
    return COUNTERWEIGHT_DOWN_DEG + half_turn_deg(angle_deg - COUNTERWEIGHT_DOWN_DEG)


def through_pole_dec_deg(dec_deg: Angle, latitude_deg: float) -> Angle:
    """Angle of the second axis at a declination seen through the pole; of such an angle, the declination."""
    return math.copysign(180.0, latitude_deg) - dec_deg


def through_pole_deg(ha_deg: float, dec_deg: float, latitude_deg: float) -> tuple[float, float]:
    """Angles of both axes in the posture through the pole; the first within its range."""
    return first_axis_deg(ha_deg + 180.0), through_pole_dec_deg(dec_deg, latitude_deg)
