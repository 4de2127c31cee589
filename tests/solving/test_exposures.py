"""A plate that was exposed twice or three times: each exposure is found, and no further one."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solving.exposures import solve_exposures
from mountnav.solving.settings import SolveSettings

UTC_TAKEN = datetime(1931, 5, 2, 22, tzinfo=UTC)
OPTICS = SimulatedOptics(
    1200, 900, 8.0, rotation_deg=12.0, fwhm_px=4.0, faint_stars_deg2=20.0, sky_adu_s=100.0
)
HINT = Hint(Icrs(150.3, 20.2), 1.0)
SETTINGS = SolveSettings(blind="never")


def _plate(*centers: Icrs) -> Frame:
    """A plate exposed at each of these places, with the grain of an emulsion."""
    frames = [
        draw_frame(
            center, OPTICS, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=UTC_TAKEN, seed=(3, at)
        )
        for at, center in enumerate(centers)
    ]
    light = np.sum([np.asarray(frame.pixels, dtype=np.float64) for frame in frames], axis=0)
    light += np.random.default_rng(8).normal(0.0, 15.0, light.shape)
    return replace(frames[0], pixels=light.astype(np.float32), saturation_adu=None)


@pytest.mark.long
@pytest.mark.parametrize(
    "centers",
    [
        (Icrs(150.0, 20.0),),
        (Icrs(150.0, 20.0), Icrs(150.0, 20.03)),
        (Icrs(150.0, 20.0), Icrs(150.05, 20.05), Icrs(149.6, 20.3)),
    ],
)
def test_each_exposure_is_found_and_no_further_one(centers: tuple[Icrs, ...]) -> None:
    plate = _plate(*centers)
    *found, last = solve_exposures(plate, embedded_catalog(), hint=HINT, settings=SETTINGS)
    assert last.solution is None
    assert last.reason is not None
    places = [verdict.solution.center for verdict in found if verdict.solution is not None]
    assert len(places) == len(centers)
    for center in centers:
        assert min(separation_arcsec(center, place) for place in places) < 0.3 * OPTICS.scale_arcsec_px
    chances = [verdict.solution.false_probability for verdict in found if verdict.solution is not None]
    assert max(chances) < 1e-9
