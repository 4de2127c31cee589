"""Errors are as large as stated: frames of one field differ by no more than they say, nor by far less."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from mountnav.frames import Frame
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Measurements
from mountnav.reading import read_frame
from tests.measuring.painted import painted, scattered

SERIES = "rzellem+EXOTIC_sampledata/HATP-32171220013{}.FITS.gz"


def clean(found: Measurements) -> np.ndarray:
    table: np.ndarray = np.c_[found.x_px, found.y_px, found.x_sigma_px, found.flux, found.flux_sigma][
        found.flags == 0
    ]
    return table


def paired(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the same stars in two lists that differ by a few pixels' shift."""
    away = (other[:60, None, :2] - one[None, :60, :2]).reshape(-1, 2)
    near = KDTree(away).query_ball_point(away, 1.0)
    shift = away[max(near, key=len)].mean(axis=0)
    distance, index = map(np.asarray, KDTree(other[:, :2]).query(one[:, :2] + shift))
    return one[distance < 1.5], other[index[distance < 1.5]]


def spread(values: np.ndarray) -> float:
    return float(1.4826 * np.median(np.abs(values)))


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.parametrize("band", [(4.0, 10.0), (10.0, 25.0)])
def test_stated_errors_match_the_scatter_between_real_frames(shared: Path, band: tuple[float, float]) -> None:
    frames = [shared / "data" / "frames" / SERIES.format(time) for time in ("612", "912")]
    one, other = paired(*(clean(measure(read_frame(path))) for path in frames))
    moved = other[:, 0] - one[:, 0]
    plane = np.c_[np.ones(len(one)), one[:, :2]]
    trusted = np.ones(len(one), dtype=bool)
    for _ in range(5):
        left = moved - plane @ np.linalg.lstsq(plane[trusted], moved[trusted], rcond=None)[0]
        trusted = np.abs(left) < 4.0 * spread(left)
    brighter = np.log(other[:, 3] / one[:, 3])
    of_place = left / np.hypot(one[:, 2], other[:, 2])
    of_flux = (brighter - np.median(brighter)) / np.hypot(one[:, 4] / one[:, 3], other[:, 4] / other[:, 3])
    snr = one[:, 3] / one[:, 4]
    here = (snr > band[0]) & (snr < band[1])
    print(f"\n{here.sum()} stars: place {spread(of_place[here]):.2f}, flux {spread(of_flux[here]):.2f}")
    assert here.sum() > 100
    # what no PSF explains of an image counts as error, and in part repeats itself from frame to frame
    assert 0.4 < spread(of_place[here]) < 1.4
    assert 0.4 < spread(of_flux[here]) < 1.3


def test_the_unit_of_a_frame_without_sky_changes_nothing() -> None:
    x, y = scattered(100, (400, 400), seed=61)
    electrons = np.geomspace(1e3, 2e5, 100)
    image = painted(x, y, electrons, fwhm_px=2.6, size=(400, 400), seed=62) - 100.0
    whole, milli = (measure(Frame(pixels=(image * unit).astype(np.float32))) for unit in (1.0, 1e-3))
    assert len(whole) == len(milli) >= 98
    assert np.allclose(whole.x_px, milli.x_px, atol=2e-3)
    assert np.allclose(whole.flux / whole.flux_sigma, milli.flux / milli.flux_sigma, rtol=0.02)


@pytest.mark.long
@pytest.mark.shared
def test_no_error_is_stated_as_zero(shared: Path) -> None:
    # charge that ran over hides nearly all pixels of some sources in this frame
    found = measure(read_frame(shared / "data" / "frames" / SERIES.format("343")))
    for sigma in (found.x_sigma_px, found.y_sigma_px, found.flux_sigma):
        assert (sigma > 0.0).all()
