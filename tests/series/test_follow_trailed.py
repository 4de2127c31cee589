"""A trailed frame in a series is at its middle or not placed; the others are where they were."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from benchmarks.trailed import EPOCH_YR, Path2, drawn, field_of, still
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.series.follow import SeriesFollower
from mountnav.simulation.optics import SimulatedOptics
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

CENTER, SCALE, SIDE = Icrs(310.0, 42.0), 4.5, 768
OPTICS = SimulatedOptics(SIDE, SIDE, SCALE, rotation_deg=33.0, fwhm_px=3.2)
HINT = Hint(CENTER, 0.5, SCALE / 1.03, SCALE * 1.03)


def _double() -> Path2:
    """Two exposures 60 px apart, the second half as bright."""
    share = np.array([2.0, 1.0]) / 3.0
    x, y = np.array([0.0, 48.0]), np.array([0.0, -36.0])
    return Path2(x - (x * share).sum(), y - (y * share).sum(), np.zeros(2), share)


def _gapped() -> Path2:
    """A trail of 90 px with a gap off its middle."""
    t = np.linspace(-45.0, 45.0, 181)
    share = np.where((t > 8.0) & (t < 22.0), 0.0, 1.0)
    share /= share.sum()
    mean = float((t * share).sum())
    return Path2(0.8 * (t - mean), 0.6 * (t - mean), np.zeros(t.size), share)


def _frames(paths: list[Path2]) -> list[Frame]:
    rng = np.random.default_rng(7)
    stars = replace(field_of("clean", rng, OPTICS, CENTER), sky_adu=60.0)
    began = datetime(int(EPOCH_YR), 1, 1, 12, tzinfo=UTC)
    return [
        Frame(
            pixels=drawn(stars, path, rng),
            mid_exposure_utc=began + timedelta(minutes=k),
            exposure_s=10.0,
            saturation_adu=60_000.0,
            source=f"frame {k}",
        )
        for k, path in enumerate(paths)
    ]


@pytest.mark.parametrize(
    ("odd", "place"),
    [
        pytest.param(_double(), 0, id="double first", marks=pytest.mark.long),
        pytest.param(_gapped(), 2, id="gapped third"),
        pytest.param(_double(), 2, id="double third", marks=pytest.mark.long),
        pytest.param(_gapped(), 0, id="gapped first", marks=pytest.mark.long),
    ],
)
def test_a_trailed_frame_is_at_its_middle_or_nowhere(odd: Path2, place: int) -> None:
    paths = [still(np.random.default_rng(0)) for _ in range(4)]
    paths[place] = odd
    follower = SeriesFollower(embedded_catalog(), hint=HINT)
    results = [follower.add(frame) for frame in _frames(paths)]
    for k, result in enumerate(follower.results):
        if result.solution is None:
            assert k == place, result.notes
            continue
        off_px = separation_arcsec(result.solution.center, CENTER) / SCALE
        assert off_px <= (3.0 if k == place else 0.2), (k, off_px, result.notes)
    assert len(results) == 4
