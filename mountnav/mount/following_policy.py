"""What a telescope may do beside following stars, and what is left when its program is gone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

OnLoss = Literal["sidereal", "stop"]
"""What is left when rates end without an order: tracking as for a star, or a mount that stands still."""


@dataclass(frozen=True, slots=True)
class FollowingPolicy:
    """Bounds of rates and of axes moved by hand; the settings' `following` (docs/explanation/following.md).

    Attributes
    ----------
    on_loss : {"sidereal", "stop"}
        What is left at the end of rates, and when the program that ordered them is gone.
    most_s : float
        So long rates may be ordered for at once.
    most_arcsec_s : float
        Fastest way over the sky beside the stars', ″/s.
    most_axis_deg_s : float
        Fastest speed at which an axis is moved by hand, °/s.
    most_axis_s : float
        So long an axis goes on after each order to move it.
    axis_braking_deg_s2 : float
        At least so fast an axis brakes, °/s²: how far before a limit it is ended.
    """

    on_loss: OnLoss = "sidereal"
    most_s: float = 43_200.0
    most_arcsec_s: float = 7_200.0
    most_axis_deg_s: float = 4.0
    most_axis_s: float = 5.0
    axis_braking_deg_s2: float = 1.0
