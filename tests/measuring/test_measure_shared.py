"""Measuring against rendered frames with exact truth, and on real frames of many cameras."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from mountnav.reading import read_frame

pytestmark = pytest.mark.shared


OTHERS = [pytest.param(name, marks=pytest.mark.long) for name in ("A02", "E00", "E03")]


@pytest.mark.parametrize("name", ["B01", "C00", "D01", *OTHERS])
def test_rendered_stars_are_found_where_they_are(shared: Path, name: str) -> None:
    folder = shared / "data" / "rendered"
    truth = next(e for e in json.loads((folder / "truth.json").read_text()) if e["file"].startswith(name))
    found = measure(read_frame(folder / truth["file"]))
    stars = np.array(truth["stars"])[:150]
    x, y = stars[:, 0], stars[:, 1]
    stars = stars[(x > 5) & (y > 5) & (x < truth["w"] - 6) & (y < truth["h"] - 6)]
    distance, index = map(np.asarray, KDTree(np.c_[found.x_px, found.y_px]).query(stars[:, :2]))
    saturated = (distance < 3) & ((found.flags[index] & Flag.SATURATED) > 0)
    complete = float((distance[~saturated] < 1.5).mean())
    clean = (distance < 1.5) & (found.flags[index] == 0)
    error = float(np.median(distance[clean]))
    print(f"\n{name}: {complete:.1%} complete, median centroid error {error:.4f} px")
    assert complete >= 0.95
    assert error < 0.05
    assert clean.sum() >= 0.8 * (~saturated).sum()


@pytest.mark.parametrize(
    "name", ["B02", pytest.param("A01", marks=pytest.mark.long), pytest.param("C02", marks=pytest.mark.long)]
)
def test_the_hundred_brightest_clean_ones_are_stars(shared: Path, name: str) -> None:
    folder = shared / "data" / "rendered"
    truth = next(e for e in json.loads((folder / "truth.json").read_text()) if e["file"].startswith(name))
    found = measure(read_frame(folder / truth["file"]))
    best = np.flatnonzero(found.flags == 0)[:100]
    distance, _ = KDTree(np.array(truth["stars"])[:, :2]).query(np.c_[found.x_px, found.y_px][best])
    assert np.mean(distance < 1.5) >= 0.97


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("panoptes+POCS/unsolved.fits.gz", 400, 1500),
        pytest.param(
            "rzellem+EXOTIC_sampledata/HATP-32171220013343.FITS.gz", 400, 1500, marks=pytest.mark.long
        ),
        ("esa+tetra3/2019-07-29T204726_Alt40_Azi135_Try1.tiff", 100, 400),
        ("smroid+cedar-solve/orion2.jpg", 60, 300),
        ("brickbots+PiFinder/orion_bad.png", 60, 300),
        ("tlemoult+astrometry/FINDER-1.fits.gz", 40, 150),
        ("astropy+astropy-data/HorseHead.fits.gz", 80, 300),
        pytest.param(
            "karenlmasters+ObservationalAstrophysics/M42_30_1.FIT.gz", 8, 60, marks=pytest.mark.long
        ),
        ("thatsfine+pteropractice/Practice_Star_Field.fits.gz", 200, 1200),
        ("jbirky+AsteroidAstrometry/d1038.fits.gz", 40, 150),
        pytest.param("oresat+oresat-star-tracker-software/bayered.bmp", 0, 40, marks=pytest.mark.long),
    ],
)
def test_real_frames_give_a_sensible_number_of_clean_sources(
    shared: Path, name: str, least: int, most: int
) -> None:
    found = measure(read_frame(shared / "data" / "frames" / name))
    clean = int((found.flags == 0).sum())
    assert least <= clean <= most
