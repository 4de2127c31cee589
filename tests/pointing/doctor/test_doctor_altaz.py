"""Alt-azimuth mounts: healthy ones are healthy, and a clock that is an hour wrong is named."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from mountnav.pointing.doctor import Illness, diagnose
from mountnav.pointing.doctor.facts import from_altaz, to_altaz
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.chain import (
    hour_angle_to_apparent,
    hour_angle_to_icrs,
    observed_to_hour_angle,
)
from mountnav.sky.coordinates import Air, GeometricHourAngle, Observed, Site
from mountnav.sky.sphere import half_turn_deg, position_angle_deg

SITE = Site(48.93, 22.27, 700.0)
START = datetime(2026, 11, 21, 20, tzinfo=UTC)


def looks(
    seed: int, *, ahead_s: float = 0.0, derotated: bool = False, count: int = 5
) -> list[PointingObservation]:
    """Zero points of 20′, tilted by 3′, 40″ of noise."""
    rng = np.random.default_rng(seed)
    found = []
    utc = START
    for number in range(count):
        az, alt = float(rng.uniform(0.0, 360.0)), float(rng.uniform(30.0, 75.0))
        true = Observed(az, alt, utc)
        tilt = 0.05 * np.array([-np.sin(np.radians(az)) * np.tan(np.radians(alt)), -np.cos(np.radians(az))])
        noise = rng.normal(0.0, 40.0 / 3600.0, 2)
        believed = Observed(az - 0.33 - tilt[0] + noise[0], alt + 0.2 - tilt[1] + noise[1], utc)
        mind = observed_to_hour_angle(believed, SITE)
        numbers = GeometricHourAngle(half_turn_deg(mind.ha_deg - ahead_s / 240.0), mind.dec_deg, utc)
        seen = hour_angle_to_icrs(observed_to_hour_angle(true, SITE), SITE, Air())
        above = hour_angle_to_icrs(observed_to_hour_angle(Observed(az, alt + 0.02, utc), SITE), SITE, Air())
        found.append(
            PointingObservation(
                utc=utc,
                seen=seen,
                sigma_arcsec=0.5,
                reading=hour_angle_to_apparent(numbers, SITE),
                segment_id="s",
                rotation_deg=20.0 if derotated else (position_angle_deg(seen, above) + 33.0) % 360.0,
                look_id=str(number),
            )
        )
        utc += timedelta(minutes=20)
    return found


def ask(observations):
    return diagnose(
        observations,
        site=SITE,
        believed_epoch="apparent",
        mounting="altaz",
        synced_on=[],
        sign_confirmed=True,
    )


@pytest.mark.long
@pytest.mark.parametrize("derotated", [False, True])
def test_a_healthy_one_is_healthy(derotated: bool) -> None:
    for seed in range(6):
        said = ask(looks(seed, derotated=derotated))
        assert said.healthy is True, said.words


@pytest.mark.long
@pytest.mark.parametrize("hours", [1, -1, 5])
def test_a_clock_wrong_by_hours_is_named(hours: int) -> None:
    for seed in range(3):
        (finding,) = ask(looks(seed, ahead_s=3600.0 * hours)).findings
        assert finding.what is Illness.CLOCK
        assert ("ahead" if hours > 0 else "behind") in finding.words
        assert finding.numbers["clock"].value == pytest.approx(3600.0 * hours, abs=5.0)


def test_frames_turn_and_turn_back() -> None:
    angles = np.radians(np.array([[10.0, 20.0], [-150.0, 70.0], [80.0, -5.0]]))
    assert np.allclose(from_altaz(to_altaz(angles, 0.85), 0.85), angles)
