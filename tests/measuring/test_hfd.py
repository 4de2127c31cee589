"""Half flux diameters: by their definition on drawn stars, and beside ASTAP's on drawn frames."""

from __future__ import annotations

import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame
from mountnav.measuring.hfd import measure_hfd
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from tests.measuring.nearest import nearest

TAKEN = datetime(2026, 3, 1, 3, tzinfo=UTC)


def _painted(image: np.ndarray, flux: float = 60_000.0, noise: float = 4.0) -> Frame:
    """Stars of one image (a function of dx, dy) at places off the pixels' middles, on a noisy sky."""
    random = np.random.default_rng(11)
    pixels = random.normal(500.0, noise, (400, 500))
    side = image.shape[0]
    for row in range(6):
        for column in range(8):
            top, left = 20 + 60 * row, 15 + 58 * column
            pixels[top : top + side, left : left + side] += flux * image
    return Frame(pixels=pixels.astype(np.float32))


def _disc(
    inner_px: float, outer_px: float, sigma_px: float = 0.0, side: int = 41, fine: int = 11
) -> np.ndarray:
    """A ring, or a Gaussian where it has no radius, drawn by fine pixels; its light is 1."""
    side, fine = 41, 11
    steps = (np.arange(side * fine) + 0.5) / fine - side / 2 - 0.27
    radius = np.hypot(steps[:, None], steps)
    light = (
        np.exp(-0.5 * (radius / sigma_px) ** 2)
        if sigma_px
        else ((radius <= outer_px) & (radius >= inner_px)).astype(float)
    )
    coarse: np.ndarray = light.reshape(side, fine, side, fine).sum(axis=(1, 3))
    return coarse / float(coarse.sum())


@pytest.mark.parametrize("sigma_px", [0.8, 1.2, 2.0, 3.0])
def test_a_gaussian_has_two_and_a_half_sigma(sigma_px: float) -> None:
    stars = measure_hfd(_painted(_disc(0, 0, sigma_px)))
    assert len(stars) == 48
    # pixels widen a star: their own variance is 1/12 px²
    expected = np.sqrt(2 * np.pi) * np.hypot(sigma_px, np.sqrt(1 / 12))
    assert stars.median_px == pytest.approx(expected, rel=0.02)
    assert np.median(stars.flux) == pytest.approx(60_000.0, rel=0.02)


@pytest.mark.parametrize(("inner_px", "outer_px"), [(0.0, 5.0), (0.0, 9.0), (3.0, 7.0), (5.0, 10.0)])
def test_far_out_of_focus_a_star_is_a_disc_or_a_ring(inner_px: float, outer_px: float) -> None:
    stars = measure_hfd(_painted(_disc(inner_px, outer_px), flux=400_000.0))
    assert len(stars) == 48  # once each, though a ring has many peaks
    mean = 2 / 3 * (outer_px**3 - inner_px**3) / (outer_px**2 - inner_px**2)
    assert stars.median_px == pytest.approx(2 * mean, rel=0.03)


def test_noise_and_hot_pixels_are_no_stars() -> None:
    random = np.random.default_rng(2)
    pixels = random.normal(1000.0, 10.0, (300, 400)).astype(np.float32)
    pixels[random.integers(0, 300, 60), random.integers(0, 400, 60)] = 30_000.0
    assert len(measure_hfd(Frame(pixels=pixels), least_snr=7.0)) == 0
    assert measure_hfd(Frame(pixels=pixels)).median_px is None


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((20, 20), np.uint16),
        np.zeros((100, 100), np.uint16),
        np.full((100, 100), 65535, np.uint16),
        np.full((100, 100), np.nan, np.float32),
        np.eye(100, dtype=np.uint8) * 200,
    ],
)
def test_frames_without_stars_have_none(pixels: np.ndarray) -> None:
    assert len(measure_hfd(Frame(pixels=pixels))) == 0


def test_only_stars_of_enough_light_are_listed_the_brightest_first() -> None:
    image = _disc(0, 0, 1.5)
    bright, faint = measure_hfd(_painted(image)), measure_hfd(_painted(image, flux=400.0))
    assert len(bright) == 48
    assert len(faint) == 0
    assert np.all(np.diff(bright.flux) <= 0)
    assert len(measure_hfd(_painted(image, flux=400.0), least_snr=5.0)) > 40


def test_enough_stars_are_the_highest_and_all_where_there_are_few() -> None:
    image = _disc(0, 0, 1.5)
    frame = _painted(image)
    pixels = np.array(frame.pixels)
    for at in range(6):
        pixels[20 + 60 * at : 61 + 60 * at, 15:56] += 900_000.0 * image
    frame = Frame(pixels=pixels)
    everything = measure_hfd(frame)
    few, many = measure_hfd(frame, enough=5), measure_hfd(frame, enough=500)
    assert len(everything) == len(many) == 48
    assert len(few) == 6
    np.testing.assert_array_equal(few.flux, everything.flux[:6])
    np.testing.assert_array_equal(np.sort(many.hfd_px), np.sort(everything.hfd_px))


@pytest.mark.long
@pytest.mark.skipif(shutil.which("astap_cli") is None, reason="astap_cli is not installed")
@pytest.mark.parametrize(
    ("fwhm_px", "center"),
    [
        (1.8, Icrs(99.0, 33.0)),
        (2.5, Icrs(200.0, -40.0)),
        (3.0, Icrs(300.0, 30.0)),
        (4.0, Icrs(99.0, 33.0)),
        (6.0, Icrs(200.0, -40.0)),
    ],
)
def test_astap_measures_the_same_stars(tmp_path: Path, fwhm_px: float, center: Icrs) -> None:
    optics = SimulatedOptics(
        width_px=1200, height_px=900, scale_arcsec_px=8.0, rotation_deg=20.0, fwhm_px=fwhm_px,
        faint_stars_deg2=100.0,
    )  # fmt: skip
    frame = draw_frame(center, optics, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=TAKEN, seed=4)
    path = tmp_path / "frame.fits"
    fits.PrimaryHDU(frame.pixels).writeto(path)
    subprocess.run(["astap_cli", "-f", str(path), "-extract", "30"], check=True, capture_output=True)
    theirs = np.loadtxt(tmp_path / "frame.csv", delimiter=",", skiprows=1, usecols=range(5))
    ours = measure_hfd(frame)
    apart, which = nearest(np.column_stack((ours.x_px, ours.y_px)), theirs[:, :2] - 1.0)
    same = apart < 1.5
    assert same.mean() > 0.8
    assert np.median(apart[same]) < 0.1
    assert np.median(ours.flux[which[same]] / theirs[same, 4]) == pytest.approx(1.0, abs=0.02)
    assert np.median(ours.snr[which[same]] / theirs[same, 3]) == pytest.approx(1.0, abs=0.03)
    # the original interpolates between pixels and sums over a square: 0.10 to 0.16 px more
    assert -0.2 < np.median(ours.hfd_px[which[same]] - theirs[same, 2]) < -0.05
    assert 0.85 < len(ours) / len(theirs) < 1.25
