"""When the Sun comes to an altitude, against the Sun that the limits know by another way."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from mountnav.night.daylight import next_dark_from, sun_altitude_deg, sun_passes
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


@pytest.mark.parametrize("hour", [0, 3, 6, 11, 15, 22])
@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(48.9, 22.3), (-31.0, 149.0), (64.0, -150.0)])
def test_the_next_night_begins_after_the_present_one(
    hour: int, latitude_deg: float, longitude_deg: float
) -> None:
    site = Site(latitude_deg=latitude_deg, longitude_deg=longitude_deg, height_m=0.0)
    utc = datetime(2026, 10, 20, hour, 0, tzinfo=UTC)
    begins = next_dark_from(utc, site)
    assert utc < begins <= utc + timedelta(days=1, hours=12)
    assert sun_altitude_deg(begins, site) == pytest.approx(-18.0, abs=1.0)
    # evening: the Sun sinks
    assert sun_altitude_deg(begins + timedelta(minutes=10), site) < sun_altitude_deg(begins, site)


def test_where_it_never_gets_dark_the_next_lowest_sun_is_taken() -> None:
    north = Site(latitude_deg=60.0, longitude_deg=20.0, height_m=0.0)
    utc = datetime(2026, 6, 20, 12, tzinfo=UTC)
    for _ in range(3):
        begins = next_dark_from(utc, north)
        assert utc < begins < utc + timedelta(hours=36)
        assert sun_altitude_deg(begins, north) == pytest.approx(-6.6, abs=0.5)
        utc = begins
