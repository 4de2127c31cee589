"""Rendered frames, whole way: the plate over the whole field against exact truth."""

import numpy as np
import pytest

from benchmarks.frames import rendered
from benchmarks.rendered import Score, score, truths
from mountnav.catalog.embedded import embedded_catalog
from mountnav.solving.solve import SolveSettings


def scores(shared, names, settings=None):
    points, catalog = truths(shared), embedded_catalog()
    found = [
        score(known, points[known.path.name], catalog, settings)
        for known in rendered(shared)
        if known.path.name[:3] in names
    ]
    assert len(found) == len(names)
    assert all(isinstance(one, Score) for one in found)
    return found


@pytest.mark.long
def test_sixteen_stars_hold_the_whole_field(shared):
    for one in scores(shared, ("E00", "E02")):
        assert one.center_px < 0.02
        assert one.field_rms_px < 0.02
        assert one.worst_px < 0.1
        assert one.center_px < 4 * one.center_sigma_px


@pytest.mark.long
def test_a_handful_of_stars_is_not_swayed_by_a_bleeding_one(shared):
    glanced = scores(shared, ("D00",))[0]
    (measured,) = scores(shared, ("D00",), SolveSettings(glance=False))
    for one in (glanced, measured):
        assert one.center_px < 0.1
        assert one.worst_px < 0.3
    assert measured.rejected_by["bleed"] >= 1


@pytest.mark.long
def test_rendered_frames_reach_the_figures(shared):
    found = scores(shared, ("A01", "A02", "B01", "B02", "C00", "C02", "E00", "E02", "E03"))
    assert np.median([one.center_px for one in found]) <= 0.02
    assert np.median([one.field_rms_px for one in found]) <= 0.01
    assert max(one.worst_px for one in found) <= 0.1
