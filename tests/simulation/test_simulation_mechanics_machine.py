"""The build of a fake mount, as values and as a file; and the clock that runs faster."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import BadSettings
from mountnav.simulation.machine import Machine
from mountnav.simulation.machine_file import MachineFile
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Air, Site

START = datetime(2026, 11, 21, 22, tzinfo=UTC)


@pytest.mark.parametrize(
    "values",
    [
        {"mounting": "dobson"},
        {"at_limit": "explode"},
        {"side_rule": ""},
        {"starts_at": "moon"},
        {"boots_believing": 3},
        {"slew_rate_deg_s": 0.0},
        {"acceleration_deg_s2": -1.0},
        {"dec_slew_rate_deg_s": 0},
        {"slew_rate_deg_s": math.nan},
        {"slew_rate_deg_s": True},
        {"slew_rate_deg_s": None},
        {"encoder_arcsec": -0.1},
        {"sync_reach_deg": 0.0},
        {"ha_limits_deg": (10.0, -10.0)},
        {"dec_limits_deg": (10.0,)},
        {"home_axes_deg": ("a", 0.0)},
        {"park_axes_deg": [0.0, 1.0]},
        {"tracks_at_boot": 1},
        {"remembers_park": "yes"},
        {"boot_utc": "2000-01-01"},
        {"boot_utc": datetime(2000, 1, 1)},
        {"clock_drift_ppm": math.inf},
        {"lowest_altitude_deg": "low"},
    ],
)
def test_a_machine_that_makes_no_sense_is_refused(values) -> None:
    with pytest.raises(BadSettings, match=next(iter(values))):
        Machine(**values)


def test_home_is_the_pole_of_the_hemisphere() -> None:
    assert Machine().home_at(48.0) == (0.0, 90.0)
    assert Machine(mounting="german").home_at(-33.0) == (90.0, -90.0)
    assert Machine(home_axes_deg=(1.0, 2.0)).park_at(48.0) == (1.0, 2.0)
    assert Machine(park_axes_deg=(3.0, 4.0)).park_at(48.0) == (3.0, 4.0)


def test_each_axis_has_its_own_rates(site: Site) -> None:
    clock = FastClock(0.0, START)
    machine = Machine(slew_rate_deg_s=1.0, dec_slew_rate_deg_s=3.0, dec_acceleration_deg_s2=0.5)
    mechanics = Mechanics(site, Air(), PointingErrors(), machine=machine, clock=clock)
    mechanics.drive("ha", 9.0)
    mechanics.drive("dec", 9.0)
    clock.on(2.0)
    assert mechanics.axis_velocity("ha") == 1.0
    assert mechanics.axis_velocity("dec") == 1.0
    clock.on(10.0)
    assert mechanics.axis_velocity("dec") == 3.0
    mechanics.slew_rate_deg_s = 2.0
    mechanics.acceleration_deg_s2 = 100.0
    for axis in ("ha", "dec"):
        mechanics.drive(axis, 9.0)
    clock.on(1.0)
    assert (mechanics.axis_velocity("ha"), mechanics.axis_velocity("dec")) == (2.0, 2.0)
    for name in ("slew_rate_deg_s", "acceleration_deg_s2"):
        with pytest.raises(BadSettings, match=name):
            setattr(mechanics, name, 0.0)


WHOLE = """
[machine]
mounting = "german"
meridian_limits_deg = [10, 5]
encoder_arcsec = 0.5
starts_at = "home"
boot_utc = 2001-01-01T00:00:00Z
[errors]
ih_arcsec = 600
[site]
latitude_deg = -33
longitude_deg = 18.5
height_m = 1700
[air]
pressure_hpa = 830
[clock]
speed = 20
start_utc = 2026-11-21T20:00:00Z
offset_s = 60.0
drift_ppm = 5
"""


def test_a_whole_mount_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mount.toml"
    path.write_text(WHOLE)
    file = MachineFile.from_toml(path)
    assert file.machine.ha_range_deg == (-10.0, 185.0)
    assert file.machine.boot_utc == datetime(2001, 1, 1, tzinfo=UTC)
    assert file.errors == PointingErrors(ih_arcsec=600)
    assert file.site == Site(-33.0, 18.5, 1700.0)
    assert file.air == Air(pressure_hpa=830.0)
    clock = FastClock(file.clock_speed, file.clock_start_utc)
    assert clock.speed == 20.0
    assert 0.0 <= (clock() - datetime(2026, 11, 21, 20, tzinfo=UTC)).total_seconds() < 3600.0
    mechanics = file.make_mechanics(clock=clock)
    assert mechanics.pier_side() is PierSide.EAST
    utc = clock()
    assert (mechanics.believed_utc(utc) - utc).total_seconds() == pytest.approx(60.0, abs=0.1)


def test_an_empty_file_is_the_default_mount(tmp_path: Path, site: Site) -> None:
    path = tmp_path / "mount.toml"
    path.write_text("")
    file = MachineFile.from_toml(path)
    assert (file.machine, file.errors, file.site) == (Machine(), PointingErrors(), None)
    assert file.make_mechanics(site=site).site == site
    with pytest.raises(BadSettings, match="has no site"):
        file.make_mechanics()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[machine", "can't read"),
        ("machine = 3", r"write \[machine\]"),
        ("[motor]\n", "motor"),
        ("[machine]\nmountings = 1", "mountings"),
        ("[machine]\nslew_rate_deg_s = -1", "slew_rate_deg_s"),
        ("[errors]\nxx_arcsec = 1", "xx_arcsec"),
        ("[errors]\nih_arcsec = 'a'", "ih_arcsec"),
        ("[site]\nlatitude_deg = 3", "not complete"),
        ("[site]\nlatitude_deg = 93\nlongitude_deg = 0", "not on Earth"),
        ("[site]\nlatitude_deg = nan\nlongitude_deg = 0", "latitude_deg"),
        ("[air]\npressure_hpa = -5", "of \\[air\\] are impossible"),
        ("[air]\npressure = 5", "pressure"),
        ("[clock]\nspeed = 0", "speed"),
        ("[clock]\nspeed = true", "speed"),
        ("[clock]\nfast = 1", "fast"),
        ("[clock]\noffset_s = 'x'", "offset_s"),
        ("[clock]\nstart_utc = 2026-11-21T20:00:00", "start_utc"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused_by_name(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "mount.toml"
    path.write_text(text)
    with pytest.raises(BadSettings, match=says) as caught:
        MachineFile.from_toml(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadSettings, match="can't read"):
        MachineFile.from_toml(tmp_path / "none.toml")


@pytest.mark.long
@given(st.lists(st.tuples(st.floats(0, 100), st.floats(0, 50), st.floats(0, 10)), max_size=8))
def test_a_fast_clock_has_one_time_and_never_runs_back(course) -> None:
    ticks = [1000.0]
    clock = FastClock(3.0, START, ticks=lambda: ticks[0])
    expected, last = 0.0, 0.0
    for passes_s, speed, put_on_s in course:
        ticks[0] += passes_s
        expected += passes_s * clock.speed + put_on_s
        clock.on(put_on_s)
        clock.speed = speed
        assert clock.monotonic() == pytest.approx(expected, abs=1e-6)
        assert (clock() - START).total_seconds() == pytest.approx(clock.monotonic(), abs=2e-6)
        assert clock.monotonic() >= last
        last = clock.monotonic()


def test_a_clock_says_how_long_to_wait() -> None:
    assert FastClock(10.0).wait_s(5.0) == 0.5
    assert FastClock(0.0).wait_s(5.0) == math.inf


@pytest.mark.parametrize("speed", [-1.0, math.nan, math.inf])
def test_a_clock_does_not_run_back(speed: float) -> None:
    with pytest.raises(BadSettings, match="not a valid speed"):
        FastClock(speed)
    with pytest.raises(BadSettings, match="advanced by"):
        FastClock().on(speed)
    with pytest.raises(BadSettings, match="time zone"):
        FastClock(start=datetime(2026, 1, 1))
