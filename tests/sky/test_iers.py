"""The Earth's orientation: as astropy has it, without network, and beyond the end of the table."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest
from astropy.time import Time
from astropy.utils import iers as astropy_iers

from mountnav.errors import BadRequest, BadSettings
from mountnav.sky.chain import icrs_to_hour_angle, sidereal_time_deg
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.iers import earth_orientation, iers_status, override_dut1, prepare, tt_minus_utc_s

SITE = Site(48.93, 22.27, 700.0)
UTC0 = datetime(2026, 11, 21, 22, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _no_override() -> Iterator[None]:
    yield
    override_dut1(None)


@pytest.mark.parametrize(
    "utc",
    [
        UTC0,
        datetime(1985, 6, 30, 18, tzinfo=UTC),  # dut1 jumps by a second at midnight
        datetime(1990, 5, 5, 5, tzinfo=UTC),
        datetime(2016, 12, 31, 12, tzinfo=UTC),  # likewise
        datetime(2017, 1, 1, 1, tzinfo=UTC),
        datetime(2026, 10, 1, 3, tzinfo=UTC),
        datetime(2027, 9, 1, 7, tzinfo=UTC),
    ],
)
def test_dut1_and_polar_motion_are_astropys(utc: datetime) -> None:
    table = astropy_iers.earth_orientation_table.get()
    time = Time(utc)
    x, y = table.pm_xy(time)
    ours = earth_orientation(utc)
    # astropy takes the past from another series (C04), which differs by up to a milliarcsecond or two
    assert ours.dut1_s == pytest.approx(table.ut1_utc(time).to_value("s"), abs=1e-4)
    assert ours.polar_x_arcsec == pytest.approx(x.to_value("arcsec"), abs=3e-3)
    assert ours.polar_y_arcsec == pytest.approx(y.to_value("arcsec"), abs=3e-3)


def test_leap_seconds() -> None:
    assert tt_minus_utc_s(datetime(1972, 1, 1, tzinfo=UTC)) == pytest.approx(10 + 32.184)
    assert tt_minus_utc_s(datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)) == pytest.approx(36 + 32.184)
    assert tt_minus_utc_s(datetime(2017, 1, 1, tzinfo=UTC)) == pytest.approx(37 + 32.184)


def test_sidereal_time_runs_smoothly_through_a_leap_second() -> None:
    before = sidereal_time_deg(datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), SITE)
    after = sidereal_time_deg(datetime(2017, 1, 1, 0, 0, 0, tzinfo=UTC), SITE)
    # 23:59:59 to 00:00:00 were two seconds that night
    assert (after - before) * 3600.0 == pytest.approx(2 * 15.041, abs=0.01)


def test_prepare_forbids_astropy_the_network() -> None:
    prepare()
    prepare()
    assert astropy_iers.conf.auto_download is False
    assert astropy_iers.conf.auto_max_age is None
    assert astropy_iers.conf.iers_degraded_accuracy == "warn"


@pytest.mark.long
def test_a_fresh_process_reaches_for_no_socket() -> None:
    program = """
import socket, sys
def forbidden(*args, **kwargs):
    raise SystemExit("the network was asked")
socket.socket.connect = forbidden
socket.getaddrinfo = forbidden
import mountnav.sky as sky
assert "astropy.utils.iers" not in sys.modules, "importing the room is heavy"
from datetime import datetime, UTC
sky.prepare()
utc = datetime(2027, 9, 1, tzinfo=UTC)
sky.icrs_to_observed(sky.Icrs(1, 2), utc, sky.Site(50, 10), sky.Air(930))
from astropy.time import Time
Time(utc).ut1
print(sky.iers_status().dut1_s)
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert abs(float(done.stdout)) < 0.9


def test_after_its_end_the_last_row_is_held() -> None:
    last_utc = iers_status(UTC0).last_row_utc
    at_end = earth_orientation(last_utc)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert earth_orientation(last_utc + timedelta(days=900)) == at_end
        status = iers_status(last_utc + timedelta(days=10))
    assert status.days_left == pytest.approx(-10.0)
    assert status.warning is not None
    assert "ended" in status.warning


def test_before_its_start_the_first_row_is_held() -> None:
    first_utc = iers_status(UTC0).first_row_utc
    start = earth_orientation(first_utc)
    assert earth_orientation(first_utc - timedelta(days=200)) == start


def test_status_warns_before_the_table_ends() -> None:
    last_utc = iers_status(UTC0).last_row_utc
    assert iers_status(last_utc - timedelta(days=100)).days_left == pytest.approx(100.0)
    soon = iers_status(last_utc - timedelta(days=59))
    assert soon.warning is not None
    assert "astropy-iers-data" in soon.warning


def test_status_is_quiet_with_a_fresh_table() -> None:
    measured_utc = iers_status(UTC0).last_measured_utc
    status = iers_status(measured_utc + timedelta(days=5))
    assert status.warning is None
    assert status.age_days == pytest.approx(5.0)
    assert status.dut1_overridden is False


def test_an_overridden_dut1_moves_hour_angles_and_nothing_else() -> None:
    place, air = Icrs(100.0, 0.0), Air()
    override_dut1(0.0)
    zero = icrs_to_hour_angle(place, UTC0, SITE, air)
    override_dut1(0.5)
    half = icrs_to_hour_angle(place, UTC0, SITE, air)
    assert iers_status(UTC0).dut1_overridden is True
    assert iers_status(UTC0).dut1_s == 0.5
    assert (half.ha_deg - zero.ha_deg) * 3600.0 == pytest.approx(7.5205, abs=0.001)
    assert (half.dec_deg - zero.dec_deg) * 3600.0 == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("dut1_s", [1.0, -37.0, float("nan"), float("inf")])
def test_an_impossible_dut1_is_refused(dut1_s: float) -> None:
    with pytest.raises(BadSettings, match="dut1"):
        override_dut1(dut1_s)


def test_naive_instants_are_refused() -> None:
    with pytest.raises(BadRequest):
        earth_orientation(datetime(2026, 1, 1))
    with pytest.raises(BadRequest):
        iers_status(datetime(2026, 1, 1))
