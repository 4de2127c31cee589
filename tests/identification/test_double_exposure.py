"""Two exposures in one, far apart: the light that is left over is held against the rest of the sky."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.trailed import RIGHT_PX, trial, ways
from mountnav.catalog.embedded import embedded_catalog
from mountnav.identification.double_exposure import UnexplainedLight, _Raster, find_second_field
from mountnav.identification.plate import Plate, similarity_plate
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse
from mountnav.solution import Reason
from mountnav.solving.solve import solve

SIDE_PX = 1000
SCALE = 4.0
CENTER = Icrs(83.0, 40.0)
Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def _plate(*, mirrored: bool = False, rotation_deg: float = 0.0) -> Plate:
    """SCALE arcsec per pixel, the frame's center at the tangent point."""
    turn = SCALE * np.exp(1j * math.radians(rotation_deg))
    middle = complex(0.5 * (SIDE_PX - 1), 0.5 * (SIDE_PX - 1))
    shift = -turn * (middle.conjugate() if mirrored else middle)
    return similarity_plate(CENTER, turn, shift, mirrored=mirrored, width_px=SIDE_PX, height_px=SIDE_PX)


def _sky(seed: int) -> Complex:
    """Stars in the tangent plane, arcsec: 40 for each area of the frame, two frames' widths all about."""
    rng = np.random.default_rng(seed)
    half = 2.5 * SIDE_PX * SCALE
    return rng.uniform(-half, half, 1000) + 1j * rng.uniform(-half, half, 1000)


def _seen(plate: Plate, sky: Complex, place: complex, turn_rad: float) -> UnexplainedLight:
    """What a frame with its center at another place, turned, shows of them, in pixels."""
    x, y = plate.pixels(*_parts((sky - place) * np.exp(1j * turn_rad)))
    inside = (x > 0) & (y > 0) & (x < SIDE_PX) & (y < SIDE_PX)
    x, y = x[inside], y[inside]
    return UnexplainedLight(x, y, np.ones(x.size), np.zeros(0, dtype=np.int64), many=True)


def _parts(places: Complex) -> tuple[Array, Array]:
    return places.real.copy(), places.imag.copy()


def _places(sky: Complex) -> tuple[Array, Array]:
    ra_deg, dec_deg = gnomonic_inverse(
        np.radians(sky.real / 3600), np.radians(sky.imag / 3600), CENTER.ra_deg, CENTER.dec_deg
    )
    return np.asarray(ra_deg), np.asarray(dec_deg)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(("away", "turn_rad"), [(2400.0 - 1200.0j, 0.0), (-3000.0 + 2800.0j, 0.12)])
def test_another_place_is_found_and_its_offset_told(mirrored: bool, away: complex, turn_rad: float) -> None:
    plate, sky = _plate(mirrored=mirrored, rotation_deg=71.0), _sky(3)
    strangers = _seen(plate, sky, away, turn_rad)
    found = find_second_field(strangers, plate, *_places(sky), (SIDE_PX, SIDE_PX))
    assert found is not None
    assert found.stars >= 0.9 * strangers.x_px.size
    assert abs(found.turn_rad) == pytest.approx(turn_rad, abs=0.003)
    # a star at the frame's center is seen there by the second exposure
    x, y = plate.pixels(*_parts(np.array([-away * np.exp(1j * turn_rad)])))
    middle = 0.5 * (SIDE_PX - 1)
    assert abs(found.offset_px - complex(x[0] - middle, y[0] - middle)) < 3.0


def test_half_of_the_strangers_may_be_none_of_its_stars() -> None:
    plate, sky = _plate(), _sky(4)
    seen = _seen(plate, sky, 3000.0 + 0j, 0.0)
    rng = np.random.default_rng(5)
    count = seen.x_px.size
    order = rng.permutation(2 * count)
    x = np.concatenate((seen.x_px, rng.uniform(0, SIDE_PX, count)))[order]
    y = np.concatenate((seen.y_px, rng.uniform(0, SIDE_PX, count)))[order]
    strangers = UnexplainedLight(x, y, np.ones(2 * count), seen.known, many=True)
    assert find_second_field(strangers, plate, *_places(sky), (SIDE_PX, SIDE_PX)) is not None


def test_strangers_and_the_plate_itself_are_no_other_place() -> None:
    plate, sky = _plate(), _sky(6)
    places = _places(sky)
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        x, y = rng.uniform(0, SIDE_PX, 40), rng.uniform(0, SIDE_PX, 40)
        strange = UnexplainedLight(x, y, np.ones(40), np.zeros(0, dtype=np.int64), many=True)
        assert find_second_field(strange, plate, *places, (SIDE_PX, SIDE_PX)) is None
    # its own stars, seen a few pixels beside: a halo, a neighbor, a piece
    own = _seen(plate, sky, 12.0 - 8.0j, 0.0)
    assert find_second_field(own, plate, *places, (SIDE_PX, SIDE_PX)) is None


def test_too_few_tell_nothing() -> None:
    plate, sky = _plate(), _sky(7)
    seen = _seen(plate, sky, 3000.0 + 0j, 0.0)
    few = UnexplainedLight(seen.x_px[:5], seen.y_px[:5], np.ones(5), seen.known, many=False)
    places = _places(sky)
    assert find_second_field(few, plate, *places, (SIDE_PX, SIDE_PX)) is None
    assert find_second_field(seen, plate, places[0][:5], places[1][:5], (SIDE_PX, SIDE_PX)) is None
    one = UnexplainedLight(np.full(9, 500.0), np.full(9, 500.0), np.ones(9), seen.known, many=True)
    assert find_second_field(one, plate, *places, (SIDE_PX, SIDE_PX)) is None


@pytest.mark.parametrize("seed", [2, *(pytest.param(one, marks=pytest.mark.long) for one in (5, 17, 33, 62))])
def test_a_frame_of_two_places_is_no_solution_at_the_fainter_one(seed: int) -> None:
    # 200 to 560 px off, with odds of 1e-16 to 1e-130
    one = trial(seed, ("two-places",))
    verdict = solve(one.frame, embedded_catalog(), hint=one.hint, settings=ways(seed))
    assert verdict.solution is None or one.error_px(verdict) <= RIGHT_PX, one.error_px(verdict)


@pytest.mark.long
def test_the_fainter_of_two_images_is_no_solution_where_few_stars_have_theirs_in_the_frame() -> None:
    # 206 px off with odds of 1e-37: 360 px apart in a frame of 768, one of them drawn out, so that the mean
    # over sixteen stars doesn't show it
    one = trial(59_025)
    verdict = solve(one.frame, embedded_catalog(), hint=one.hint, settings=ways(59_025))
    assert verdict.solution is None
    assert verdict.reason is Reason.TRAILED


@pytest.mark.parametrize("near_px", [0.5, 3.0, 40.0])
def test_the_raster_passes_over_nothing_that_is_near(near_px: float) -> None:
    rng = np.random.default_rng(int(near_px))
    there = rng.uniform(-300, 300, 80) + 1j * rng.uniform(-300, 300, 80)
    raster = _Raster(there, 0j, 300.0, near_px)
    away = near_px * rng.uniform(0, 1.5, (4000, 1)) * np.exp(2j * math.pi * rng.random((4000, 1)))
    place = np.concatenate(((there + away).ravel(), 1e6 * (rng.normal(size=100) + 1j * rng.normal(size=100))))
    near = np.array([np.abs(one - there).min() for one in place[::7]]) < near_px
    told = raster.may_be_near(place[::7])
    assert near.any()
    assert not (near & ~told).any()
    assert not told[-10:].any()
