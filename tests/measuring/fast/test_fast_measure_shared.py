"""The fast measurement against the exact truth of rendered frames, and against `measure` on real ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mountnav.measuring.fast import measure_fast
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from mountnav.reading import demosaiced, read_frame
from tests.measuring.nearest import nearest
from tests.short_part import one_in

pytestmark = pytest.mark.shared
NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "rough_px", "fine_px"),
    [
        ("A01", 0.015, 0.009),
        ("B02", 0.04, 0.021),
        ("C00", 0.04, 0.036),
        ("D01", 0.01, 0.006),
        ("E00", 0.015, 0.006),
        ("E03", 0.02, 0.014),
    ],
)
def test_rendered_stars_are_where_they_are(shared: Path, name: str, rough_px: float, fine_px: float) -> None:
    folder = shared / "data" / "rendered"
    truth = next(e for e in json.loads((folder / "truth.json").read_text()) if e["file"].startswith(name))
    seen = measure_fast(read_frame(folder / truth["file"]))
    assert seen is not None
    stars = np.array(truth["stars"])
    x, y = stars[:, 0], stars[:, 1]
    stars = stars[(x > 5) & (y > 5) & (x < truth["w"] - 6) & (y < truth["h"] - 6)]
    found = seen.measurements
    distance, index = nearest(np.c_[found.x_px, found.y_px], stars[:100, :2])
    clean = (distance < 1.5) & (found.flags[index] & (Flag.SATURATED | Flag.BLENDED) == 0)
    assert (distance[~((found.flags[index] & Flag.SATURATED) > 0)] < 1.5).mean() > 0.95
    assert np.median(distance[clean]) < rough_px
    rng = np.random.default_rng(0)
    wanted = stars[:, :2] + rng.normal(0.0, 0.4, (len(stars), 2))
    found = seen.measured_at(wanted[:, 0], wanted[:, 1], reach_px=3.0)
    distance, index = nearest(np.c_[found.x_px, found.y_px], stars[:, :2])
    assert (distance < 1.0).mean() > 0.98
    clean = (distance < 1.0) & (found.flags[index] == 0)
    print(f"\n{name}: {np.median(distance[clean]):.4f} px, {clean.sum()} stars")
    assert clean.mean() > (0.4 if name == "D01" else 0.9)  # half of D01's listed stars are saturated
    assert np.median(distance[clean]) < fine_px
    full = (distance < 3.0) & (found.flags[index] & Flag.SATURATED > 0)
    assert (distance[full] < 0.15).all()
    pull = np.r_[
        (found.x_px[index] - stars[:, 0])[clean] / found.x_sigma_px[index][clean],
        (found.y_px[index] - stars[:, 1])[clean] / found.y_sigma_px[index][clean],
    ]
    assert 0.6 < np.ptp(np.percentile(pull, [16.0, 84.0])) / 2.0 < 1.4


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    one_in(
        2,
        [
            "rzellem+EXOTIC_sampledata/HATP-32171220013612.FITS.gz",
            "esa+tetra3/2019-07-29T204726_Alt40_Azi135_Try1.tiff",
            "smroid+cedar-solve/orion2.jpg",
            "brickbots+PiFinder/orion_bad.png",
            "tlemoult+astrometry/FINDER-1.fits.gz",
            "thatsfine+pteropractice/Practice_Star_Field.fits.gz",
            "jbirky+AsteroidAstrometry/d1038.fits.gz",
            "panoptes+POCS/solved.fits.fz",
        ],
    ),
)
def test_real_frames_show_the_sources_that_measure_sees(shared: Path, name: str) -> None:
    frame = demosaiced(read_frame(shared / "data" / "frames" / name))
    seen, whole = measure_fast(frame), measure(frame)
    assert seen is not None
    best = np.flatnonzero(whole.flags & NO_STAR == 0)[:40]
    found = seen.measurements
    distance, _ = nearest(np.c_[found.x_px, found.y_px], np.c_[whole.x_px, whole.y_px][best])
    assert (distance < 2.0).mean() > 0.85
    star = np.flatnonzero(found.flags & NO_STAR == 0)[:40]
    distance, _ = nearest(np.c_[whole.x_px, whole.y_px], np.c_[found.x_px, found.y_px][star])
    assert (distance < 2.0).mean() > 0.85
    again = seen.measured_at(whole.x_px[best], whole.y_px[best], reach_px=2.0)
    distance, _ = nearest(np.c_[again.x_px, again.y_px], np.c_[whole.x_px, whole.y_px][best])
    assert (distance < 2.0).mean() > 0.85
    assert again.quality is not None


@pytest.mark.parametrize(
    "name",
    [
        "rzellem+EXOTIC_sampledata/HATP-32171220013343.FITS.gz",
        "RTS2+rts2/fram.fits.gz",
        "karenlmasters+ObservationalAstrophysics/M42_30_1.FIT.gz",
        "vertighel+jallsky-old/test.fits.gz",
        "oresat+oresat-star-tracker-software/bayered.bmp",
    ],
)
def test_trailed_defocused_and_indoor_frames_are_left_to_measure(shared: Path, name: str) -> None:
    assert measure_fast(demosaiced(read_frame(shared / "data" / "frames" / name))) is None
