"""What a frame tells about the night, against painted skies: width, elongation, depth, zero point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mountnav.frames import Frame
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Measurements, SkyQuality, StarImages, with_plate
from tests.measuring.nearest import nearest
from tests.measuring.painted import Array, as_frame, painted, scattered, spots


def of(frame: Frame) -> SkyQuality:
    quality = measure(frame).quality
    assert quality is not None
    return quality


@pytest.mark.long
@pytest.mark.parametrize(
    ("fwhm_px", "beta", "kind"),
    [
        (1.2, 0.0, StarImages.UNDERSAMPLED),
        (1.7, 3.0, StarImages.UNDERSAMPLED),
        (2.6, 0.0, StarImages.WELL_SAMPLED),
        (4.0, 3.5, StarImages.WELL_SAMPLED),
        (12.0, 0.0, StarImages.DEFOCUSED),
    ],
)
def test_width_and_kind(fwhm_px: float, beta: float, kind: StarImages) -> None:
    size = (600, 600)
    x, y = scattered(49, size, seed=51)
    quality = of(as_frame(painted(x, y, np.full(49, 8e4), fwhm_px=fwhm_px, beta=beta, size=size, seed=52)))
    assert quality.images is kind
    assert quality.fwhm_px == pytest.approx(fwhm_px, rel=0.03)
    assert quality.ellipticity is not None
    assert quality.ellipticity < 0.05
    assert abs(quality.stars - 49) <= 3
    assert quality.sky_adu == pytest.approx(600.0, abs=2.0)
    assert quality.noise_adu == pytest.approx(np.sqrt(125.0), rel=0.05)
    assert quality.saturated_share == 0.0


def test_elongation_and_its_direction() -> None:
    size = (500, 500)
    x, y = scattered(49, size, seed=53)
    smear = spots(trail_px=4.0, trail_deg=-40.0)
    quality = of(as_frame(painted(x, y, np.full(49, 8e4), fwhm_px=2.5, points=smear, size=size)))
    # second moments: σ² + L² / 12 along, σ² across
    sigma2 = (2.5 / 2.3548) ** 2
    expected = 1.0 - np.sqrt(sigma2 / (sigma2 + 16.0 / 12.0))
    assert quality.images is StarImages.WELL_SAMPLED
    assert quality.ellipticity == pytest.approx(expected, abs=0.05)
    assert quality.elongation_deg == pytest.approx(-40.0, abs=2.0)


@pytest.mark.parametrize(
    ("fwhm_px", "beta", "side"),
    [
        (1.5, 0.0, 900),
        (3.0, 0.0, 900),
        pytest.param(3.0, 3.0, 900, marks=pytest.mark.long),
        pytest.param(3.0, 0.0, 1800, marks=pytest.mark.long),
    ],
)
def test_half_the_stars_at_the_limiting_flux_are_found(fwhm_px: float, beta: float, side: int) -> None:
    bright, faint, size = 40, 260, (side, side)
    x, y = scattered(bright + faint, size, seed=54)
    mixed = np.random.default_rng(55).permutation(bright + faint)
    x, y = x[mixed], y[mixed]
    shown: dict[str, Any] = {"fwhm_px": fwhm_px, "beta": beta, "size": size}
    limit = of(
        as_frame(painted(x[:bright], y[:bright], np.full(bright, 2e4), seed=56, **shown))
    ).limiting_flux_adu
    assert limit is not None

    def share(flux: float) -> float:
        electrons = np.r_[np.full(bright, 2e4), np.full(faint, flux)]
        found = measure(as_frame(painted(x, y, electrons, seed=57, **shown)))
        distance, _ = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y][bright:])
        return float((distance < max(1.5, 0.6 * fwhm_px)).mean())

    shares = {part: share(part * limit) for part in (0.8, 1.0, 1.25)}
    print(f"\nFWHM {fwhm_px}, beta {beta}, {side} px: limit {limit:.0f}, found {shares}")
    assert shares[0.8] < 0.5
    assert 0.3 < shares[1.0] < 0.7
    assert shares[1.25] > 0.55


def test_saturation_and_gradient() -> None:
    size = (400, 400)
    x, y = scattered(25, size, seed=58)
    electrons = np.full(25, 5e4)
    electrons[:3] = 3e6
    ramp = 100.0 + 0.2 * np.arange(400.0)[None, :] * np.ones((400, 1))
    image = painted(x, y, electrons, fwhm_px=3.0, size=size, sky=ramp)
    frame = as_frame(image, top=40_000.0)
    quality = of(frame)
    assert quality.saturated_share == pytest.approx((frame.pixels == 40_000).mean(), rel=0.3)
    noise = np.sqrt(140.0 + 25.0)
    assert quality.sky_gradient == pytest.approx(0.2 * 400.0 / noise, rel=0.15)


def test_an_empty_sky_shows_no_stars() -> None:
    none: Array = np.zeros(0)
    quality = of(as_frame(painted(none, none, none, fwhm_px=3.0)))
    assert quality.images is StarImages.NONE
    assert quality.fwhm_px is None
    assert quality.limiting_flux_adu is None


def solved(found: Measurements, mag: Array, flux: Array, bias: float | None) -> SkyQuality:
    assert found.quality is not None
    return with_plate(found.quality, scale_arcsec_px=2.0, mag=mag, flux=flux, bias_adu=bias)


def test_a_plate_gives_magnitudes() -> None:
    size = (500, 500)
    x, y = scattered(64, size, seed=59)
    electrons = np.geomspace(5e3, 3e5, 64)
    true_mag = 21.3 - 2.5 * np.log10(electrons)
    found = measure(as_frame(painted(x, y, electrons, fwhm_px=3.0, size=size, seed=60)))
    _, index = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    flux, mag = found.flux[index].copy(), true_mag + np.random.default_rng(61).normal(0.0, 0.1, 64)
    mag[:6] -= 3.0  # wrong pairs and variables
    flux[7], mag[8] = -1.0, np.nan
    quality = solved(found, mag, flux, 500.0)
    assert quality.zero_point_mag == pytest.approx(21.3, abs=0.06)
    assert quality.fwhm_arcsec == pytest.approx(6.0, rel=0.03)
    assert quality.sky_mag_arcsec2 == pytest.approx(21.3 - 2.5 * np.log10(100.0 / 4.0), abs=0.1)
    assert quality.limiting_mag is not None
    assert quality.limiting_flux_adu is not None
    assert quality.limiting_mag == pytest.approx(21.3 - 2.5 * np.log10(quality.limiting_flux_adu), abs=0.06)


def test_without_bias_or_pairs_nothing_is_made_up() -> None:
    x, y = scattered(36, (300, 300), seed=62)
    found = measure(as_frame(painted(x, y, np.full(36, 4e4), fwhm_px=3.0)))
    mag = np.full(36, 9.0)
    unknown = solved(found, mag, np.full(36, 4e4), None)
    assert unknown.zero_point_mag is not None
    assert unknown.sky_mag_arcsec2 is None
    assert solved(found, mag, np.full(36, 4e4), 1e6).sky_mag_arcsec2 is None
    alone = solved(found, mag[:2], np.full(2, 4e4), 500.0)
    assert alone.zero_point_mag is None
    assert alone.limiting_mag is None
    assert alone.fwhm_arcsec == pytest.approx(6.0, rel=0.03)
