"""A slew from the pole: the place doesn't tell how the hour angle axis stands, the home position does."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from mountnav.devices import PierSide
from mountnav.errors import LimitKind, OutsideLimits
from mountnav.pointing.limits import Limits
from mountnav.pointing.limits.horizon import Horizon
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site

NOW = datetime(2026, 2, 24, 23, 13, tzinfo=UTC)
SITE = Site(48.0, 11.0, 500.0)
AIR = Air()


def _place(ha_deg: float, dec_deg: float) -> Icrs:
    return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, NOW), SITE, AIR)


def _check(ha_deg: float, limits: Limits) -> None:
    """From home (the place at the pole is read at some hour angle) to a place on the meridian."""
    limits.check_slew(
        _place(ha_deg, 89.99),
        _place(2.0, 20.0),
        NOW,
        SITE,
        AIR,
        mounting="german",
        side=PierSide.EAST,
        destination=PierSide.EAST,
        track_for_s=60.0,
    )


@pytest.mark.parametrize("ha_deg", [0.1, 90.0])
def test_the_way_from_home_is_checked_wherever_the_pole_is_read(ha_deg: float) -> None:
    # from the counterweight's low point both axes turn: the tube passes the west, where a tower stands
    tower = Horizon(((0.0, 5.0), (270.0, 5.0), (275.0, 80.0), (305.0, 80.0), (310.0, 5.0)), "a tower")
    with pytest.raises(OutsideLimits) as refused:
        _check(ha_deg, Limits(5.0, horizon=tower))
    assert refused.value.limit is LimitKind.HORIZON


def test_without_the_tower_it_may_go() -> None:
    _check(0.1, Limits(5.0))
