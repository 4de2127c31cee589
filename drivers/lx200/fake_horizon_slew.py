"""Slews to the horizon itself: what rounding puts a hair below it is not below it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mountnav.errors import Refusal

if TYPE_CHECKING:
    from drivers.lx200.fake import FakeLx200

_ROUNDING_DEG = 1.0 / 60.0


def from_the_horizon_up(fake: FakeLx200) -> bytes | None:
    """Answer ``:MS#`` to a target at altitude 0, written in arcminutes; None where the classic's words do.

    INDI's drivers park there when they were never told of a site.
    """
    target = fake.target()
    if target is None or fake.refusal(target) is not Refusal.BELOW_HORIZON:
        return None
    if fake.mechanics.believed_altitude_deg(target) < -_ROUNDING_DEG:
        return None
    return b"0" if fake.mechanics.slew(target) is None else None
