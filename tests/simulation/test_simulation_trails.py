"""Trails in drawn frames: satellites hold their light, stars are trailed about mid-exposure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mountnav.errors import BadSettings
from mountnav.simulation.render import project
from mountnav.simulation.trails import SatelliteTrail, add_trails, centers_during
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec
from tests.simulation.test_simulation_render import CENTER, SMALL, catalog_round, drawn

DARK = replace(SMALL, sky_adu_s=0.0, read_noise_adu=0.1)


def test_a_trail_holds_its_light_and_its_width() -> None:
    light = np.zeros((400, 600), dtype=np.float32)
    trail = SatelliteTrail(100.0, 50.0, 480.0, 330.0, 200.0, fwhm_px=4.0)
    add_trails(light, [trail])
    length = math.hypot(380.0, 280.0)
    assert light.sum() == pytest.approx(200.0 * length, rel=1e-3)
    y, x = np.mgrid[0:400, 0:600]
    across = ((y - 50.0) * 380.0 - (x - 100.0) * 280.0) / length
    fwhm = math.sqrt(8 * math.log(2) * float((light * across**2).sum() / light.sum()))
    assert fwhm == pytest.approx(4.0, rel=0.02)
    assert float((light * across).sum() / light.sum()) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("ends", [(-500.0, 200.0, 1500.0, 200.0), (300.0, -900.0, 300.0, 900.0)])
def test_what_lies_outside_is_left_out(ends: tuple[float, float, float, float]) -> None:
    light = np.zeros((400, 600), dtype=np.float32)
    add_trails(light, [SatelliteTrail(*ends, 100.0)])
    inside = 600 if ends[1] == ends[3] else 400
    assert light.sum() == pytest.approx(100.0 * inside, rel=1e-3)
    add_trails(light, [SatelliteTrail(-90.0, -90.0, -20.0, -500.0, 100.0)])
    assert light.sum() == pytest.approx(100.0 * inside, rel=1e-3)


@pytest.mark.parametrize(
    "values",
    [(0, 0, 0, 0, 1.0), (0, 0, 1, 1, -1.0), (0, 0, 1, 1, 1.0, 0.0), (0, 0, math.nan, 1, 1.0)],
)
def test_what_is_no_trail_is_refused(values) -> None:
    with pytest.raises(BadSettings):
        SatelliteTrail(*values)


def test_by_default_nothing_is_different() -> None:
    catalog = catalog_round(CENTER)
    plain = drawn(SMALL, catalog)
    same = drawn(SMALL, catalog, trails=(), drift_arcsec_s=(0.0, 0.0))
    assert np.array_equal(plain.pixels, same.pixels)
    crossed = drawn(SMALL, catalog, trails=[SatelliteTrail(0, 0, 600, 400, 900.0)])
    more = crossed.pixels.astype(float) - plain.pixels
    assert more.sum() == pytest.approx(900.0 * math.hypot(600, 400), rel=0.05)


def test_stars_are_trailed_along_the_drift_and_stay_centered() -> None:
    catalog = catalog_round(CENTER, n=9, spread_deg=0.2)
    east, north, exposure = 18.0, -24.0, 2.0  # 60″: ten pixels
    frame = drawn(
        replace(DARK, rotation_deg=30.0), catalog, exposure_s=exposure, drift_arcsec_s=(east, north)
    )
    x, y = project(CENTER, replace(DARK, rotation_deg=30.0), catalog.ra_deg, catalog.dec_deg)
    length_px = 60.0 / DARK.scale_arcsec_px
    sigma2 = (DARK.fwhm_px**2) / (8 * math.log(2))
    for star_x, star_y in zip(x, y, strict=True):
        left, low = round(star_x) - 14, round(star_y) - 14
        stamp = frame.pixels[low : low + 29, left : left + 29].astype(float) - DARK.bias_adu
        rows, columns = np.mgrid[low : low + 29, left : left + 29]
        total = stamp.sum()
        mean_x, mean_y = (stamp * columns).sum() / total, (stamp * rows).sum() / total
        assert (mean_x, mean_y) == pytest.approx((star_x, star_y), abs=0.1)
        covariance = np.cov(np.vstack((columns.ravel(), rows.ravel())), aweights=stamp.ravel().clip(0))
        values, vectors = np.linalg.eigh(covariance)
        assert values[1] == pytest.approx(sigma2 + length_px**2 / 12, rel=0.1)
        assert values[0] == pytest.approx(sigma2, rel=0.15)
        # +y points to position angle 30°; the axis moves to position angle 143.13° (east 18, north -24)
        ahead = math.radians(143.13 - 30.0)
        assert abs(vectors[0, 1] * -math.sin(ahead) + vectors[1, 1] * math.cos(ahead)) > 0.99


def test_centers_are_even_about_mid_exposure() -> None:
    middle = Icrs(10.0, 80.0)
    centers = centers_during(middle, (3.0, 4.0), 10.0, scale_arcsec_px=2.0, sigma_px=1.2)
    offsets = [offset_arcsec(one, middle) for one in centers]
    assert len(centers) == math.ceil(2 * 25.0 / 1.2)
    assert np.mean([one.east_arcsec for one in offsets]) == pytest.approx(0.0, abs=0.01)
    assert np.mean([one.north_arcsec for one in offsets]) == pytest.approx(0.0, abs=0.01)
    assert max(one.total_arcsec for one in offsets) == pytest.approx(25.0 * (1 - 1 / len(centers)), rel=1e-3)
    assert centers_during(middle, (0.0, 0.0), 10.0, scale_arcsec_px=2.0, sigma_px=1.2) == [middle]
    with pytest.raises(BadSettings):
        centers_during(middle, (math.nan, 0.0), 10.0, scale_arcsec_px=2.0, sigma_px=1.2)
