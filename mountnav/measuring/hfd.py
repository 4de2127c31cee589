"""Half flux diameters of a frame's stars: what focusing programs go by.

The half flux diameter of a star is that of the circle about its centroid which holds half of its light. As
focusing programs measure it [Half flux diameter, Wikipedia; K. Miyashita's estimator], it is twice the mean
distance of the light from the centroid, 2 Σ f r / Σ f. For a Gaussian of width σ that is 2.507 σ, while half
of its light lies within a diameter of 2.355 σ. It needs no model of a star and holds far out of focus too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from mountnav.frames import Frame
from mountnav.measuring.background import estimate_background

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

__all__ = ["StarDiameters", "measure_hfd"]

DEFAULT_SNR = 30.0
"""Least signal-to-noise ratio of a star whose diameter is stated; below some 10 the noise decides it, so that
focusing programs take 30. Doubled, frames of few stars have none left."""
_REACH_PX = 14
"""Radius within which a star's light is looked for, px, as focusing programs have it: diameters up to some 20
px. Doubled, four times the time, and neighbors get in."""
_LIT_SIGMA = 3.0
"""A pixel so many sigmas above the sky is lit. Doubled, faint stars look small; halved, noise is light."""
_DARK_SHARE = 0.1
"""A ring with no larger share of lit pixels ends the star. Doubled, wings are cut off; halved, noise extends
faint stars."""
_PEAK_SIGMA = 5.0
"""Height of a peak over the sky, in units of the noise of the smoothed frame, from which it is looked at: far
below what a signal-to-noise ratio of 7 needs. Doubled, faint wide stars are missed; halved, only time."""
_SMOOTH_PX = 3
"""Side of the square that peaks are looked for with, px. Without it single hot pixels are peaks; doubled,
close pairs become one."""
_LEAST_LIT = 3
"""Lit pixels of a star at least; fewer are a hot pixel or a cosmic ray."""
_LEAST_HFD_PX = 0.8
"""Smaller ones are no stars, px [ASTAP]: a single pixel spread over two has 1."""
_APART_HFD = 1.5
"""Of two stars nearer than so many diameters of the brighter, the fainter is its noise, or can't be measured
beside it."""
_PIXELS_OF_STARS = (6, 24)
"""Pixels a wanted star that lie above the first levels [ASTAP]: stars of 2.25 and 4.5 px diameter. Doubled,
more stars than wanted are measured."""
_PLAIN_SIGMA = 30.0
"""Levels of a plain multiple of the noise begin here [ASTAP]. Doubled, one level less is tried."""
_LOWEST_SIGMA = 7.0
"""And end here at the latest [ASTAP]. Doubled, faint stars that were asked for are left out."""
_ROUNDS = 2
"""How often the centroid is followed. A third changes diameters by less than 0.1 %."""
_AT_ONCE = 2000
"""Stars that are measured together: bounds the memory to some 50 MB."""
_MOST_PEAKS = 20_000
"""Of more peaks the highest are looked at: a frame of such is no longer one of single stars."""
_MAD_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""


@dataclass(frozen=True, slots=True)
class StarDiameters:
    """Stars and their diameters, brightest first; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Centroids, 0-based, as in `Frame.pixels`.
    hfd_px : ndarray
        Half flux diameters.
    flux : ndarray
        ADU above the sky.
    snr : ndarray
        Flux over its noise: that of the sky, and of the light itself at one electron per ADU.
    """

    x_px: Array
    y_px: Array
    hfd_px: Array
    flux: Array
    snr: Array

    def __len__(self) -> int:
        return int(self.x_px.size)

    @property
    def median_px(self) -> float | None:
        """Median half flux diameter; None without stars."""
        return float(np.median(self.hfd_px)) if self.hfd_px.size else None

    def taken(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> StarDiameters:
        """Some of them."""
        return StarDiameters(
            self.x_px[which], self.y_px[which], self.hfd_px[which], self.flux[which], self.snr[which]
        )


def measure_hfd(frame: Frame, *, least_snr: float = DEFAULT_SNR, enough: int | None = None) -> StarDiameters:
    """Measure the half flux diameters of all stars that are bright enough.

    Parameters
    ----------
    frame : Frame
        Without a mosaic.
    least_snr : float
        Stars below this signal-to-noise ratio are left out.
    enough : int, optional
        Look at the highest peaks first, and at lower ones only until there are so many stars, as focusing
        programs do; the count then tells little of crowded frames. All of them if left out.

    Returns
    -------
    StarDiameters
        Stars whose light reaches farther than the measurement, or the frame's rim, are left out.
    """
    image = np.asarray(frame.pixels, dtype=np.float32)
    missing = ~np.isfinite(image)
    side = 2 * _REACH_PX + 5
    if min(image.shape) < side or missing.all():
        return _none()
    step = 1.0 if frame.pixels.dtype.kind in "iu" else 0.0
    background = estimate_background(image, step_adu=step)
    sky_free = image - background.level_image()
    sky_free[missing] = 0.0
    noise_image = background.noise_image(*image.shape)
    x, y, height = _peaks(sky_free, noise_image)
    if not x.size:
        return _none()
    noise = background.noise_at(x, y)
    levels = [0.0] if enough is None else _levels(sky_free, float(np.median(noise_image)), least_snr, enough)
    found, seen = _none(), np.zeros(x.size, dtype=bool)
    for level in levels:
        new = np.flatnonzero((height > level) & ~seen)
        seen[new] = True
        for at in range(0, new.size, _AT_ONCE):
            some = new[at : at + _AT_ONCE]
            part = _measured(sky_free, x[some], y[some], noise[some])
            found = _joined(found, part.taken(part.snr > least_snr))
        found = found.taken(np.argsort(-found.flux, kind="stable"))
        found = found.taken(_first_of_each(found))
        if enough is not None and len(found) >= enough:
            break
    return found


def _levels(sky_free: Pixels, noise: float, least_snr: float, enough: int) -> list[float]:
    """Heights from which peaks are looked at in turn, falling [ASTAP]: by bright pixels, then by noise."""
    wanted = [min(share * enough, sky_free.size - 1) for share in _PIXELS_OF_STARS]
    places = [sky_free.size - 1 - count for count in wanted]
    lit = np.partition(sky_free, places, axis=None)[places]
    levels = [float(level) for level in lit if level > _PLAIN_SIGMA * noise]
    if least_snr < _PLAIN_SIGMA:
        levels.append(_PLAIN_SIGMA * noise)
    return [*levels, max(least_snr, _LOWEST_SIGMA) * noise]


def _joined(one: StarDiameters, other: StarDiameters) -> StarDiameters:
    names = StarDiameters.__dataclass_fields__
    return StarDiameters(*(np.concatenate([getattr(one, name), getattr(other, name)]) for name in names))


def _none() -> StarDiameters:
    nothing = np.zeros(0)
    return StarDiameters(nothing, nothing, nothing, nothing, nothing)


def _peaks(sky_free: Pixels, noise: Pixels) -> tuple[Array, Array, Pixels]:
    """Maxima of the lightly smoothed frame that stand out, away from the rim, and their highest pixels."""
    smooth = ndimage.uniform_filter(sky_free, _SMOOTH_PX)
    peak = smooth > (_PEAK_SIGMA / _SMOOTH_PX) * noise
    peak &= smooth == ndimage.maximum_filter(smooth, 2 * _SMOOTH_PX - 1)
    margin = _REACH_PX + 2
    inside = np.zeros_like(peak)
    inside[margin:-margin, margin:-margin] = True
    row, column = np.nonzero(peak & inside)
    if row.size > _MOST_PEAKS:
        highest = np.argpartition(-smooth[row, column], _MOST_PEAKS)[:_MOST_PEAKS]
        row, column = row[highest], column[highest]
    near = np.arange(-(_SMOOTH_PX // 2), _SMOOTH_PX // 2 + 1)
    height = sky_free[row[:, None, None] + near[:, None], column[:, None, None] + near].max(axis=(1, 2))
    return column.astype(np.float64), row.astype(np.float64), height


def _measured(sky_free: Pixels, x: Array, y: Array, noise: Array) -> StarDiameters:
    """Diameters of the stars at peaks; those that can't be measured have an SNR of 0."""
    half = _REACH_PX + 1
    offset = np.arange(-half, half + 1)
    column, row = x.astype(np.intp), y.astype(np.intp)
    light = sky_free[row[:, None, None] + offset[:, None], column[:, None, None] + offset].astype(np.float64)
    rim = np.hypot(offset[:, None], offset)
    rim = (rim > _REACH_PX) & (rim <= half)
    around = light[:, rim]
    ground = np.median(around, axis=1)
    sigma = _MAD_SIGMA * np.median(np.abs(around - ground[:, None]), axis=1)
    sigma = np.maximum(sigma, 0.5 * noise)  # a rim of equal pixels has no scatter of its own
    light -= ground[:, None, None]
    lit = light > (_LIT_SIGMA * sigma)[:, None, None]
    dx, dy = np.zeros(x.size), np.zeros(x.size)
    for _ in range(_ROUNDS + 1):
        distance = np.hypot(offset - dx[:, None, None], offset[:, None] - dy[:, None, None])
        edge = _edges(distance, lit)
        inside = distance <= edge[:, None, None]
        weight = np.where(inside & lit, light, 0.0)
        total = np.maximum(weight.sum(axis=(1, 2)), 1e-12)
        last = dx.copy(), dy.copy()
        dx = (weight * offset).sum(axis=(1, 2)) / total
        dy = (weight * offset[:, None]).sum(axis=(1, 2)) / total
    dx, dy = last  # the distances above are those from here
    inner = np.where(inside, light, 0.0)
    flux = inner.sum(axis=(1, 2))
    sound = (flux > 0.0) & (edge < _REACH_PX) & ((inside & lit).sum(axis=(1, 2)) >= _LEAST_LIT)
    sound &= np.hypot(dx, dy) < half
    safe = np.where(sound, flux, 1.0)
    hfd = 2.0 * (inner * distance).sum(axis=(1, 2)) / safe
    sound &= (hfd > _LEAST_HFD_PX) & (hfd < 2.0 * _REACH_PX)
    snr = np.where(sound, safe / np.sqrt(safe + np.pi * (edge * sigma) ** 2), 0.0)
    return StarDiameters(x + dx, y + dy, hfd, flux, snr)


def _edges(distance: Array, lit: NDArray[np.bool_]) -> Array:
    """Radius of each star: the first ring that is dark, after one that is lit."""
    ring = np.rint(distance).astype(np.intp)
    most = _REACH_PX + 1
    stars = np.arange(distance.shape[0])[:, None, None] * (most + 1)
    index = (stars + np.minimum(ring, most)).ravel()
    size = distance.shape[0] * (most + 1)
    pixels = np.bincount(index, minlength=size).reshape(-1, most + 1)
    bright = np.bincount(index, weights=lit.ravel(), minlength=size).reshape(-1, most + 1)
    share = bright / np.maximum(pixels, 1)
    begun = np.maximum.accumulate(share > _DARK_SHARE, axis=1)
    dark = begun & (share <= _DARK_SHARE)
    dark[:, most] = True
    return np.asarray(dark.argmax(axis=1), dtype=np.float64)


def _first_of_each(stars: StarDiameters) -> NDArray[np.bool_]:
    """Which stars are no part of a brighter one; they come brightest first."""
    kept = np.ones(len(stars), dtype=bool)
    if not kept.size:
        return kept
    tree = KDTree(np.column_stack((stars.x_px, stars.y_px)))
    for at, near in enumerate(tree.query_ball_point(tree.data, _APART_HFD * stars.hfd_px)):
        if kept[at]:
            kept[[other for other in near if other > at]] = False
    return kept
