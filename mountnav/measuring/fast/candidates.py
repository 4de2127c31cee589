"""Candidates in the full frame: the highest pixel near each coarse peak, single pixels, saturated patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.detection import DARK_NEIGHBORS, SINGLE_PIXEL_SIGMA
from mountnav.measuring.fast.coarse import CoarsePeaks
from mountnav.measuring.fast.moments import Patches, Pixels
from mountnav.measuring.fast.scene import Scene
from mountnav.measuring.medians import median

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SURROUND_PX = 4
"""Pixels beyond a bin that are cut out with it, for the ground under the source. Doubled or halved, one
source in 226 to 233 changes."""
_WIDTH_STARS = 120
"""Stars whose median area gives the typical width, spread over all magnitudes. Doubled or halved, one or two
sources in 230 change."""
_LARGE_AREA_PX2 = 12.0
"""Median area above half maximum, px², above which a lower percentile is taken: of stars as wide as 3.9 px
blends and streaks would enlarge it. Doubled, nothing changed on the frames that were tried; halved, the
median error of one painted field falls from 0.206 to 0.196 px."""
_LARGE_PERCENT = 40.0  # blends and streaks only add
"""That percentile: blends and streaks only add to the area."""
_WIDTH_HALVES_PX = (12, 24)
"""Half sides of the squares in which the area is measured, px; the second for stars that fill the first.
Halved, a tetra3 frame is given up; doubled, its ground is less local, and 4 of 211 sources of a crowd are
lost."""
_SATURATED_HALF_PX = 20
"""Half side of the squares in which saturated patches are sized up, px. Doubled, one patch more in four is
taken for a part of another; halved, nothing changed on the frames that were tried."""
_MOST_SATURATED = 60
"""Saturated patches at most that are sized up: bounds the time."""
_THICK_SHARE = 0.7
"""A patch's thick part are the rows and columns with more than this share of the longest one's saturated
pixels: charge that ran over is thinner."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Positions of the full frame, in the coarse peaks' order, each array of shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        The highest pixel of the smoothed frame near the coarse peak.
    top : ndarray
        The highest pixel there.
    height : ndarray
        The same above its surroundings.
    flux : ndarray
        Of the coarse peak.
    lone : ndarray of bool
        Single bright pixels: hot ones, cosmic rays.
    """

    x_px: Array
    y_px: Array
    top: Array
    height: Array
    flux: Array
    lone: Mask


def locate(scene: Scene, peaks: CoarsePeaks) -> tuple[Candidates, Patches]:
    """Look at the full frame where the coarse plane has peaks.

    Returns
    -------
    Patches
        The pixels that were looked at.
    """
    bin_px = scene.bin_px
    patches = scene.cut(peaks.x_px, peaks.y_px, bin_px + _SURROUND_PX)
    ground = patches.ground()
    smooth = smoothed(patches.values)
    # the smoothed patch lacks its outermost pixels
    steps = np.arange(smooth.shape[1]) + 1
    far_x = np.abs(patches.left[:, None] + steps - peaks.x_px[:, None]) > bin_px + 1
    far_y = np.abs(patches.top[:, None] + steps - peaks.y_px[:, None]) > bin_px + 1
    near = np.where(far_x[:, None, :] | far_y[:, :, None], np.float32(-np.inf), smooth)
    row, column = np.divmod(near.reshape(near.shape[0], -1).argmax(axis=1), near.shape[2])
    top, lone = single_pixels(patches.values, row + 1, column + 1, ground, scene.noise_adu)
    found = Candidates(
        (patches.left + column + 1).astype(np.float64),
        (patches.top + row + 1).astype(np.float64),
        top.astype(np.float64),
        (top - ground).astype(np.float64),
        peaks.flux,
        lone,
    )
    return found, patches


def smoothed(values: Pixels) -> Pixels:
    """Smooth patches (n, side, side) by 1 2 1 both ways; one pixel all round is lost."""
    # 1 2 1 is 1 1 twice
    lines = values[:, :-1] + values[:, 1:]
    lines = lines[:, :-1] + lines[:, 1:]
    smooth = lines[:, :, :-1] + lines[:, :, 1:]
    smooth = smooth[:, :, :-1] + smooth[:, :, 1:]
    smooth *= np.float32(1.0 / 16.0)
    return np.asarray(smooth)


def single_pixels(
    values: Pixels, row: NDArray[np.intp], column: NDArray[np.intp], ground: Pixels, noise: float
) -> tuple[Pixels, Mask]:
    """Height of the highest pixel at positions of patches, and whether its neighbors are dark."""
    index, side = np.arange(row.size), values.shape[1]
    row, column = np.clip(row, 2, side - 3), np.clip(column, 2, side - 3)
    ring = np.stack([values[index, row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=1)
    best = ring.argmax(axis=1)
    top = ring[index, best]
    row, column = row + best // 3 - 1, column + best % 3 - 1
    around = -top
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            around = around + values[index, row + dy, column + dx]
    neighbors, height = around / 8.0 - ground, top - ground
    return top, (height > SINGLE_PIXEL_SIGMA * noise) & (neighbors < DARK_NEIGHBORS * height + noise)


def width_px(scene: Scene, x_px: Array, y_px: Array) -> float:
    """Typical full width at half maximum of stars, from the area above half maximum.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Clear unsaturated stars, brightest first.

    Returns
    -------
    float
        NaN if there is none.
    """
    fwhm = float("nan")
    # not the brightest alone: stretched pictures swell those
    some = np.unique(np.linspace(0, x_px.size - 1, min(x_px.size, _WIDTH_STARS)).astype(np.intp))
    x, y = x_px[some], y_px[some]
    for half in _WIDTH_HALVES_PX if x.size else ():
        patches = scene.cut(x, y, half)
        light = patches.values - patches.ground()[:, None, None]
        rows, columns = np.rint(y).astype(np.intp) - patches.top, np.rint(x).astype(np.intp) - patches.left
        top = light[np.arange(x.size), rows, columns]
        area = (light > 0.5 * top[:, None, None]).sum(axis=(1, 2))
        typical = median(area)
        if typical > _LARGE_AREA_PX2:
            typical = float(np.percentile(area, _LARGE_PERCENT))
        fwhm = float(np.sqrt(4.0 / np.pi * typical))
        if fwhm < 0.6 * half:
            break
    return fwhm


@dataclass(frozen=True, slots=True)
class SaturatedPatches:
    """Saturated patches, each array of shape (n,).

    Attributes
    ----------
    which : ndarray of int
        Index of the candidate.
    radius_px : ndarray
        Of a disc as large.
    x_px, y_px : ndarray
        Their middle.
    tall : ndarray
        Extent along the columns over that along the rows.
    """

    which: NDArray[np.intp]
    radius_px: Array
    x_px: Array
    y_px: Array
    tall: Array

    def part(self, some: Mask) -> SaturatedPatches:
        """Some of them."""
        return SaturatedPatches(
            self.which[some], self.radius_px[some], self.x_px[some], self.y_px[some], self.tall[some]
        )


def saturated_patches(scene: Scene, x_px: Array, y_px: Array, top: Array) -> SaturatedPatches:
    """Size up what is saturated round positions, shape (n,), whose highest pixels are; not too many.

    Where charge runs along a column or a line, the patch's position and size are those of its thick part.
    """
    which = np.flatnonzero(top >= scene.full_adu)[:_MOST_SATURATED]
    patches = scene.cut(x_px[which], y_px[which], _SATURATED_HALF_PX)
    mask = patches.values >= scene.full_adu
    steps = np.arange(patches.side_px)
    columns, rows = mask.sum(axis=1), mask.sum(axis=2)
    tall = np.sqrt(_spread(rows, steps) / _spread(columns, steps))
    thick = mask & (rows > _THICK_SHARE * rows.max(axis=1)[:, None])[:, :, None]
    thick &= (columns > _THICK_SHARE * columns.max(axis=1)[:, None])[:, None, :]
    area = np.maximum(thick.sum(axis=(1, 2)), 1)
    x = (thick.sum(axis=1) * steps).sum(axis=1) / area
    y = (thick.sum(axis=2) * steps).sum(axis=1) / area
    return SaturatedPatches(which, np.sqrt(area / np.pi), patches.left + x, patches.top + y, tall)


def _spread(counts: NDArray[np.intp], steps: NDArray[np.intp]) -> Array:
    """Variance of positions, shape (n,), from how many are at each."""
    total = np.maximum(counts.sum(axis=1), 1)
    mean = (counts * steps).sum(axis=1) / total
    return np.asarray((counts * (steps - mean[:, None]) ** 2).sum(axis=1) / total + 1.0 / 12.0)
