"""What is read or computed once where it was several times: the same to the last digit as step by step."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.star_counts import DEEPER_MAG, DEEPEST_MAG, stars_deep_enough
from mountnav.catalog.stars import Stars
from mountnav.identification.pairing import Predicted, predicted
from mountnav.identification.plate import Plate
from mountnav.measuring.segmentation import segment_light
from mountnav.sky.coordinates import Icrs

PLACES = (Icrs(83.8, -5.4), Icrs(201.0, 27.0), Icrs(300.0, 40.0), Icrs(10.0, 89.9))
EPOCH_YR = 2026.5


def step_by_step(
    catalog: PackedStore, center: Icrs, radius_deg: float, limit: float | None, count: float
) -> Stars:
    """Read the catalog to a limit, then deeper and deeper."""
    while True:
        stars = catalog.cone(center, radius_deg, epoch_yr=EPOCH_YR, mag_limit=limit)
        if limit is None or len(stars) >= count:
            return stars
        limit = limit + DEEPER_MAG if limit + DEEPER_MAG < catalog.magnitudes[1] else None


@pytest.mark.parametrize("radius_deg", [0.3, 1.3])
@pytest.mark.parametrize("center", PLACES)
def test_a_cone_that_is_read_whole_holds_what_is_read_step_by_step(center: Icrs, radius_deg: float) -> None:
    catalog = embedded_catalog()
    there = len(catalog.cone(center, radius_deg, epoch_yr=EPOCH_YR))
    assert there <= catalog.most_in(center, radius_deg)
    for count in (0.5 * there, there - 1.0, there, 1.2 * there, 10.0 * there):
        for limit in (DEEPEST_MAG, DEEPEST_MAG + 0.123):
            found = stars_deep_enough(catalog, center, radius_deg, limit, count, epoch_yr=EPOCH_YR)
            slowly = step_by_step(catalog, center, radius_deg, limit, count)
            for field in dataclasses.fields(Stars):
                one, other = getattr(found, field.name), getattr(slowly, field.name)
                assert np.array_equal(
                    one, other, equal_nan=isinstance(one, np.ndarray) and one.dtype == float
                )


def test_a_patch_is_that_of_the_nearest_of_nine_bins() -> None:
    rng = np.random.default_rng(3)
    pixels = rng.normal(100.0, 3.0, (300, 260)).astype(np.float32)
    for x, y in rng.uniform(0, 259, (60, 2)):
        pixels[int(y) : int(y) + 3, int(x) : int(x) + 3] += 200.0
    patches = segment_light(pixels)
    x, y = rng.uniform(-40.0, 300.0, (2, 4000))
    height, width = patches.labels.shape
    column = np.rint((x - 0.5 * (patches.bin_px - 1)) / patches.bin_px).astype(int)
    row = np.rint((y - 0.5 * (patches.bin_px - 1)) / patches.bin_px).astype(int)
    slowly = np.zeros(x.size, dtype=int)
    for down, right in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        there = patches.labels[np.clip(row + down, 0, height - 1), np.clip(column + right, 0, width - 1)]
        slowly = np.where(slowly == 0, there, slowly)
    assert (slowly > 0).sum() > 100
    assert np.array_equal(patches.at(x, y), slowly - 1)


def test_a_prediction_is_remembered_for_that_plate_and_those_stars_alone() -> None:
    center = PLACES[0]
    stars = embedded_catalog().cone(center, 1.5, epoch_yr=EPOCH_YR)
    plate = Plate(
        center, 399.5, 299.5, 400.0, 1, 1, np.array([0.0, 1600.0, 0.0]), np.array([0.0, 0.0, 1600.0])
    )

    def seen(plate: Plate, stars: Stars, margin_px: float = 0.0) -> Predicted:
        return predicted(plate, stars, width_px=800, height_px=600, margin_px=margin_px)

    first = seen(plate, stars)
    assert seen(plate, stars) is first
    with pytest.raises(ValueError, match="read-only"):
        first.x_px[0] = 0.0
    wider = seen(plate, stars, 50.0)
    assert len(wider) > len(first)
    moved = seen(dataclasses.replace(plate, center_x_px=400.5), stars)
    assert not np.array_equal(moved.x_px, first.x_px)
    fewer = seen(plate, stars.only(np.arange(20)))
    assert len(fewer) <= 20
    again = seen(plate, stars)
    assert again is not first
    assert np.array_equal(again.x_px, first.x_px)
