"""The settings of limits: safe when nothing is set, and what is wrong is said with its place and its fix."""

from __future__ import annotations

from pathlib import Path

import pytest

from mountnav.errors import BadSettings
from mountnav.settings.limits import LimitSettings
from mountnav.settings.observatory import Settings

HEAD = """
[site]
latitude_deg = 48.93
longitude_deg = 22.27

[[telescope]]
id = "t"
[telescope.mount]
url = "fake+lx200://"
[telescope.camera]
kind = "simulated"
[telescope.limits]
"""


def limits_of(text: str) -> LimitSettings:
    return Settings.parse(HEAD + text).telescope[0].limits


def test_nothing_set_is_safe() -> None:
    limits = LimitSettings().limits
    assert limits.min_altitude_deg == 15.0
    assert limits.sun_cone_deg == 20.0
    assert limits.past_meridian_deg == (10.0, 10.0)
    assert limits.margin_deg > 0.0
    assert limits.rate_ratio == (0.5, 2.0)


def test_everything_arrives_in_the_core(tmp_path: Path) -> None:
    path = tmp_path / "horizon.txt"
    path.write_text("0 10\n180 30\n", encoding="utf-8")
    limits = limits_of(
        f"""
        min_altitude_deg = 20
        max_altitude_deg = 85
        way_min_altitude_deg = 5
        horizon_file = "{path}"
        hour_angle_deg = [-80, 70]
        declination_deg = [-30, 88]
        past_meridian_east_deg = 3
        past_meridian_west_deg = 180
        first_axis_deg = [-100, 280]
        second_axis_deg = [-40, 220]
        sun_cone_deg = 30
        sun_cone_from_altitude_deg = -3
        moon_cone_deg = 4
        daylight = "refuse"
        daylight_from_altitude_deg = -8
        axis_rates_deg_s = [4, 2]
        margin_deg = 0.5
        slew_takes_s = 60
        track_for_s = 600
        untrusted_tracking_s = 300
        """
    ).limits
    assert limits.horizon is not None
    assert limits.horizon.altitude_at(90.0) == pytest.approx(20.0)
    assert limits.past_meridian_deg == (3.0, 180.0)
    assert limits.rate_ratio == pytest.approx((0.4, 0.625))
    told = {
        name: getattr(limits, name)
        for name in LimitSettings.model_fields
        if hasattr(limits, name) and not name.startswith(("horizon", "past"))
    }
    assert told == {
        "min_altitude_deg": 20.0,
        "max_altitude_deg": 85.0,
        "way_min_altitude_deg": 5.0,
        "hour_angle_deg": (-80.0, 70.0),
        "declination_deg": (-30.0, 88.0),
        "first_axis_deg": (-100.0, 280.0),
        "second_axis_deg": (-40.0, 220.0),
        "sun_cone_deg": 30.0,
        "sun_cone_from_altitude_deg": -3.0,
        "solar_filter": False,
        "moon_cone_deg": 4.0,
        "daylight": "refuse",
        "daylight_from_altitude_deg": -8.0,
        "margin_deg": 0.5,
        "slew_takes_s": 60.0,
        "track_for_s": 600.0,
        "untrusted_tracking_s": 300.0,
    }
    assert limits_of('ways = "any"').limits.rate_ratio is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("min_altitude_deg = 50\nmax_altitude_deg = 40", "leave no sky"),
        ("hour_angle_deg = [60, -60]", "leaves no range"),
        ("horizon_deg = [[0, 10]]", "one point makes no horizon"),
        ("horizon_deg = [[0, 10], [400, 10]]", "not a point of a horizon"),
        ('horizon_deg = [[0, 10], [40, 10]]\nhorizon_file = "x"', "both horizon_file and horizon_deg"),
        ("sun_cone_deg = 95", "sun_cone_deg"),
        ('daylight = "maybe"', "daylight"),
        ("past_meridian_east_deg = -5", "past_meridian_east_deg"),
        ("axis_rates_deg_s = [0, 4]", "axis_rates_deg_s"),
        ("min_altitude = 20", "min_altitude_deg"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(text: str, says: str) -> None:
    with pytest.raises(BadSettings, match=says) as fault:
        limits_of(text)
    assert "line" in str(fault.value)


def test_a_horizon_file_that_is_not_there_is_said_when_it_is_read() -> None:
    with pytest.raises(BadSettings, match="can't be read"):
        _ = limits_of('horizon_file = "/no/such/file"').limits


def test_a_solar_filter_is_the_only_way_to_the_sun() -> None:
    assert limits_of("").limits.solar_filter is False
    with_filter = limits_of("solar_filter = true").limits
    assert (with_filter.solar_filter, with_filter.sun_cone_deg) == (True, 0.0)
    assert limits_of("solar_filter = true\nsun_cone_deg = 12").limits.sun_cone_deg == 12.0
    real = HEAD.replace("fake+lx200://", "lx200+tcp://mount:9999").replace(
        'kind = "simulated"', 'kind = "folder"\npath = "/frames"'
    )
    for cone in ("0", "4.9"):
        with pytest.raises(BadSettings, match="lets the tube of a real mount look at the Sun") as fault:
            Settings.parse(f"{real}sun_cone_deg = {cone}")
        assert "solar_filter = true" in str(fault.value)
    assert Settings.parse(f"{real}sun_cone_deg = 5").telescope[0].limits.sun_cone_deg == 5.0
    assert Settings.parse(f"{real}sun_cone_deg = 0\nsolar_filter = true")
