"""Drawn frames of what moves: bodies trailed among the stars, stars trailed behind a tube that follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Stars
from mountnav.errors import BadSettings
from mountnav.frames import Frame, Hint
from mountnav.measuring.measurements import StarImages
from mountnav.navigation.rates_measured import trail_of
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame, project
from mountnav.simulation.trails import MovingBody
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, position_angle_deg, separation_arcsec
from mountnav.solving.solve import solve

MID = datetime(2026, 3, 20, 1, 0, tzinfo=UTC)
CENTER = Icrs(84.0, 21.0)
OPTICS = SimulatedOptics(width_px=1000, height_px=800, scale_arcsec_px=4.0, rotation_deg=33.0, parity=-1)
FAINT = replace(OPTICS, width_px=300, height_px=200)


class NoStars:
    """A catalog of nothing."""

    name = "nothing"

    def cone(self, *args: Any, **given: Any) -> Stars:
        return replace_stars()


def replace_stars() -> Stars:
    return embedded_catalog().cone(Icrs(0.0, 89.0), 1e-6, epoch_yr=2026.0)


def moving(east: float, north: float) -> Callable[[datetime], Icrs]:
    """A path through the center at these rates, arcsec per second."""

    def path(utc: datetime) -> Icrs:
        seconds = (utc - MID).total_seconds()
        return displaced(CENTER, east * seconds, north * seconds)

    return path


def spread(pixels: np.ndarray) -> tuple[float, float, float]:
    """Light above the sky, and its spread in x and y, pixels."""
    light = pixels.astype(float) - np.median(pixels)
    light[light < 30.0] = 0.0
    y, x = np.mgrid[: light.shape[0], : light.shape[1]]
    total = light.sum()
    mx, my = (light * x).sum() / total, (light * y).sum() / total
    return (
        total,
        np.sqrt((light * (x - mx) ** 2).sum() / total),
        np.sqrt((light * (y - my) ** 2).sum() / total),
    )


def drawn(**given: Any) -> Frame:
    return draw_frame(CENTER, FAINT, NoStars(), exposure_s=10.0, mid_exposure_utc=MID, seed=1, **given)


def test_a_body_is_trailed_as_it_moves_in_the_frame_and_keeps_its_light() -> None:
    # along +x: at a right angle to +y's position angle
    east, north = 8.0 * np.sin(np.radians(33.0 + 90.0)), 8.0 * np.cos(np.radians(33.0 + 90.0))
    still = spread(drawn(bodies=[MovingBody(lambda _: CENTER, 9.0)]).pixels)
    trailed = spread(drawn(bodies=[MovingBody(moving(east, north), 9.0)]).pixels)
    assert trailed[0] == pytest.approx(still[0], rel=0.03)
    # 80″ are 20 px: a line of length L has a spread of L / sqrt(12)
    assert trailed[1] == pytest.approx(np.hypot(still[1], 20.0 / np.sqrt(12.0)), rel=0.05)
    assert trailed[2] == pytest.approx(still[2], rel=0.1)


def test_a_body_that_is_followed_is_round_and_in_the_middle() -> None:
    path = moving(5.0, 3.0)
    frame = drawn(bodies=[MovingBody(path, 9.0)], tube=path)
    still = spread(drawn(bodies=[MovingBody(lambda _: CENTER, 9.0)]).pixels)
    assert spread(frame.pixels)[1] == pytest.approx(still[1], rel=0.05)
    x, y = project(CENTER, FAINT, np.array([CENTER.ra_deg]), np.array([CENTER.dec_deg]))
    brightest = np.unravel_index(int(np.argmax(frame.pixels)), frame.pixels.shape)
    assert abs(brightest[1] - x[0]) <= 1.0
    assert abs(brightest[0] - y[0]) <= 1.0


def test_a_tube_that_stands_among_the_stars_draws_the_same_frame_as_before() -> None:
    given: dict[str, Any] = {"exposure_s": 1.0, "mid_exposure_utc": MID, "seed": 3}
    plain = draw_frame(CENTER, OPTICS, embedded_catalog(), **given)
    tube = draw_frame(CENTER, OPTICS, embedded_catalog(), tube=lambda _: CENTER, **given)
    assert np.array_equal(plain.pixels, tube.pixels)


def test_a_body_without_a_magnitude_is_refused() -> None:
    with pytest.raises(BadSettings):
        MovingBody(lambda _: CENTER, float("nan"))


@pytest.mark.long
@pytest.mark.parametrize("length_px", [6.0, 12.0])
def test_the_trail_of_a_drawn_frame_shows_rate_and_direction(length_px: float) -> None:
    exposure_s = 4.0
    speed = length_px * OPTICS.scale_arcsec_px / exposure_s
    path = moving(speed * 0.8, speed * 0.6)
    frame = draw_frame(
        CENTER, OPTICS, embedded_catalog(), exposure_s=exposure_s, mid_exposure_utc=MID, seed=5, tube=path
    )
    verdict = solve(frame, embedded_catalog(), hint=Hint(center=CENTER, radius_deg=1.0))
    assert verdict.solution is not None, verdict.detail
    # the middle of the trails is where the tube looked in the middle of the exposure
    assert separation_arcsec(verdict.solution.center, CENTER) < 4.0
    trail = trail_of(
        verdict.quality,
        scale_arcsec_px=verdict.solution.scale_arcsec_px,
        rotation_deg=verdict.solution.rotation_deg,
        parity=verdict.solution.parity,
        exposure_s=exposure_s,
    )
    assert trail is not None
    assert verdict.quality is not None
    assert verdict.quality.images is StarImages.TRAILED
    truly = length_px * OPTICS.scale_arcsec_px
    assert abs(trail.length_arcsec - truly) < 3.0 * trail.sigma_arcsec
    ends = [path(MID + timedelta(seconds=half)) for half in (-2.0, 2.0)]
    apart = (trail.position_angle_deg - position_angle_deg(*ends) + 90.0) % 180.0 - 90.0
    assert abs(apart) < 8.0
