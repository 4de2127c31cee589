"""When the Sun comes to an altitude, against the Sun that the limits know by another way."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from mountnav.night.daylight import sun_passes
from mountnav.pointing.limits.bodies import bodies
from mountnav.sky.chain import hour_angle_to_observed
from mountnav.sky.coordinates import HourAngle, Site


def altitude_deg(utc: datetime, site: Site) -> float:
    sun = bodies(utc, site).sun
    return hour_angle_to_observed(HourAngle(sun.ha_deg, sun.dec_deg, sun.utc), site).alt_deg


@pytest.mark.parametrize("wanted_deg", [-0.833, -18.0])
@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(47.0, 11.0), (-31.0, 149.0), (0.0, -78.0)])
def test_the_sun_stands_there_and_goes_the_way_that_is_told(
    wanted_deg: float, latitude_deg: float, longitude_deg: float
) -> None:
    site = Site(latitude_deg=latitude_deg, longitude_deg=longitude_deg, height_m=0.0)
    found = sun_passes(datetime(2026, 3, 20, tzinfo=UTC), 48.0, wanted_deg, site)
    assert len(found) == 4
    assert [one.rising for one in found[:2]] != [one.rising for one in found[1:3]]
    for one in found:
        # a second of time is 0.004°, an arcminute what that Sun is good to
        assert altitude_deg(one.utc, site) == pytest.approx(wanted_deg, abs=0.025)
        later = altitude_deg(one.utc.replace(second=0), site), altitude_deg(one.utc.replace(second=59), site)
        assert (later[1] > later[0]) is one.rising


def test_where_the_sun_does_not_set_nothing_is_told() -> None:
    north = Site(latitude_deg=72.0, longitude_deg=20.0, height_m=0.0)
    assert sun_passes(datetime(2026, 6, 20, 12, tzinfo=UTC), 24.0, -0.833, north) == ()
