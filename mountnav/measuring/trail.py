"""A trail as a value: a long thin bright thing that may bend a little, and the pixels it covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trail:
    """A long thin bright thing that may bend a little; lengths in pixels of the frame.

    Attributes
    ----------
    x_px, y_px : float
        Its origin, from which places along it are counted.
    along_x, along_y : float
        Unit direction.
    bend : tuple of three float
        Offset towards the normal (-along_y, along_x) at t along: bend[0] + bend[1] t + bend[2] t².
    start_px, end_px : float
        Where along the direction it begins and ends.
    half_width_px : float
        Half of the width over which it is brighter than the sky's noise.
    height : float
        How far its ridge rises, in units of the smoothed frame's noise.
    spike : bool
        It is a bright star's own: it fades away from the star.
    """

    x_px: float
    y_px: float
    along_x: float
    along_y: float
    bend: tuple[float, float, float]
    start_px: float
    end_px: float
    half_width_px: float
    height: float
    spike: bool

    @property
    def length_px(self) -> float:
        """From end to end."""
        return self.end_px - self.start_px

    @property
    def along_axis(self) -> bool:
        """It runs exactly along a column or row: charge that ran over, or pixels that are bad."""
        ends = np.array(self.places(np.array([self.start_px, self.end_px])))
        return bool(np.abs(ends[:, 1] - ends[:, 0]).min() < max(1.0, 0.004 * self.length_px))

    def places(self, along_px: Array) -> tuple[Array, Array]:
        """Return x and y, each of shape (n,), of places on its ridge."""
        side = self.bend[0] + along_px * (self.bend[1] + along_px * self.bend[2])
        x = self.x_px + along_px * self.along_x - side * self.along_y
        return x, self.y_px + along_px * self.along_y + side * self.along_x

    def touches(self, x_px: Array, y_px: Array, margin_px: float) -> NDArray[np.bool_]:
        """Tell which places, shape (n,), lie on it or within a margin of it."""
        dx, dy = x_px - self.x_px, y_px - self.y_px
        along = dx * self.along_x + dy * self.along_y
        across = dy * self.along_x - dx * self.along_y
        across = across - (self.bend[0] + along * (self.bend[1] + along * self.bend[2]))
        return np.asarray(
            (along > self.start_px - margin_px)
            & (along < self.end_px + margin_px)
            & (np.abs(across) < self.half_width_px + margin_px)
        )

    def pixels(self, height_px: int, width_px: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the pixels that it covers in a frame of a size; some may come twice."""
        along = np.arange(self.start_px - 1.0, self.end_px + 1.5, 0.7)
        across = np.arange(-self.half_width_px, self.half_width_px + 0.5, 0.7)
        middle = self.bend[0] + along * (self.bend[1] + along * self.bend[2])
        side = middle[:, None] + across[None, :]
        x = np.rint(self.x_px + along[:, None] * self.along_x - side * self.along_y).astype(int).ravel()
        y = np.rint(self.y_px + along[:, None] * self.along_y + side * self.along_x).astype(int).ravel()
        inside = (x >= 0) & (x < width_px) & (y >= 0) & (y < height_px)
        return y[inside], x[inside]
