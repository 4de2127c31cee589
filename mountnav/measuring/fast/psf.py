"""The elliptical PSF that a frame's stars share: sampled at sub-pixel shifts, learned from bright stars."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.cutouts import Cutouts
from mountnav.measuring.fast.moments import nearest_px
from mountnav.measuring.fast.scene import Scene
from mountnav.measuring.least_squares import Fit
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.medians import median
from mountnav.measuring.psf import FWHM_PER_SIGMA, MOST_WING, NODE_WEIGHTS, NODES, PIXEL_FWHM2, Psf
from mountnav.measuring.psf_fitting import with_noise_law
from mountnav.measuring.psf_photometry import LONELY_FWHM

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

_PHASES = 8
"""Positions within a pixel, in each direction, for which the PSF is drawn: none is farther than 1/16 px from
one, and the slopes lead on."""


@dataclass(frozen=True, slots=True)
class EllipticalPsf:
    """A PSF and its p, q, r; see `psf_fitting.fit_profiles`.

    Attributes
    ----------
    p, q, r : float
        Of Q = p u² + 2 q u v + r v².
    """

    psf: Psf
    p: float
    q: float
    r: float

    @property
    def area_px2(self) -> float:
        """Flux of a star of unit amplitude."""
        return float(self.psf.volume / np.sqrt(self.p * self.r - self.q**2))

    def seen(self) -> tuple[float, float, float]:
        """Return p, q, r as wide as the star looks, the pixels' own width included."""
        if not self.psf.integrated:
            return self.p, self.q, self.r
        wide = np.linalg.inv(np.array([[self.p, self.q], [self.q, self.r]])) + np.eye(2) / 12.0
        inverse = np.linalg.inv(wide)
        return float(inverse[0, 0]), float(inverse[0, 1]), float(inverse[1, 1])


def drawn(shape: EllipticalPsf, u: Pixels, v: Pixels) -> Pixels:
    """A star of unit amplitude at offsets from its position, and its slopes as the position moves.

    Parameters
    ----------
    u, v : ndarray of float32, shape (n, pixels)
        Offsets of pixels' middles.

    Returns
    -------
    ndarray of float32, shape (n, 3, pixels)
        Value, slope by x, slope by y; integrated over the pixels if the shape's PSF is.
    """
    out = np.zeros((u.shape[0], 3, u.shape[1]), dtype=np.float32)
    for a, b, weight in _points(shape, u, v):
        value, slope, along_x, along_y = _profile(shape, a, b, weight)
        out[:, 0] += value
        out[:, 1] += slope * along_x
        out[:, 2] += slope * along_y
    return out


def drawn_with_shape(shape: EllipticalPsf, u: Pixels, v: Pixels, wing_step: float) -> Pixels:
    """The same with the slopes by p, q, r and wing behind, shape (n, 7, pixels)."""
    out = np.zeros((u.shape[0], 7, u.shape[1]), dtype=np.float32)
    fatter = replace(shape.psf, wing=shape.psf.wing + wing_step)
    for a, b, weight in _points(shape, u, v):
        value, slope, along_x, along_y = _profile(shape, a, b, weight)
        wide = fatter.of(along_x * a + along_y * b)[0] * weight
        out[:, 0] += value
        out[:, 1] += slope * along_x
        out[:, 2] += slope * along_y
        slope *= np.float32(-0.5)
        by_a = slope * a
        out[:, 3] += by_a * a
        out[:, 4] += np.float32(2.0) * by_a * b
        out[:, 5] += slope * b * b
        out[:, 6] += (wide - value) * np.float32(1.0 / wing_step)
    return out


def _points(shape: EllipticalPsf, u: Pixels, v: Pixels) -> Iterator[tuple[Pixels, Pixels, np.float32]]:
    """Where in the pixels the PSF is looked at, and with what weights."""
    if not shape.psf.integrated:
        yield u, v, np.float32(1.0)
        return
    for dy, weight_y in zip(NODES, NODE_WEIGHTS, strict=True):
        for dx, weight_x in zip(NODES, NODE_WEIGHTS, strict=True):
            yield u + dx, v + dy, weight_x * weight_y


def _profile(
    shape: EllipticalPsf, u: Pixels, v: Pixels, weight: np.float32
) -> tuple[Pixels, Pixels, Pixels, Pixels]:
    p, q, r = np.float32(shape.p), np.float32(shape.q), np.float32(shape.r)
    along_x, along_y = p * u + q * v, q * u + r * v
    value, slope = (part.astype(np.float32, copy=False) for part in shape.psf.of(along_x * u + along_y * v))
    return np.float32(weight) * value, np.float32(weight) * slope, along_x, along_y


@dataclass(frozen=True, slots=True)
class SampledPsf:
    """Drawings of a star on a disc of pixels, for positions on a grid within the middle pixel.

    Attributes
    ----------
    dx, dy : ndarray of int, shape (pixels,)
        The disc.
    drawings : ndarray of float32, shape (phases², 3, pixels)
        Value and slopes of a star of unit amplitude.
    """

    shape: EllipticalPsf
    dx: NDArray[np.intp]
    dy: NDArray[np.intp]
    drawings: Pixels

    @classmethod
    def of(cls, shape: EllipticalPsf, half_px: int) -> SampledPsf:
        """Draw a star on discs of a radius."""
        steps = np.arange(-half_px, half_px + 1)
        dy, dx = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
        disc = np.hypot(dx, dy) <= half_px + 0.5
        dx, dy = dx[disc], dy[disc]
        phase = ((np.arange(_PHASES) + 0.5) / _PHASES - 0.5).astype(np.float32)
        u = dx.astype(np.float32) - phase[:, None]
        v = dy.astype(np.float32) - phase[:, None]
        return cls(shape, dx, dy, drawn(shape, np.tile(u, (_PHASES, 1)), np.repeat(v, _PHASES, axis=0)))

    def near(self, x: Array, y: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """The drawing nearest to positions in the middle pixel, each (n,) in [-0.5, 0.5], and where it is."""
        column, row = (np.clip(np.floor((w + 0.5) * _PHASES), 0, _PHASES - 1).astype(np.intp) for w in (x, y))
        return row * _PHASES + column, (column + 0.5) / _PHASES - 0.5, (row + 0.5) / _PHASES - 0.5


Mask = NDArray[np.bool_]

_STARS = 36
"""Stars at most that the PSF is fitted to: bounds the time."""
_FEWEST = 5
"""And at least, or a round Gaussian of the typical width is taken."""
_CLEAR_SNR = 25.0
"""Their least flux over its error."""
_WIDTH_RATIO = 1.3
"""They are no wider or narrower than the typical star by more than this factor; nor is the outcome."""
_INTEGRATE_BELOW_PX = 2.8
"""Apparent FWHM below which the PSF is integrated over the pixels, px: higher than for the full measurement's
free widths, since the drawings cost nothing per star."""
_ROUNDS = 5
"""Gauss-Newton steps of the fit."""
_JUDGED_AFTER = 2
"""Blends leave after this step (counted from 0)."""
_BLEND_CHI2_RATIO = 3.0
"""A star whose χ² is more than this many times the median says nothing of the common shape."""
_FIRST_MISFIT = 0.03
"""Misfit assumed before it is learned, as a share of the light in the pixel: that of usual optics, so that
the brightest star doesn't rule."""
_WING_STEP = 0.02
"""Step of the wings by which their slope is taken."""
_FIRST_WING = 0.1
"""Wings to start from: at 0 the slope by them vanishes."""
_SPOILT = int(Flag.SATURATED | Flag.EDGE | Flag.ELONGATED | Flag.NO_PEAK | Flag.BLENDED | Flag.TRAIL)


def learn_shared_psf(scene: Scene, measurements: Measurements, half_px: int) -> tuple[EllipticalPsf, int]:
    """Fit the common star.

    Parameters
    ----------
    measurements : Measurements
        The fast measurement's own.
    half_px : int
        Radius of the discs.

    Returns
    -------
    EllipticalPsf
        A round Gaussian as wide as the typical star if there are too few stars.
    int
        Of how many stars.
    """
    inverse = (FWHM_PER_SIGMA / scene.fwhm_px) ** 2
    psf = Psf(0.0, scene.gain[0], _FIRST_MISFIT, scene.fwhm_px < _INTEGRATE_BELOW_PX)
    if psf.integrated:
        inverse = 1.0 / max(1.0 / inverse - 1.0 / 12.0, 0.05)
    first = EllipticalPsf(psf, inverse, 0.0, inverse)
    m = measurements
    snr = m.flux / np.maximum(m.flux_sigma, 1e-12)
    alone = nearest_px(m.x_px, m.y_px) > LONELY_FWHM * scene.fwhm_px
    inside = (m.x_px > half_px) & (m.y_px > half_px)
    inside &= (m.x_px < m.width_px - 1 - half_px) & (m.y_px < m.height_px - 1 - half_px)
    # the brightest of stretched pictures are swollen: they are not what the others look like
    wide = np.hypot(m.fwhm_px, np.sqrt(PIXEL_FWHM2)) / scene.fwhm_px
    alike = (wide > 1.0 / _WIDTH_RATIO) & (wide < _WIDTH_RATIO)
    fine = (m.flags & _SPOILT == 0) & inside & alike & (snr > _CLEAR_SNR)
    if np.count_nonzero(fine & alone) >= _FEWEST:
        fine &= alone
    some = np.flatnonzero(fine)[:_STARS]
    if some.size < _FEWEST:
        return first, 0
    x, y = m.x_px[some], m.y_px[some]
    cut = scene.cut(x, y, half_px)
    steps = np.arange(-half_px, half_px + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    disc = np.hypot(dx, dy) <= half_px + 0.5
    values = cut.values.reshape(some.size, -1)[:, disc]
    cutouts = Cutouts(
        (values - cut.ground()[:, None]).astype(np.float64),
        np.broadcast_to((scene.noise_at(x, y) ** 2)[:, None], values.shape),
        values < scene.full_adu,
        dx[disc].astype(np.float64),
        dy[disc].astype(np.float64),
        np.rint(x),
        np.rint(y),
    )
    shape, stars = _fitted(first, cutouts, x - np.rint(x), y - np.rint(y), scene.gain)
    p, q, r = shape.seen()
    seen = shape.psf.fwhm_per_width * float(np.maximum(p * r - q * q, 1e-12) ** -0.25)
    return (shape, stars) if 1.0 / _WIDTH_RATIO < seen / scene.fwhm_px < _WIDTH_RATIO else (first, 0)


def _fitted(
    shape: EllipticalPsf, cutouts: Cutouts, x: Array, y: Array, gain: tuple[float, bool]
) -> tuple[EllipticalPsf, int]:
    """Gauss-Newton for all stars' own four parameters and the four that they share."""
    first = shape
    shape = replace(shape, psf=replace(shape.psf, wing=_FIRST_WING, misfit=_FIRST_MISFIT))
    own = np.zeros((x.size, 4))
    own[:, 0] = np.maximum(cutouts.values.max(axis=1), 1e-9)
    own[:, 1], own[:, 2] = x, y
    use = np.ones(x.size, dtype=bool)
    for turn in range(_ROUNDS):
        slopes, shared, light = _slopes(shape, cutouts, own)
        weights = np.asarray(
            cutouts.good * use[:, None] / shape.psf.variance(cutouts.variance, light), dtype=np.float32
        )
        residual = np.asarray(cutouts.values - light - own[:, 3, None], dtype=np.float32)
        if turn == _JUDGED_AFTER:  # a blend says nothing of the common shape
            chi2 = (weights * residual**2).sum(axis=1)
            use &= chi2 <= _BLEND_CHI2_RATIO * median(chi2[use])
            weights *= use[:, None]
        step_own, step_shared = _step(slopes, shared, weights, residual)
        own[:, 0] = np.clip(own[:, 0] + step_own[:, 0], 0.3 * own[:, 0], 3.0 * own[:, 0])
        own[:, 1:3] += np.clip(step_own[:, 1:3], -0.5, 0.5)
        own[:, 3] += step_own[:, 3]
        shape = _moved(shape, step_shared)
    if use.sum() < _FEWEST or not np.isfinite([shape.p, shape.q, shape.r, shape.psf.wing]).all():
        return first, 0
    return _with_noise_law(shape, cutouts, own, use, gain), int(use.sum())


def _slopes(shape: EllipticalPsf, cutouts: Cutouts, own: Array) -> tuple[Pixels, Pixels, Pixels]:
    """Slopes by amplitude, x, y, sky and by p, q, r, wing, each (n, 4, pixels); and the stars' light."""
    u = (cutouts.dx - own[:, 1, None]).astype(np.float32)
    v = (cutouts.dy - own[:, 2, None]).astype(np.float32)
    a = own[:, 0, None].astype(np.float32)
    all_slopes = drawn_with_shape(shape, u, v, _WING_STEP)
    light = a * all_slopes[:, 0]
    all_slopes[:, 1:] *= a[:, None]
    own_slopes = np.empty_like(all_slopes[:, :4])
    own_slopes[:, :3], own_slopes[:, 3] = all_slopes[:, :3], 1.0
    return own_slopes, all_slopes[:, 3:], light


def _step(slopes: Pixels, shared: Pixels, weights: Pixels, residual: Pixels) -> tuple[Array, Array]:
    """Solve for the stars' own steps and the shared one; the own ones are eliminated star by star."""
    everything = np.concatenate([slopes, shared, residual[:, None]], axis=1)
    normal = ((everything[:, :8] * weights[:, None]) @ everything.transpose(0, 2, 1)).astype(np.float64)
    # each star's columns have their own scale
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", normal[:, :4, :4]), 1e-30))
    own = normal[:, :4, :4] * scale[:, :, None] * scale[:, None, :] + 1e-9 * np.eye(4)
    rest = normal[:, :4, 4:] * scale[:, :, None]
    eliminated = np.linalg.solve(own, rest) * scale[:, :, None]
    inner = normal[:, 4:8, :4] @ eliminated
    left = normal[:, 4:8, 4:8].sum(axis=0) - inner[:, :, :4].sum(axis=0)
    size = np.sqrt(np.maximum(np.diag(left), 1e-30))
    left = left / size[:, None] / size + 1e-9 * np.eye(4)
    step = np.linalg.solve(left, (normal[:, 4:8, 8].sum(axis=0) - inner[:, :, 4].sum(axis=0)) / size) / size
    return eliminated[:, :, 4] - eliminated[:, :, :4] @ step, step


def _moved(shape: EllipticalPsf, step: Array) -> EllipticalPsf:
    p = float(np.clip(shape.p + step[0], 0.5 * shape.p, 2.0 * shape.p))
    r = float(np.clip(shape.r + step[2], 0.5 * shape.r, 2.0 * shape.r))
    room = 0.9 * np.sqrt(p * r)
    wing = float(np.clip(shape.psf.wing + np.clip(step[3], -0.15, 0.15), 0.0, MOST_WING))
    return EllipticalPsf(replace(shape.psf, wing=wing), p, float(np.clip(shape.q + step[1], -room, room)), r)


def _with_noise_law(
    shape: EllipticalPsf, cutouts: Cutouts, own: Array, use: Mask, gain: tuple[float, bool]
) -> EllipticalPsf:
    """Learn how the pixels' noise grows with light from what the fits left over."""
    slopes, _, light = _slopes(shape, cutouts, own)
    residual = cutouts.values - light - own[:, 3, None]
    psf = replace(shape.psf, gain_e_adu=gain[0], misfit=0.0)
    kept = cutouts.part(use)
    weights = kept.good / psf.variance(kept.variance, light[use])
    normal = (slopes[use] * weights[:, None]) @ slopes[use].transpose(0, 2, 1)
    fit = Fit(own[use], normal.astype(np.float64), residual[use], slopes[use], weights)
    return replace(shape, psf=with_noise_law(psf, fit, kept, gain[0], card=gain[1]))
