"""Saturated stars by their wings: position and flux against the truth of rendered frames, with bleed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from mountnav.reading import read_frame

GAIN_E_ADU = 1.5  # of every rendered frame: slope of variance over level in their background meshes


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "least"), [("A01", 6), pytest.param("A02", 3, marks=pytest.mark.long), ("D01", 8)]
)
def test_saturated_stars_of_rendered_frames(shared: Path, name: str, least: int) -> None:
    folder = shared / "data" / "rendered"
    truth = next(t for t in json.loads((folder / "truth.json").read_text()) if t["file"].startswith(name))
    found = measure(read_frame(folder / truth["file"]))
    stars = np.array(truth["stars"])
    inside = (stars[:, 0] > 10) & (stars[:, 1] > 10)
    stars = stars[inside & (stars[:, 0] < truth["w"] - 11) & (stars[:, 1] < truth["h"] - 11)]
    distance, index = map(np.asarray, KDTree(np.c_[found.x_px, found.y_px]).query(stars[:, :2]))
    full = (found.flags[index] & int(Flag.SATURATED)) > 0
    assert full.sum() >= least
    assert full[0]
    ratio = GAIN_E_ADU * found.flux[index][full] / stars[full, 2]
    print(
        f"\n{name}: {full.sum()} saturated, errors {np.round(distance[full], 4)}, flux {np.round(ratio, 2)}"
    )
    # the vignetting takes up to a tenth of the light
    assert np.median(distance[full]) < 0.005
    assert distance[full].max() < 0.2
    assert ((ratio > 0.82) & (ratio < 1.1)).all()
