"""The plate fit with expected sizes: what it says of pairs left out is what leaving them out gives."""

import numpy as np
import pytest

from mountnav.identification.camera_fit import fit_camera
from mountnav.identification.plate import similarity_plate
from mountnav.sky.coordinates import Icrs

WIDTH, HEIGHT = 1200, 900


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [12, 60])
def test_leverage_and_distance_are_those_of_a_fit_without_the_pair(degree, count):
    rng = np.random.default_rng(10 * degree + count)
    like = similarity_plate(
        Icrs(80.0, 20.0), 3.0 + 0.4j, 5.0 - 2.0j, mirrored=False, width_px=WIDTH, height_px=HEIGHT
    )
    x, y = rng.uniform(0, WIDTH, count), rng.uniform(0, HEIGHT, count)
    xi, eta = like.tangential(x, y)
    # bounded errors: none lies in the tails, where a pair's weight depends on its own deviation
    xi, eta = xi + rng.uniform(-0.05, 0.05, count), eta + rng.uniform(-0.05, 0.05, count)
    known = np.full(count, 0.1)
    whole = fit_camera(like, x, y, xi, eta, known, degree, floor_px=0.03)
    got = whole.plate.tangential(x, y)
    residual = np.hypot(got[0] - xi, got[1] - eta)
    assert np.all((whole.influence.leverage > 0) & (whole.influence.leverage < 1))
    for one in range(0, count, 5):
        rest = np.arange(count) != one
        without = fit_camera(
            like,
            x[rest],
            y[rest],
            xi[rest],
            eta[rest],
            known[rest],
            degree,
            floor_px=0.03,
            belief=whole.belief,
        )
        seen = without.plate.tangential(x[[one]], y[[one]])
        distance = float(np.hypot(seen[0][0] - xi[one], seen[1][0] - eta[one]))
        # exact for one strength of distortion; the answer is an average over several
        assert whole.influence.apart_arcsec[one] == pytest.approx(distance, rel=0.05)
        assert residual[one] / (1.0 - whole.influence.leverage[one]) == pytest.approx(distance, rel=0.15)
