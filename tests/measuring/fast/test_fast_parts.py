"""The parts of the fast measurement by their mathematics: bins, moments, the drawn star."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.measuring.fast.coarse import coarse_plane
from mountnav.measuring.fast.moments import cut_patches, windowed_moments
from mountnav.measuring.fast.psf import EllipticalPsf, SampledPsf, drawn, drawn_with_shape
from mountnav.measuring.psf import FWHM_PER_SIGMA, Psf
from tests.measuring.painted import star


@given(
    st.integers(8, 90),
    st.integers(8, 90),
    st.sampled_from([1, 2, 4]),
    st.sampled_from(["uint8", "uint16", ">u2", "int16", "int32", "float32", ">f8"]),
    st.integers(0, 1000),
)
@settings(max_examples=80, deadline=None)
def test_bins_are_sums(height: int, width: int, bin_px: int, kind: str, seed: int) -> None:
    high = 255 if kind == "uint8" else 65535 if "u" in kind else 32767
    pixels = np.random.default_rng(seed).integers(0, high, (height, width), endpoint=True).astype(kind)
    rows, columns = height // bin_px, width // bin_px
    part = pixels[: rows * bin_px, : columns * bin_px].astype(np.float64)
    wanted = part.reshape(rows, bin_px, columns, bin_px).sum(axis=(1, 3))
    assert np.array_equal(coarse_plane(pixels, bin_px), wanted.astype(np.float32))


def test_a_missing_pixel_makes_its_bin_missing() -> None:
    pixels = np.ones((16, 16), dtype=np.float32)
    pixels[5, 9] = np.nan
    plane = coarse_plane(pixels, 4)
    assert np.isnan(plane[1, 2])
    assert np.isnan(plane).sum() == 1


@given(
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.floats(1.2, 2.5),
    st.floats(0.7, 1.0),
    st.floats(0.0, 180.0),
)
@settings(max_examples=60, deadline=None)
def test_moments_give_place_flux_and_shape_of_a_gaussian(
    x: float, y: float, sigma: float, ratio: float, turn: float
) -> None:
    major, minor, angle = sigma, ratio * sigma, np.radians(turn)
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    wide = turned @ np.diag([major**2, minor**2]) @ turned.T
    offset = np.arange(-14, 15.0)
    u, v = offset[None, :] - x, offset[:, None] - y
    inverse = np.linalg.inv(wide)
    quadratic = inverse[0, 0] * u * u + 2.0 * inverse[0, 1] * u * v + inverse[1, 1] * v * v
    light = 1000.0 / (2.0 * np.pi * major * minor) * np.exp(-0.5 * quadratic)
    found = windowed_moments(
        light[None].astype(np.float32), np.array([-14]), np.array([-14]), np.zeros(1), np.zeros(1), sigma
    )
    assert found.sound[0]
    assert abs(found.x_px[0] - x) < 0.03
    assert abs(found.y_px[0] - y) < 0.03
    np.testing.assert_allclose(
        [found.xx[0], found.xy[0], found.yy[0]], [wide[0, 0], wide[0, 1], wide[1, 1]], atol=0.05
    )
    np.testing.assert_allclose(found.flux[0], 1000.0, rtol=0.02)


@given(st.floats(-20.0, 120.0), st.floats(-20.0, 90.0), st.integers(1, 12))
@settings(max_examples=60, deadline=None)
def test_patches_are_whole_and_know_where_they_are(x: float, y: float, half: int) -> None:
    pixels = np.arange(80 * 100, dtype=np.float32).reshape(80, 100)
    patch = cut_patches(pixels, np.array([x]), np.array([y]), half)
    left, top, side = int(patch.left[0]), int(patch.top[0]), 2 * half + 1
    assert patch.values.shape == (1, side, side)
    assert np.array_equal(patch.values[0], pixels[top : top + side, left : left + side])
    if half <= x <= 99 - half and half <= y <= 79 - half:
        assert (left + half, top + half) == (round(x), round(y))


@given(st.floats(1.3, 3.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
@settings(max_examples=30, deadline=None)
def test_a_drawn_star_is_the_integral_over_the_pixels(fwhm_px: float, x: float, y: float) -> None:
    inverse = (FWHM_PER_SIGMA / fwhm_px) ** 2
    shape = EllipticalPsf(Psf(integrated=True), inverse, 0.0, inverse)
    offset = np.arange(-6, 7.0)
    v, u = (
        grid.reshape(1, -1).astype(np.float32) for grid in np.meshgrid(offset - y, offset - x, indexing="ij")
    )
    value = drawn(shape, u, v)[0, 0] / shape.area_px2
    truth = star(fwhm_px, 0.0, np.zeros((1, 2)), x, y, 6).ravel()
    assert np.abs(value - truth).max() < 0.01 * truth.max()


@given(
    st.booleans(),
    st.floats(0.05, 0.4),
    st.floats(0.3, 1.0),
    st.floats(0.3, 1.0),
    st.floats(-0.2, 0.2),
)
@settings(max_examples=30, deadline=None)
def test_slopes_are_those_of_differences(integrated: bool, wing: float, p: float, r: float, q: float) -> None:
    def value(p: float, q: float, r: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
        shape = EllipticalPsf(Psf(wing, integrated=integrated), p, q, r)
        at: np.ndarray = drawn(shape, u - np.float32(x), v - np.float32(y))[0, 0]
        return at

    offset = np.arange(-4, 5.0)
    v, u = (
        grid.reshape(1, -1).astype(np.float32)
        for grid in np.meshgrid(offset + 0.2, offset - 0.3, indexing="ij")
    )
    slopes = drawn_with_shape(EllipticalPsf(Psf(wing, integrated=integrated), p, q, r), u, v, 0.02)[0]
    step = 0.004
    for i, change in enumerate(
        (
            {"x": step},
            {"y": step},
            {"p": p + step},
            {"q": q + step},
            {"r": r + step},
        ),
        start=1,
    ):
        back = {
            name: 2.0 * {"p": p, "q": q, "r": r, "x": 0.0, "y": 0.0}[name] - to for name, to in change.items()
        }
        numeric = (
            value(**{"p": p, "q": q, "r": r, **change}) - value(**{"p": p, "q": q, "r": r, **back})
        ) / (2 * step)
        np.testing.assert_allclose(slopes[i], numeric, atol=3e-3)


def test_the_nearest_drawing_is_within_a_sixteenth_of_a_pixel() -> None:
    image = SampledPsf.of(EllipticalPsf(Psf(), 0.5, 0.0, 0.5), 4)
    x, y = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 500))
    which, at_x, at_y = image.near(x, y)
    assert np.abs(at_x - x).max() <= 1.0 / 16.0 + 1e-12
    dx: Any = image.dx - at_x[:, None].astype(np.float32)
    dy: Any = image.dy - at_y[:, None].astype(np.float32)
    direct = drawn(image.shape, dx, dy)
    np.testing.assert_allclose(image.drawings[which], direct, atol=1e-5)
