"""Cutouts: round cuttings of the frame at peaks, all in one array."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Cutouts:
    """Round cuttings at peaks.

    Attributes
    ----------
    values, variance : ndarray, shape (n, pixels)
        Background-subtracted pixels, and the variance of the sky noise in them.
    good : ndarray of bool, shape (n, pixels)
        False for missing, saturated and outlying pixels.
    dx, dy : ndarray, shape (pixels,)
        Pixel positions relative to the cutout's center.
    x0, y0 : ndarray, shape (n,)
        The center pixels' positions in the frame.
    """

    values: Array
    variance: Array
    good: NDArray[np.bool_]
    dx: Array
    dy: Array
    x0: Array
    y0: Array

    def part(self, some: NDArray[np.bool_]) -> Cutouts:
        """Those of some sources."""
        return replace(
            self,
            values=self.values[some],
            variance=self.variance[some],
            good=self.good[some],
            x0=self.x0[some],
            y0=self.y0[some],
        )


def make_cutouts(
    sky_free: Image, good: NDArray[np.bool_], x_px: Array, y_px: Array, noise: Array, half_px: int
) -> Cutouts:
    """Cut discs of radius ``half_px`` at positions; what hangs over the frame's edge is not good.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    good : ndarray of bool, shape (height, width)
        Pixels that may be used.
    x_px, y_px, noise : ndarray, shape (n,)
        Positions, and the sky noise per pixel at them.
    """
    height, width = sky_free.shape
    offset = np.arange(-half_px, half_px + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(offset, offset, indexing="ij"))
    disc = np.hypot(dx, dy) <= half_px + 0.5
    dx, dy = dx[disc], dy[disc]
    x0, y0 = np.rint(x_px).astype(int), np.rint(y_px).astype(int)
    columns, rows = x0[:, None] + dx, y0[:, None] + dy
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    flat = np.clip(rows, 0, height - 1) * width + np.clip(columns, 0, width - 1)
    return Cutouts(
        values=sky_free.ravel()[flat].astype(np.float64),
        variance=np.broadcast_to((noise * noise)[:, None], flat.shape),
        good=inside & good.ravel()[flat],
        dx=dx.astype(np.float64),
        dy=dy.astype(np.float64),
        x0=x0.astype(np.float64),
        y0=y0.astype(np.float64),
    )
