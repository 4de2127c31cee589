"""Candidates in the full frame: the highest pixel near each coarse peak, single pixels, saturated patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.detection import DARK_NEIGHBORS, SINGLE_PIXEL_SIGMA
from mountnav.measuring.fast.coarse import CoarsePeaks
from mountnav.measuring.fast.moments import Patches, Pixels
from mountnav.measuring.fast.scene import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SURROUND_PX = 4
_WIDTH_STARS = 120
_LARGE_PX2 = 12.0
_LARGE_PERCENT = 40.0  # blends and streaks only add
_WIDTH_HALVES_PX = (12, 24)
_FULL_HALF_PX = 20
_MOST_FULL = 60
_THICK = 0.7


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

    def part(self, some: NDArray[np.intp] | Mask) -> Candidates:
        """Some of them."""
        return Candidates(
            self.x_px[some],
            self.y_px[some],
            self.top[some],
            self.height[some],
            self.flux[some],
            self.lone[some],
        )


def locate(scene: Scene, peaks: CoarsePeaks) -> tuple[Candidates, Patches]:
    """Look at the full frame where the coarse plane has peaks.

    Parameters
    ----------
    scene : Scene
    peaks : CoarsePeaks

    Returns
    -------
    Candidates
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
    scene : Scene
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
        typical = float(np.median(area))
        if typical > _LARGE_PX2:
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
    which = np.flatnonzero(top >= scene.full_adu)[:_MOST_FULL]
    patches = scene.cut(x_px[which], y_px[which], _FULL_HALF_PX)
    mask = patches.values >= scene.full_adu
    steps = np.arange(patches.side_px)
    columns, rows = mask.sum(axis=1), mask.sum(axis=2)
    tall = np.sqrt(_spread(rows, steps) / _spread(columns, steps))
    thick = mask & (rows > _THICK * rows.max(axis=1)[:, None])[:, :, None]
    thick &= (columns > _THICK * columns.max(axis=1)[:, None])[:, None, :]
    area = np.maximum(thick.sum(axis=(1, 2)), 1)
    x = (thick.sum(axis=1) * steps).sum(axis=1) / area
    y = (thick.sum(axis=2) * steps).sum(axis=1) / area
    return SaturatedPatches(which, np.sqrt(area / np.pi), patches.left + x, patches.top + y, tall)


def _spread(counts: NDArray[np.intp], steps: NDArray[np.intp]) -> Array:
    """Variance of positions, shape (n,), from how many are at each."""
    total = np.maximum(counts.sum(axis=1), 1)
    mean = (counts * steps).sum(axis=1) / total
    return np.asarray((counts * (steps - mean[:, None]) ** 2).sum(axis=1) / total + 1.0 / 12.0)
