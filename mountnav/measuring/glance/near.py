"""The source nearest to each of many places, told from noise, and what else shines close by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.glance.candidates import single_pixels, smoothed
from mountnav.measuring.glance.coarse import SMOOTHED_NOISE
from mountnav.measuring.glance.scene import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROOM_PX = 0.5
_LEAST_SHARE = 0.03


@dataclass(frozen=True, slots=True)
class Near:
    """Sources near places.

    Attributes
    ----------
    x_px, y_px : ndarray, shape (n,)
        The highest pixel's place, refined by a parabola.
    top : ndarray, shape (n,)
        The highest pixel.
    lone : ndarray of bool, shape (n,)
        Single bright pixels.
    other_x_px, other_y_px : ndarray, shape (m,)
        Further maxima close to them, the highest, no more than there are places.
    """

    x_px: Array
    y_px: Array
    top: Array
    lone: Mask
    other_x_px: Array
    other_y_px: Array


def sources_near(
    scene: Scene, x_px: Array, y_px: Array, reach_px: float, around_px: int, threshold_sigma: float
) -> Near:
    """Find the most likely source within reach of each place.

    Of several it is the one that has the fewest rivals: sources grow in number as they get fainter, and with
    the area, so that the square of the distance over the height tells how many would lie there by chance.

    Parameters
    ----------
    scene : Scene
    x_px, y_px : ndarray, shape (n,)
        Places inside the frame.
    reach_px : float
    around_px : int
        How far from the place further maxima are looked for.
    threshold_sigma : float
        Height of a source in the smoothed patch, in units of its noise.

    Returns
    -------
    Near
        Of the places that have one; not in their order.
    """
    patches = scene.cut(x_px, y_px, max(int(np.ceil(reach_px)), around_px) + 2)
    ground = patches.ground()
    smooth = smoothed(patches.values)
    inner = smooth[:, 1:-1, 1:-1]
    peak = inner > (ground + threshold_sigma * SMOOTHED_NOISE * scene.noise_at(x_px, y_px))[:, None, None]
    side = smooth.shape[1]
    for dy, dx in ((0, 1), (1, -1), (1, 0), (1, 1)):
        peak &= inner >= smooth[:, 1 + dy : side - 1 + dy, 1 + dx : side - 1 + dx]
        peak &= inner > smooth[:, 1 - dy : side - 1 - dy, 1 - dx : side - 1 - dx]
    which, row, column = np.nonzero(peak)
    height = inner[which, row, column] - ground[which]
    # two pixels were lost: one by smoothing, one as neighbors
    x = (patches.left[which] + column + 2).astype(np.float64)
    y = (patches.top[which] + row + 2).astype(np.float64)
    shift_x, shift_y = _parabola(smooth, which, row + 1, column + 1)
    x, y = x + shift_x, y + shift_y
    away = np.hypot(x - x_px[which], y - y_px[which])
    within = away <= reach_px
    rivals = np.where(within, (away**2 + _ROOM_PX**2) / np.maximum(height, 1e-12), np.inf)
    order = np.lexsort((rivals, which))
    first = order[np.r_[True, which[order][1:] != which[order][:-1]]] if order.size else order
    first = first[within[first]]
    chosen = np.full(x_px.size, -1)
    chosen[which[first]] = first
    mine = chosen[which]
    other = (mine >= 0) & (mine != np.arange(which.size))
    other &= height > _LEAST_SHARE * height[mine]
    others = np.flatnonzero(other)
    others = others[np.argsort(-height[others], kind="stable")][: first.size]
    top, lone = single_pixels(
        patches.values[which[first]],
        row[first] + 2,
        column[first] + 2,
        ground[which[first]],
        scene.noise_adu,
    )
    return Near(x[first], y[first], top.astype(np.float64), lone, x[others], y[others])


def _parabola(
    smooth: NDArray[np.float32], which: NDArray[np.intp], row: NDArray[np.intp], column: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Offset of the top of parabolas through the maxima and their neighbors, within half a pixel."""
    here = smooth[which, row, column].astype(np.float64)
    shifts = []
    for dy, dx in ((0, 1), (1, 0)):
        after, before = smooth[which, row + dy, column + dx], smooth[which, row - dy, column - dx]
        bend = np.maximum(2.0 * here - after - before, 1e-9)
        shifts.append(np.clip(0.5 * (after - before) / bend, -0.5, 0.5))
    return shifts[0], shifts[1]
