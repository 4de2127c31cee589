"""Where the stars' light fell in an exposure: the frame's mean image about its identified stars.

A point is what a plate believes in. If the mount drifted, was struck, or two exposures lie in one, each
star's light fell along the same path, and measuring may have cut that path in pieces: a plate then fits one
piece of every star as well as another. The mean of the frame about the stars' positions shows the whole path,
far below what a single star shows, and its center of light tells where the plate should have been.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image
from mountnav.measuring.fast.coarse import CoarseSky, Summed, coarse_plane, coarse_sky, in_wider_bins
from mountnav.measuring.medians import median

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH_PX = 420
"""How far from a star light of its own is looked for, pixels: longer paths run out of the window and are
reported as such. Twice as far costs four times the time."""
FAR_BIN_PX = 4
"""The search for light far from the stars is at bins of this: a trail stays visible, the cost falls by 16."""
_RIM_BINS = 10
"""So many bins beyond the farthest light are measured along, for their level."""
_FINE_BIN_PX = 2
"""What was found there is measured in these."""
_STARS = 48
"""Brightest stars that are used. Fewer show less of faint light; more are fainter each and cost time."""
_NEAR_STARS = 24
"""Of them in the near search: its light is bright."""
FEW_STARS = 12
"""Where fewer stars than this were identified, all that should be there are searched for light elsewhere."""
_FEWEST = 4
"""Fewer stars than this say nothing of a common path."""
_TAME_SIGMA = 3.0
"""Bins count no more than this in the first search, so that no bright neighbor looks like a path."""
_SEEN_SIGMA = 5.5
"""A bin of the mean image above this many of its own sigmas is light of the stars. Of 40,000 bins chance
brings one up to 4.0 to 5.2 (the shared frames); doubled, faint halves of a path would be overlooked."""
_RAYS = 180
"""Directions in which straight tails are looked for, 2° apart: at 100 px a tail is as wide as that."""
_RAY_SIGMAS = {6: 6.0, 12: 6.0, 25: 6.0}
"""A sum along so many bins of a ray that is above so many of the scatter of all directions' sums is a tail.
The shared frames reach 4.8; longer rays meet rims and crowds, and reach 15."""
_RAY_HALF_SIGMAS = dict.fromkeys(_RAY_SIGMAS, 2.5)
"""And each half of the stars has to show it."""
_RAY_LEVEL = 15
"""So many directions together give the level of the one in their midst: 30°."""
_TAIL_STARS = 12
"""Brightest stars that are searched for a long tail, each weighted by its light: a tail is as bright as its
star, and the few brightest show what the mean over all doesn't. Doubled, it costs twice as much and gains
little."""
_TAIL_HALO = 0.015
"""From this share of light beyond a point's image on a long tail is looked for: a tail of 400 px that has
half of the light leaves 2 % of it within the near search; drawn points have 0 to 1 %."""
_TAIL_RAYS, _TAIL_STEP_BINS = 360, 2
"""Directions, 1° apart: at 200 px a tail is as wide as that; and the step along them, as wide as the sums."""
_TAIL_BINS = (25, 50, 75, 100)
"""Lengths that are summed, 100 to 400 px: a longer tail fills the sum, a shorter one a part of it."""
_TAIL_SIGMAS, _TAIL_HALF_SIGMAS = 5.0, 2.8
"""A weighted sum above so many of the scatter of all directions' sums is a tail, if both halves of the stars
show it: the shared frames reach 4.5 (the lesser half 2.7), a tail of 315 px with two thirds of the light of
20 stars 6.4 (3.1; seed 62294 of `benchmarks.trailed`). Doubled, that one would be missed."""
_TAIL_ALONE = 0.5
"""A tail has less than this share of its sum on the other side of the star: spikes have as much, and pull the
middle nowhere."""
_TAIL_LEVEL = 9
"""So many directions together give the level of the one in their midst: a tail is one or two degrees wide.
With three times as many, trees, roofs and the glow of the horizon look like tails (12.7 sigmas, halves
7.9)."""
_TAIL_WEIGHT = 4.0
"""No star counts more than so many times the median of the brightest: what lies about one star is no path."""
_CORE_BINS = 3
"""Bins about each star that no tail of another one is summed over."""
_RAY_LEAST_NOISE = 0.7
"""Sums of independent bins scatter by 1, those of two by two by 0.5 to 1 (plain frames)."""
_GROWN_SIGMA = 3.0
"""What hangs together with such a bin above this belongs to it."""
_CORE_FWHM, _CORE_PX = 3.0, 14.0
"""The first search leaves out the star itself, so many widths and at least so many pixels about it."""
NEAR_PX = 28
"""The near search sees so far, in the frame's own pixels."""
_NEAR_SHARE = 0.004
"""Light above this share of the peak counts in the near search: below it are wings, halos and neighbors."""
_LIGHT_PX = 8.0
"""Radius within which the light of a reflected star is summed: two bins, as well as its position is known."""
_ROUND = 0.94
"""Mean images of plain frames have axis ratios of 0.95 to 1.00; trails from 4 px on and shaken tubes have
0.1 to 0.93."""
_EVEN = 0.97
"""Plain frames with much light reach 0.98 to 1.00: what is less round is drawn out by a little, or dim."""
_HALO_FWHM = 1.5
"""Light farther off than so many widths is no longer that of a point: drawn points have 0 to 1 % there."""
_PULL_SIGMAS = 4.0
"""Faint light pulls the center where its moment is above so many of the errors that pixels' noise gives it:
noise alone comes so far in one of 3,000 frames, second exposures with a seventh of the light of 20 stars
reach 4.7 and 6.3. Doubled, those are overlooked."""
_PULL_SIGMAS_AMONG = 2.5
"""And above so many of the errors that halves of the stars show: frames without a second exposure that pass
the first limit reached 1.3 to 2.4, those with one 2.6 to 3.7 and 5.9. Doubled, the latter are overlooked."""
_SPLITS = 6
"""So often the stars are parted into halves for it; chosen by hand, each costs two medians."""
_COVERED = 0.3
"""A part of the window that a smaller share of the stars see (it lies beyond the frame for the others)
is unknown."""
_LENGTH_SHARE = 0.004
"""Error of the center of light per pixel of the path's extent, besides the noise: levels and scales of
the stars' light differ by some percent."""
_LEAST_SIGMA_PX, _NEAR_SIGMA_PX = 0.05, 0.01
"""No center of light of a path is claimed better than the first, none of a star's image better than the
second."""


@dataclass(frozen=True, slots=True)
class StarTrail:
    """The path of the stars' light relative to the positions that were given.

    Attributes
    ----------
    dx_px, dy_px : float
        Its center of light.
    sigma_px : float
        Of that, per coordinate.
    extent_px : float
        The farthest light from the given position.
    differs_px : float
        By how much the center of light differs between halves of the field.
    cut : bool
        The path runs out of what can be seen.
    far : bool
        There is light beyond the star images.
    stars : int
        How many were used.
    axis_ratio : float
        Narrowest over widest rms width of the star's image; 1 if it is round, 0 where it was not measured.
    halo_share : float
        Of the light near by, what lies too far off for a point and is too faint to have a part in the center
        of light; 0 where it was not measured.
    pull_px : float
        How far that faint light pulls the center of all light, where that is more than noise does; else 0.
    where : ndarray of bool, shape (side, side), optional
        Where the light is that has a part in the center, in bins of two pixels about the given position; None
        where it is the star's image alone.
    """

    dx_px: float
    dy_px: float
    sigma_px: float
    extent_px: float
    differs_px: float
    cut: bool
    far: bool
    stars: int
    axis_ratio: float = 0.0
    halo_share: float = 0.0
    pull_px: float = 0.0
    where: Mask | None = field(default=None, compare=False, repr=False)

    def holds(self, dx_px: float, dy_px: float) -> bool:
        """Whether light so far from the given position has a part in the center of light."""
        if self.where is None:
            return math.hypot(dx_px, dy_px) <= self.extent_px
        half = self.where.shape[0] // 2
        column, row = half + round(dx_px / _FINE_BIN_PX), half + round(dy_px / _FINE_BIN_PX)
        near = round(_LIGHT_PX / _FINE_BIN_PX)
        return bool(
            self.where[max(0, row - near) : row + near + 1, max(0, column - near) : column + near + 1].any()
        )

    @property
    def drawn_out(self) -> bool:
        """Whether this is no image of a point: then nothing but the light shows which position is meant."""
        return self.far or self.axis_ratio < _ROUND

    @property
    def uneven(self) -> bool:
        """Whether the image is less round than that of a point with much light: its middle may lie beside."""
        return self.far or self.axis_ratio < _EVEN

    @property
    def off_px(self) -> float:
        """How far the center of light lies from the given position."""
        return float(np.hypot(self.dx_px, self.dy_px))


def star_trail(
    pixels: NDArray[np.generic],
    x_px: Array,
    y_px: Array,
    flux: Array,
    clear: Mask,
    fwhm_px: float,
    *,
    others: tuple[Array, Array] | None = None,
    plane: tuple[Image, Image] | None = None,
) -> StarTrail | None:
    """Look where the light of identified stars fell.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame's, calibrated or not.
    x_px, y_px : ndarray, shape (n,)
        Where a plate has its stars, 0-based.
    flux : ndarray, shape (n,)
        Their light, to a common scale.
    clear : ndarray of bool, shape (n,)
        Neither saturated nor otherwise spoilt: only these show how the light is distributed.
    fwhm_px : float
        Width of a star's image.
    others : (ndarray, ndarray), optional
        Positions of all stars that should be seen, brightest first, found or not, and of those beyond the
        frame whose light elsewhere would lie in it: where few were found, the others tell as well whether
        there is light elsewhere.
    plane : (ndarray, ndarray), optional
        The frame by `tamed`, if it is at hand.

    Returns
    -------
    LightPath or None
        None for fewer than four stars.
    """
    inside = (x_px > -0.5) & (y_px > -0.5) & (x_px < pixels.shape[1] - 0.5) & (y_px < pixels.shape[0] - 0.5)
    some = np.flatnonzero(inside & np.isfinite(flux) & (flux > 0))
    some = some[np.argsort(-flux[some], kind="stable")]
    every, fine = some[:_STARS], some[clear[some]][:_STARS]
    if every.size < _FEWEST:
        return None
    if fine.size < _FEWEST:
        fine = every
    near = _star_image(
        pixels, x_px[fine][:_NEAR_STARS], y_px[fine][:_NEAR_STARS], flux[fine][:_NEAR_STARS], fwhm_px
    )
    runs_out = near is None or near.cut
    plane = plane or tamed(pixels)
    seen = _far_light(plane, x_px[every], y_px[every], fwhm_px, runs_out=runs_out)
    if not seen.any() and near is not None and near.halo_share > _TAIL_HALO:
        seen = _tails(plane, x_px[every], y_px[every], flux[every], fwhm_px)
    if not seen.any() and every.size < FEW_STARS:
        expected = others if others is not None else (x_px[every], y_px[every])
        seen = _far_light_of_few(
            pixels, expected[0][:_STARS], expected[1][:_STARS], fwhm_px, runs_out=runs_out
        )
    if seen.any() or near is None:
        return _whole(pixels, x_px[fine], y_px[fine], flux[fine], seen)
    return near


# -- the near search: the star image itself ------------------------------------------------------------------


def _star_image(
    pixels: NDArray[np.generic], x: Array, y: Array, flux: Array, fwhm_px: float
) -> StarTrail | None:
    """The mean image within some widths of the star, and its center of light."""
    half = NEAR_PX
    cutouts = _cutouts(pixels, x, y, half).astype(np.float32)
    offset = np.arange(-half, half + 1, dtype=np.float64)
    away = np.hypot(offset[:, None], offset[None, :])
    rim = away > half - 5
    ground, _ = _median(np.ascontiguousarray(cutouts[:, rim].T))
    cutouts -= ground[:, None, None].astype(np.float32)
    cutouts /= flux[:, None, None].astype(np.float32)
    mean, count = _median(cutouts)
    if count.min() < min(_FEWEST, x.size) - 1:
        return None
    mean -= median(mean[rim])
    noise = 1.4826 * median(np.abs(mean[rim])) + 1e-12
    smooth = ndimage.gaussian_filter(mean, 1.0)
    peak = float(smooth[away < half - 6].max())
    bright = smooth > max(_NEAR_SHARE * peak, _GROWN_SIGMA * noise)
    labels, _ = ndimage.label(bright, structure=np.ones((3, 3)))
    strong = np.unique(labels[(smooth > max(5.0 * _NEAR_SHARE * peak, _SEEN_SIGMA * noise)) & (labels > 0)])
    mask = np.isin(labels, strong)
    if not mask.any():
        return None
    light = np.where(mask, mean, 0.0)
    dx, dy = _center(light, offset)
    # each star's own center over the same patch: their scatter is the error
    own = np.nan_to_num(cutouts * mask)
    total = own.sum(axis=(1, 2))
    sound = total > 0.3 * median(total)
    own_x = (own.sum(axis=1) @ offset)[sound] / total[sound]
    own_y = (own.sum(axis=2) @ offset)[sound] / total[sound]
    scatter = 0.7413 * np.sqrt(
        0.5
        * (
            np.subtract(*np.percentile(own_x, [75, 25])) ** 2
            + np.subtract(*np.percentile(own_y, [75, 25])) ** 2
        )
    )
    extent = float(away[mask].max())
    sigma = 1.25 * scatter / np.sqrt(max(1, int(sound.sum())))
    cut = bool(mask[rim & (away > half - 2)].any())
    ratio = _axis_ratio(np.where(mask, smooth, 0.0), offset)
    inner = away < half - 6
    # the bright part of a trail is in its center already
    faint = inner & ~mask & (away > _HALO_FWHM * fwhm_px)
    all_light = max(float(mean[inner].sum()), 1e-12)
    halo = mean[faint].sum() / all_light
    moment, sigma_white = _moment(mean, faint, rim, offset, noise)
    pull = math.hypot(*moment)
    sure = pull > _PULL_SIGMAS * sigma_white and (
        pull > _PULL_SIGMAS_AMONG * _moment_scatter(cutouts, faint, rim, offset, noise)
    )
    return StarTrail(
        dx,
        dy,
        max(float(sigma), _NEAR_SIGMA_PX),
        extent,
        0.0,
        cut,
        False,
        x.size,
        ratio,
        float(np.clip(halo, 0.0, 1.0)),
        pull / all_light if sure else 0.0,
    )


def _moment(
    mean: Array, faint: Mask, rim: Mask, offset: Array, noise: float
) -> tuple[tuple[float, float], float]:
    """Moment of the faint light about the star, in light times pixels, and its error by the noise of pixels.

    What grows evenly across the image is the sky, which the rim shows. The error is that of each coordinate.
    """
    x, y = np.broadcast_to(offset, mean.shape), np.broadcast_to(offset[:, None], mean.shape)
    sky = np.clip(mean, -_SEEN_SIGMA * noise, _SEEN_SIGMA * noise)
    square = float((x[rim] ** 2).sum())
    across, up = float((sky * x)[rim].sum()) / square, float((sky * y)[rim].sum()) / square
    left = mean - across * x - up * y
    moment = float((left * x)[faint].sum()), float((left * y)[faint].sum())
    inner2 = float((x[faint] ** 2).sum())
    return moment, noise * math.sqrt(inner2 + inner2**2 / square)


def _moment_scatter(
    cutouts: NDArray[np.float32], faint: Mask, rim: Mask, offset: Array, noise: float
) -> float:
    """Error of that moment, per coordinate, as halves of the stars differ in it.

    Pixels of a JPEG or of an even color mosaic have a noise in common, and neighbors are no noise at all.
    """
    order = np.random.default_rng(0).permuted(np.tile(np.arange(len(cutouts)), (_SPLITS, 1)), axis=1)
    apart2 = 0.0
    for split in order:
        halves = []
        for part in (split[::2], split[1::2]):
            image, _ = _median(cutouts[part])
            image -= median(image[rim])
            halves.append(_moment(image, faint, rim, offset, math.sqrt(2.0) * noise)[0])
        apart2 += (halves[0][0] - halves[1][0]) ** 2 + (halves[0][1] - halves[1][1]) ** 2
    # two halves differ by twice the error of the whole, in each of two coordinates
    return math.sqrt(apart2 / _SPLITS / 8.0) + 1e-12


def _axis_ratio(light: Array, offset: Array) -> float:
    """Narrowest over widest rms width."""
    light = np.maximum(light, 0.0) / max(float(light.sum()), 1e-12)
    dx, dy = _center(light, offset)
    along_x, along_y = light.sum(axis=0), light.sum(axis=1)
    # the width of a pixel, so that a mask of one row has an axis ratio too
    xx = float(along_x @ (offset - dx) ** 2) + 1.0 / 12.0
    yy = float(along_y @ (offset - dy) ** 2) + 1.0 / 12.0
    xy = float((offset - dy) @ light @ (offset - dx))
    least, most = np.linalg.eigvalsh(np.array([[xx, xy], [xy, yy]]))
    return float(np.sqrt(max(least, 0.0) / most))


def _center(light: Array, offset: Array) -> tuple[float, float]:
    total = max(float(light.sum()), 1e-12)
    return float(light.sum(axis=0) @ offset) / total, float(light.sum(axis=1) @ offset) / total


def _cutouts(pixels: NDArray[np.generic], x: Array, y: Array, half: int) -> Array:
    """Squares round positions, moved by parts of a pixel; NaN beyond the frame; shape (n, side, side)."""
    left, low = np.floor(x).astype(int), np.floor(y).astype(int)
    offset = np.arange(-half, half + 2)
    rows, columns = low[:, None] + offset, left[:, None] + offset
    height, width = pixels.shape
    cut = pixels[np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :]]
    cutouts = cut.astype(np.float64)
    cutouts[np.broadcast_to(((rows < 0) | (rows >= height))[:, :, None], cutouts.shape)] = np.nan
    cutouts[np.broadcast_to(((columns < 0) | (columns >= width))[:, None, :], cutouts.shape)] = np.nan
    u, v = (x - left)[:, None, None], (y - low)[:, None, None]
    cutouts = cutouts[:, :, :-1] * (1 - u) + cutouts[:, :, 1:] * u
    return np.asarray(cutouts[:, :-1] * (1 - v) + cutouts[:, 1:] * v)


# -- the far search: is there light of the stars elsewhere? --------------------------------------------------


def in_bins(pixels: NDArray[np.generic], summed: Summed | None = None) -> tuple[Image, Image]:
    """The frame in coarse bins, in sigmas of its sky; and which bins are known.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.
    summed : Summed, optional
        A frame of whole numbers in smaller or equal bins, if it is at hand.
    """
    whole = pixels.dtype.kind in "ui"
    if summed is None:
        return in_sigmas(coarse_plane(pixels, FAR_BIN_PX), FAR_BIN_PX, whole=whole)
    sky = summed.sky if summed.bin_px == FAR_BIN_PX else None
    plane = in_wider_bins(summed.plane, summed.bin_px, FAR_BIN_PX)
    return in_sigmas(plane, FAR_BIN_PX, whole=whole, sky=sky)


def tamed(pixels: NDArray[np.generic], bins: tuple[Image, Image] | None = None) -> tuple[Image, Image]:
    """The frame by `in_bins`, cut at a few sigmas, so that no bright star counts for much."""
    plane, cover = in_bins(pixels) if bins is None else bins
    return np.clip(plane, -_TAME_SIGMA, _TAME_SIGMA), cover


def _far_light_of_few(
    pixels: NDArray[np.generic], x: Array, y: Array, fwhm_px: float, *, runs_out: bool
) -> Mask:
    """The same for few stars: none of their light may be lost by where the bins happen to lie.

    Bins overlap by half. Of many stars some lie well in their bins; of four none may.
    """
    step = FAR_BIN_PX // 2
    height, width = (side // step for side in pixels.shape)
    tame = np.zeros((height, width), dtype=np.float32)
    cover = np.zeros_like(tame)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        part, known = tamed(pixels[row * step :, column * step :])
        position = (slice(row, row + 2 * part.shape[0], 2), slice(column, column + 2 * part.shape[1], 2))
        tame[position], cover[position] = part, known
    seen = np.zeros((2 * (REACH_PX // FAR_BIN_PX) + 1,) * 2, dtype=bool)
    # the middle of an overlapping bin lies a pixel beyond that of its first half
    middle_x, middle_y = x - 0.5 * step, y - 0.5 * step
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        seen |= _far_light(
            (tame, cover), middle_x, middle_y, fwhm_px, runs_out=runs_out, step=step, ahead=(down, right)
        )
    return seen


def _far_light(
    plane: tuple[Image, Image],
    x: Array,
    y: Array,
    fwhm_px: float,
    *,
    runs_out: bool,
    step: int = FAR_BIN_PX,
    ahead: tuple[int, int] = (0, 0),
) -> Mask:
    """Where the tamed mean image stands out, in bins of `FAR_BIN_PX`; all False for plain stars.

    If the light runs out of the near search, what hangs together with the star belongs to it, however faint.
    The plane has a bin every `step` pixels; the search begins so many of these `ahead`.
    """
    tame, cover = plane
    half = REACH_PX // FAR_BIN_PX
    side = 2 * half + 1
    # two halves of the stars, so that what only one of them shows is distinguished from what all have
    total, count = np.zeros((2, side, side), dtype=np.float32), np.zeros((2, side, side), dtype=np.float32)
    every = FAR_BIN_PX // step
    windows = _windows(x, y, step, half, tame.shape, every=every, ahead=ahead)
    for k, (window, frame) in enumerate(windows):
        total[k % 2][window] += tame[frame]
    whole = bool(cover.min() > 0.0)
    for one in range(2):
        _add_cover(count[one], windows[one::2], cover, whole=whole)
    # positions beyond the frame count only where their light would be in it
    most = float(count.sum(axis=0).max())
    known = count.sum(axis=0) >= max(3.0, _COVERED * most)
    seen: Mask = np.zeros((side, side), dtype=bool)
    if not known.any():
        return seen
    scaled = _scaled(total.sum(axis=0), count.sum(axis=0), known)
    offset = np.arange(-half, half + 1) * FAR_BIN_PX
    away = np.hypot(offset[:, None], offset[None, :])
    # images wider than the near search sees are paths themselves
    core_px = min(max(_CORE_FWHM * fwhm_px, _CORE_PX), NEAR_PX - FAR_BIN_PX)
    outside = known & (away >= core_px)
    seen = outside & (scaled > _SEEN_SIGMA)
    grown = outside & (scaled > _GROWN_SIGMA)
    if runs_out:
        seen |= grown & (away < core_px + 3 * FAR_BIN_PX)
    if seen.any():
        labels, _ = ndimage.label(grown, structure=np.ones((3, 3)))
        seen = np.isin(labels, np.unique(labels[seen]))
    rays = _rays(np.where(outside, scaled, 0.0), outside, core_px, _RAY_SIGMAS)
    if rays.any():
        for one in range(2):
            part = _scaled(total[one], count[one], known)
            rays &= _rays(np.where(outside, part, 0.0), outside, core_px, _RAY_HALF_SIGMAS)
    return seen | rays


def _scaled(total: Image, count: Image, known: Mask) -> Array:
    """The mean over the stars in units of its own scatter."""
    mean = total / np.maximum(count, 1.0)
    root = (mean - median(mean[known])) * np.sqrt(count)
    return np.asarray(root / max(1.4826 * median(np.abs(root[known])), 1e-6), dtype=np.float64)


def _stands_nowhere_out(total: Image, count: Image, known: Mask) -> bool:
    """Whether `_scaled` is below `_SEEN_SIGMA` all over: told by counting, without another median."""
    mean = total / np.maximum(count, 1.0)
    root = ((mean - median(mean[known])) * np.sqrt(count))[known]
    highest = float(root.max())
    # a hair less: whatever rounding does, the scatter isn't smaller
    scatter = highest / (1.4826 * _SEEN_SIGMA) * (1.0 + 1e-4)
    return math.isfinite(highest) and int(np.count_nonzero(np.abs(root) < scatter)) <= (root.size - 1) // 2


def _rays(scaled: Array, outside: Mask, core_px: float, limits: dict[int, float]) -> Mask:
    """The straight ways from the star along which faint light adds up: a tail too thin to show in any bin.

    Parameters
    ----------
    scaled : ndarray, shape (side, side)
        The tamed mean image in units of its noise, 0 where unknown.
    outside : ndarray of bool, shape (side, side)
        Where it is known, the star left out.
    limits : dict
        By the length of a ray, in bins.
    """
    half = scaled.shape[0] // 2
    angle = np.arange(_RAYS) * (2.0 * np.pi / _RAYS)
    radius = np.arange(core_px / FAR_BIN_PX, half, 1.0)
    rows = np.rint(half + np.outer(np.sin(angle), radius)).astype(np.intp)
    columns = np.rint(half + np.outer(np.cos(angle), radius)).astype(np.intp)
    # two bins wide: a tail lies between the bins as often as on them
    soft = ndimage.uniform_filter(scaled, 2, mode="constant")
    known = outside[rows, columns]
    total = np.cumsum(np.where(known, soft[rows, columns], 0.0), axis=1)
    count = np.cumsum(known, axis=1)
    mean = total / np.sqrt(np.maximum(count, 1))
    seen: Mask = np.zeros(scaled.shape, dtype=bool)
    for steps, limit in limits.items():
        if steps > radius.size:
            break
        # what changes slowly with the direction is sky, halos and crowds
        sums = mean[:, steps - 1]
        sums = sums - ndimage.median_filter(sums, size=_RAY_LEVEL, mode="wrap")
        noise = max(1.4826 * median(np.abs(sums)), _RAY_LEAST_NOISE)
        for ray in np.flatnonzero(sums > limit * noise):
            seen[rows[ray, :steps], columns[ray, :steps]] = True
    return seen & outside


def _tails(plane: tuple[Image, Image], x: Array, y: Array, flux: Array, fwhm_px: float) -> Mask:
    """The straight way from the star along which the light of the brightest adds up, on one side alone.

    What rested at one position for a part of the exposure and moved evenly for the rest is a point with a
    tail, which may have more light than the point and still be far below the noise in every bin of the mean
    image.

    Parameters
    ----------
    plane : (ndarray, ndarray)
        The frame by `tamed`.
    x, y, flux : ndarray, shape (n,)
        Brightest first.

    Returns
    -------
    ndarray of bool, shape (side, side)
        In bins of `FAR_BIN_PX` about the star.
    """
    tame, cover = plane
    half = REACH_PX // FAR_BIN_PX
    seen: Mask = np.zeros((2 * half + 1, 2 * half + 1), dtype=bool)
    bins_x, bins_y = (x - 0.5 * (FAR_BIN_PX - 1)) / FAR_BIN_PX, (y - 0.5 * (FAR_BIN_PX - 1)) / FAR_BIN_PX
    clear = cover > 0
    for column, row in zip(
        np.rint(bins_x).astype(int).tolist(), np.rint(bins_y).astype(int).tolist(), strict=True
    ):
        clear[
            max(0, row - _CORE_BINS) : row + _CORE_BINS + 1,
            max(0, column - _CORE_BINS) : column + _CORE_BINS + 1,
        ] = False
    soft = ndimage.uniform_filter(tame, 2, mode="constant")
    core_px = min(max(_CORE_FWHM * fwhm_px, _CORE_PX), NEAR_PX - FAR_BIN_PX)
    angle = np.arange(_TAIL_RAYS) * (2.0 * np.pi / _TAIL_RAYS)
    radius = np.arange(core_px / FAR_BIN_PX, half, _TAIL_STEP_BINS)
    away_x, away_y = np.outer(np.cos(angle), radius), np.outer(np.sin(angle), radius)
    height, width = tame.shape
    # two halves of the stars, each along every ray: sums of light times light, and of its square as weight
    sums, weights = (np.zeros((2, _TAIL_RAYS, radius.size)) for _ in range(2))
    light = np.minimum(flux, _TAIL_WEIGHT * median(flux[:_TAIL_STARS]))
    for k in range(min(_TAIL_STARS, x.size)):
        rows, columns = (
            np.rint(middle + away).astype(np.intp)
            for middle, away in ((bins_y[k], away_y), (bins_x[k], away_x))
        )
        inside = (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
        rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
        known = inside & clear[rows, columns]
        sums[k % 2] += np.where(known, soft[rows, columns], 0.0) * light[k]
        weights[k % 2] += known * light[k] ** 2
    sums, weights = sums.cumsum(axis=2), weights.cumsum(axis=2)
    for bins in _TAIL_BINS:
        steps = bins // _TAIL_STEP_BINS
        if steps > radius.size:
            break
        some_sums, some_weights = sums[:, :, steps - 1], weights[:, :, steps - 1]
        every = _ray_sigmas(some_sums.sum(axis=0), some_weights.sum(axis=0))
        first, second = (_ray_sigmas(a, b) for a, b in zip(some_sums, some_weights, strict=True))
        opposite = np.roll(every, _TAIL_RAYS // 2)
        found = (every > _TAIL_SIGMAS) & (np.minimum(first, second) > _TAIL_HALF_SIGMAS)
        for ray in np.flatnonzero(found & (opposite < _TAIL_ALONE * every)):
            for along in range(steps * _TAIL_STEP_BINS):
                away = core_px / FAR_BIN_PX + along
                row, column = (
                    round(half + away * part) for part in (math.sin(angle[ray]), math.cos(angle[ray]))
                )
                if 0 <= row <= 2 * half and 0 <= column <= 2 * half:
                    seen[row, column] = True
    return seen


def _ray_sigmas(sums: Array, weights: Array) -> Array:
    """Weighted sums along rays in units of their scatter over all directions; what changes slowly is off."""
    scaled = sums / np.sqrt(np.maximum(weights, 1e-12))
    scaled = scaled - ndimage.median_filter(scaled, size=_TAIL_LEVEL, mode="wrap")
    return np.asarray(scaled / max(1.4826 * median(np.abs(scaled)), _RAY_LEAST_NOISE))


def in_sigmas(plane: Image, bin_px: int, *, whole: bool, sky: CoarseSky | None = None) -> tuple[Image, Image]:
    """A coarse plane without its sky, in units of its noise; and 1 where there is a value, else 0.

    `sky` is what `coarse_sky` says of the plane, if it is known.
    """
    cover = np.ones(plane.shape, dtype=np.float32)
    missing = ~np.isfinite(plane)
    if missing.any():
        plane[missing] = median(plane[~missing]) if not missing.all() else 0.0
        cover[missing] = 0.0
    if sky is None or missing.any():
        sky = coarse_sky(plane, bin_px, whole_numbers=whole)
    level, noise = _spread(sky, plane.shape)
    np.subtract(plane, level, out=level)
    level /= noise
    if missing.any():
        level *= cover
    return level, cover


def _spread(sky: CoarseSky, shape: tuple[int, ...]) -> tuple[Image, Image]:
    """Level and noise of every bin: those of its tile."""
    rows = np.minimum(np.arange(shape[0]) // sky.tile_bins, sky.level.shape[0] - 1)
    columns = np.minimum(np.arange(shape[1]) // sky.tile_bins, sky.level.shape[1] - 1)
    noise = np.maximum(sky.noise, 0.5 * median(sky.noise) + 1e-9)
    level = sky.level.astype(np.float32).take(columns, axis=1).take(rows, axis=0)
    return level, noise.astype(np.float32).take(columns, axis=1).take(rows, axis=0)


def _windows(
    x: Array,
    y: Array,
    bin_px: int,
    half: int,
    shape: tuple[int, ...],
    *,
    every: int = 1,
    ahead: tuple[int, int] = (0, 0),
) -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """For each position the part of its window that the plane covers, and the plane's part.

    A window has `half` bins on each side of its middle, `every` so many bins of the plane apart, and begins
    so many rows and columns `ahead`.
    """
    found = []
    columns = np.rint((x - 0.5 * (bin_px - 1)) / bin_px).astype(int) + ahead[1]
    rows = np.rint((y - 0.5 * (bin_px - 1)) / bin_px).astype(int) + ahead[0]
    for column, row in zip(columns.tolist(), rows.tolist(), strict=True):
        parts = []
        for middle, length in ((row, shape[0]), (column, shape[1])):
            first = max(0, half - middle // every)
            last = min(2 * half, half + (length - 1 - middle) // every)
            begin = middle + (first - half) * every
            count = max(0, last - first + 1)
            parts.append((slice(first, first + count), slice(begin, begin + count * every, every)))
        found.append(((parts[0][0], parts[1][0]), (parts[0][1], parts[1][1])))
    return found


def _add_cover(
    count: Image, windows: list[tuple[tuple[slice, slice], tuple[slice, slice]]], cover: Image, *, whole: bool
) -> None:
    """Add to each bin of a window how many of the positions have it in the frame, and known.

    `whole` says that the cover is 1 everywhere: then a window is a rectangle of ones, told by its corners.
    """
    if not whole:
        for window, frame in windows:
            count[window] += cover[frame]
        return
    # whole numbers below 2^24: exact, in whatever order they are added
    ends = np.array(
        [[(part.start, part.stop) for part in window] for window, _ in windows], dtype=np.intp
    ).reshape(-1, 2, 2)
    in_rows, in_columns = (_between(ends[:, axis], count.shape[axis]) for axis in (0, 1))
    count += in_rows.T @ in_columns


def _between(ends: NDArray[np.intp], length: int) -> Image:
    """1 from the first of two places up to the second, else 0; shape (n, length)."""
    place = np.arange(length)
    return ((place >= ends[:, :1]) & (place < ends[:, 1:])).astype(np.float32)


def _flipped(
    part: tuple[slice, slice], shape: tuple[int, ...], along_y: bool, along_x: bool
) -> tuple[slice, slice]:
    """Where a part of a flipped image lies in the image itself; steps of one."""
    rows, columns = part
    if along_y:
        rows = slice(shape[0] - rows.stop, shape[0] - rows.start)
    if along_x:
        columns = slice(shape[1] - columns.stop, shape[1] - columns.start)
    return rows, columns


def brighter_image(
    pixels: NDArray[np.generic], x_px: Array, y_px: Array, plane: tuple[Image, Image] | None = None
) -> tuple[float, str]:
    """Look for a mirrored set of the same stars, and compare its light with that at the positions themselves.

    A reflection within the optics puts a fainter copy of every star at its position mirrored about the
    optical axis. A plate that fits the copies is as sure as one that fits the stars, but turned by half a
    turn.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.
    x_px, y_px : ndarray, shape (n,)
        Where a plate has its stars, brightest first.
    plane : (ndarray, ndarray), optional
        The frame by `tamed`, if it is at hand.

    Returns
    -------
    ratio : float
        Median light of the mirrored positions over that of the stars' own, where the plate has no star at the
        mirrored position; 0 if no such set is seen, or if most of its light is that of stars.
    how : str
        "turned", "mirrored in x", "mirrored in y".
    """
    x, y = x_px[:_STARS], y_px[:_STARS]
    if x.size < _FEWEST:
        return 0.0, ""
    tame, cover = plane or tamed(pixels)
    height, width = tame.shape
    half = REACH_PX // FAR_BIN_PX
    windows, whole = _windows(x, y, FAR_BIN_PX, half, tame.shape), bool(cover.min() > 0.0)
    best = 0.0, ""
    for how, along_x, along_y in (
        ("turned", True, True),
        ("mirrored in x", True, False),
        ("mirrored in y", False, True),
    ):
        way = (slice(None, None, -1 if along_y else 1), slice(None, None, -1 if along_x else 1))
        total = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.float32)
        count = np.zeros_like(total)
        # the sum is flipped, not the frame: lines are added up fastest in their own direction
        for window, frame in windows:
            total[_flipped(window, total.shape, along_y, along_x)] += tame[
                _flipped(frame, tame.shape, along_y, along_x)
            ]
        total = total[way]
        _add_cover(count, windows, cover[way], whole=whole)
        known = count >= max(3.0, _COVERED * x.size)
        if not known.any() or _stands_nowhere_out(total, count, known):
            continue
        scaled = np.where(known, _scaled(total, count, known), 0.0)
        row, column = np.unravel_index(int(np.argmax(scaled)), scaled.shape)
        if scaled[row, column] < _SEEN_SIGMA:
            continue
        # a star's bin in the flipped frame, moved by the offset, back in the frame as it is
        there_x = np.rint((x - 1.5) / FAR_BIN_PX) + column - half
        there_y = np.rint((y - 1.5) / FAR_BIN_PX) + row - half
        there_x = width - 1 - there_x if along_x else there_x
        there_y = height - 1 - there_y if along_y else there_y
        inside = (there_x >= 1) & (there_y >= 1) & (there_x < width - 1) & (there_y < height - 1)
        if inside.sum() < _FEWEST:
            continue
        at_x, at_y = there_x * FAR_BIN_PX + 1.5, there_y * FAR_BIN_PX + 1.5
        # two stars that lie opposite to each other about some position aren't images of each other: light
        # that the plate has a star for is that star's
        away = np.hypot(at_x[:, None] - x, at_y[:, None] - y).min(axis=1)
        strange = inside & (away > _LIGHT_PX)
        if strange.sum() < 0.5 * inside.sum():
            continue
        own = _light_at(pixels, x[strange], y[strange])
        other = _light_at(pixels, at_x[strange], at_y[strange])
        ratio = median(other / np.maximum(own, 1e-9))
        if ratio > best[0]:
            best = ratio, how
    return best


def _light_at(pixels: NDArray[np.generic], x: Array, y: Array) -> Array:
    """Light within `_LIGHT_PX` of positions above their surroundings, shape (n,)."""
    half = 14
    cutouts = _cutouts(pixels, np.clip(x, 0, pixels.shape[1] - 1), np.clip(y, 0, pixels.shape[0] - 1), half)
    offset = np.arange(-half, half + 1)
    away = np.hypot(offset[:, None], offset[None, :])
    ground = np.nanmedian(cutouts[:, away > 10], axis=1)
    return np.asarray(np.nansum((cutouts - ground[:, None, None]) * (away <= _LIGHT_PX), axis=(1, 2)))


# -- the whole path ------------------------------------------------------------------------------------------


def _whole(pixels: NDArray[np.generic], x: Array, y: Array, flux: Array, seen: Mask) -> StarTrail:
    """Measure the path: the median image over the stars in the star's own light, and its center."""
    bin_px = _FINE_BIN_PX
    # no farther out than there is light, and a rim that gives the level without light
    middle_bin = seen.shape[0] // 2
    out = int(np.abs(np.argwhere(seen) - middle_bin).max()) if seen.any() else middle_bin
    reach = min(middle_bin, max(out, NEAR_PX // FAR_BIN_PX) + _RIM_BINS)
    seen = seen[middle_bin - reach : middle_bin + reach + 1, middle_bin - reach : middle_bin + reach + 1]
    plane = coarse_plane(pixels, bin_px)
    missing = ~np.isfinite(plane)
    if missing.any():
        plane[missing] = median(plane[~missing])
    level, _ = _spread(coarse_sky(plane, bin_px, whole_numbers=pixels.dtype.kind in "ui"), plane.shape)
    plane = plane - level
    plane[missing] = np.nan
    half = (seen.shape[0] // 2) * (FAR_BIN_PX // bin_px)
    side = 2 * half + 1
    windows = np.full((x.size, side, side), np.nan, dtype=np.float32)
    middle = 0.5 * (bin_px - 1)
    shift_x = (x - middle) / bin_px - np.rint((x - middle) / bin_px)
    shift_y = (y - middle) / bin_px - np.rint((y - middle) / bin_px)
    for k, (window, frame) in enumerate(_windows(x, y, bin_px, half, plane.shape)):
        windows[k][window] = plane[frame] / flux[k]
    mean, count = _median(windows)
    known = count >= max(3.0, _COVERED * x.size)
    offset = bin_px * np.arange(-half, half + 1, dtype=np.float64)
    away = np.hypot(offset[:, None], offset[None, :])
    mean = mean - median(mean[known])
    noise = 1.4826 * median(np.abs(mean[known])) + 1e-12
    # the tamed search says where there is light: this mean, which counts bright neighbors in full, only
    # how much
    share = FAR_BIN_PX // bin_px
    room = np.zeros((side, side), dtype=bool)
    wide = np.kron(seen, np.ones((share, share), dtype=bool))[share // 2 :, share // 2 :][:side, :side]
    room[: wide.shape[0], : wide.shape[1]] = wide
    smooth = ndimage.gaussian_filter(np.where(known, mean, 0.0), 1.0)
    quiet = 1.4826 * median(np.abs(smooth[known])) + 1e-12
    labels, _ = ndimage.label(
        (smooth > _GROWN_SIGMA * quiet) & (away < 2 * _CORE_PX), structure=np.ones((3, 3))
    )
    core = np.isin(labels, np.unique(labels[(labels > 0) & (away < 6.0)]))
    mask = ndimage.binary_dilation(core | room, iterations=3) & known
    if not mask.any():
        return StarTrail(0.0, 0.0, float("inf"), float(offset[-1]), float("inf"), True, True, x.size)
    light = np.where(mask, mean, 0.0)
    dx, dy = _center(light, offset)
    total = float(light.sum())
    extent = float(away[mask].max())
    edge = ~ndimage.binary_erosion(known, iterations=2, border_value=0)
    cut = bool((mask & edge).any())
    spread_px = float(np.sqrt((away[mask] ** 2).mean()))
    sigma = noise * np.sqrt(float(mask.sum())) * spread_px / max(total, 1e-12)
    halves = []
    order = np.arange(x.size)
    for part in (order % 2 == 0, x < median(x), y < median(y)):
        centers = []
        for some in (part, ~part):
            if some.sum() < _FEWEST - 1:
                continue
            image, seen_by = _median(windows[some])
            ok = mask & (seen_by >= 2)
            image = image - median(image[known & (seen_by >= 2)])
            # what one half doesn't see is as the whole has it
            own_x, own_y = _center(np.where(ok, image, light), offset)
            # each half's positions lie otherwise in their bins: 0.3 px of 24 stars
            centers.append(
                (own_x - bin_px * float(shift_x[some].mean()), own_y - bin_px * float(shift_y[some].mean()))
            )
        halves.append(
            float(np.hypot(centers[0][0] - centers[1][0], centers[0][1] - centers[1][1]))
            if len(centers) == 2
            else np.inf
        )
    # halves of one field: chance makes the first difference, chance and a path that isn't common the others
    differs = max(halves[1:])
    noise_px = max(sigma, 0.5 * halves[0], 0.25 * differs)
    sigma = float(np.hypot(noise_px, _LENGTH_SHARE * extent))
    # the mean part of a bin that rounding left
    return StarTrail(
        dx - bin_px * float(shift_x.mean()),
        dy - bin_px * float(shift_y.mean()),
        max(sigma, _LEAST_SIGMA_PX),
        extent,
        float(differs),
        cut,
        True,
        x.size,
        where=mask,
    )


def _median(windows: Image) -> tuple[Array, Array]:
    """Median over the first axis of what is finite, and how many that are."""
    ranked = np.sort(windows, axis=0)  # what isn't seen comes last
    count = np.isfinite(windows).sum(axis=0)
    last = np.maximum(count - 1, 0)
    pick = np.take_along_axis(ranked, np.stack([last // 2, (last + 1) // 2]), axis=0).astype(np.float64)
    return np.where(count > 0, 0.5 * (pick[0] + pick[1]), 0.0), count.astype(np.float64)
