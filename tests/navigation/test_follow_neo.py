"""A near-Earth object that passes closely: its parallax is a degree, its rates are some ″/s, and they change.

It is given as elements, and as a table for the Earth's center with distances, as observers have them.
"""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta

import numpy as np
import pytest

from api.demo.moving import comet_elements
from mountnav.ephemeris import Ephemeris
from mountnav.ephemeris.any_text import read_elements
from mountnav.ephemeris.csv_table import read_csv_table
from mountnav.ephemeris.ephemeris import sky_rates
from mountnav.ephemeris.small_body import SmallBody
from mountnav.navigation.follow_plan import FollowBy
from mountnav.navigation.follow_report import FollowProgress, FollowReport
from mountnav.sky.coordinates import Icrs
from mountnav.sky.observer import site_geocentric_km
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import AU_KM
from tests.ephemeris.samples import GEOCENTER
from tests.navigation.rated_mount import RatedMount
from tests.navigation.virtual_rig import AIR, SITE, START, VirtualRig, in_virtual_time

DISTANCE_KM, SPEED_KM_S = 200_000.0, 12.0
"""Half the way to the Moon, as fast as such bodies come."""
TOLERANCE = 10.0


def body(utc: datetime = START) -> SmallBody:
    text = comet_elements(
        utc, SITE, AIR, alt_deg=50.0, az_deg=200.0, distance_km=DISTANCE_KM, speed_km_s=SPEED_KM_S
    )
    return SmallBody(read_elements(text)[0])


def table_of(target: SmallBody, begins: datetime, minutes: int) -> Ephemeris:
    """As an ephemeris service would write it for the Earth's center, a row each two minutes."""
    lines = ["# name: a NEO", "# observer: geocenter", "# frame: icrs", "utc,ra_deg,dec_deg,distance_au"]
    for minute in range(-10, minutes + 10, 2):
        utc = begins + timedelta(minutes=minute)
        place = target.icrs(utc, GEOCENTER)
        distance_au = distance_km(target, utc) / AU_KM
        lines.append(f"{utc.isoformat()},{place.ra_deg:.7f},{place.dec_deg:.7f},{distance_au:.10f}")
    return read_csv_table("\n".join(lines))


def distance_km(target: SmallBody, utc: datetime) -> float:
    """From the Earth's center, by the parallax between there and the site."""
    center, here = (direction(target.icrs(utc, site)) for site in (GEOCENTER, SITE))
    moved, _ = site_geocentric_km(utc, SITE)
    both, *_ = np.linalg.lstsq(np.column_stack((center, -here)), moved, rcond=None)
    return float(both[0])


def direction(place: Icrs) -> np.ndarray:
    ra, dec = np.radians([place.ra_deg, place.dec_deg])
    return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


@pytest.mark.long
def test_a_table_for_the_earths_center_serves_the_site_a_degree_beside() -> None:
    truth = body()
    table = table_of(truth, START, 30)
    for minute in range(0, 30, 3):
        utc = START + timedelta(minutes=minute, seconds=37.0)
        assert separation_arcsec(truth.icrs(utc, SITE), truth.icrs(utc, GEOCENTER)) > 3000.0
        assert separation_arcsec(table.icrs(utc, SITE), truth.icrs(utc, SITE)) < 0.5


@pytest.mark.long
@pytest.mark.parametrize("source", ["elements", "table"])
def test_a_neo_that_passes_closely_is_followed(source: str) -> None:
    async def work(rig: VirtualRig) -> tuple[FollowReport, list[float]]:
        begins = rig.clock.utc()
        truth = body(begins)
        assert 5.0 < sky_rates(truth, begins, SITE).total_arcsec_s < 60.0
        target: Ephemeris = truth if source == "elements" else table_of(truth, begins, 20)
        heard: list[FollowProgress] = []
        offs: list[float] = []

        async def watch() -> None:
            while True:
                await rig.clock.sleep(2.0)
                now = rig.clock.utc()
                if any(one.phase == "following" for one in heard):
                    offs.append(separation_arcsec(rig.mechanics.truth(now), truth.icrs(now, SITE)))

        watching = asyncio.create_task(watch())
        try:
            report = await rig.navigator.follow(
                target,
                until_utc=begins + timedelta(minutes=8),
                tolerance_arcsec=TOLERANCE,
                heard=heard.append,
            )
        finally:
            watching.cancel()
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        return report, offs

    report, offs = in_virtual_time(work, made=RatedMount)
    assert report.by is FollowBy.RATES
    assert report.fault is None
    assert report.looks >= 4
    # from the second minute on: until its looks have shown that its rates are kept nothing is made good
    assert max(offs[60:]) <= 0.3 * TOLERANCE
