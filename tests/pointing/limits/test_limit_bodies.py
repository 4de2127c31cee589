"""Sun and Moon against astropy, which has nothing of ours but the Earth's rotation."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from astropy.coordinates import AltAz, EarthLocation, get_body
from astropy.time import Time

from mountnav.pointing.limits.bodies import bodies
from mountnav.sky.chain import hour_angle_to_observed
from mountnav.sky.coordinates import HourAngle, Observed, Site
from mountnav.sky.iers import prepare
from mountnav.sky.sphere import separation_arcsec

SITES = (Site(48.93, 22.27, 700.0), Site(-30.24, -70.74, 2700.0), Site(0.0, 0.0), Site(78.2, 15.6, 10.0))


@pytest.mark.long
@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("body", ["sun", "moon"])
def test_sun_and_moon_are_where_astropy_sees_them(site: Site, body: str) -> None:
    prepare()
    where = EarthLocation.from_geodetic(site.longitude_deg, site.latitude_deg, site.height_m)
    worst = 0.0
    for day in range(0, 365, 61):
        utc = datetime(2026, 1, 3, 5, 17, tzinfo=UTC) + timedelta(days=day, hours=day % 24)
        ours = getattr(bodies(utc, site), body)
        seen = hour_angle_to_observed(HourAngle(ours.ha_deg, ours.dec_deg, utc), site)
        time = Time(utc)
        theirs = get_body(body, time, where, ephemeris="builtin").transform_to(
            AltAz(obstime=time, location=where)
        )
        truth = Observed(float(theirs.az.deg), float(theirs.alt.deg), utc)
        worst = max(worst, separation_arcsec(seen, truth))
    # the Moon: astropy takes the same series, so this tells of the parallax and the frames, not of the theory
    assert worst < (2.0 if body == "sun" else 30.0)


def test_the_moons_parallax_is_in_it() -> None:
    utc = datetime(2026, 11, 21, 22, tzinfo=UTC)
    here, there = (bodies(utc, Site(latitude, 22.27)).moon for latitude in (60.0, -60.0))
    assert abs(here.dec_deg - there.dec_deg) > 1.0
