"""The frame as it is searched for: its measurements, and what is known of its scale and place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import unit_vectors
from mountnav.identification.blind.placing import Placed
from mountnav.identification.full import Points
from mountnav.identification.plate import ARCSEC_PER_RAD
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SCALES = (0.3, 200.0)
"""Arcsec per pixel, where none is known."""
KNOWN_SCALE = 1.5
"""Bounds within this factor tell how wide the frame is."""
WIDEST_DEG = 76.0
"""No frame diagonal beyond this is believed: 40° by 60° has one of 68.6°."""
MOST_POINTS = 300
"""So many of the brightest measurements are asked whether other stars fall on them."""


@dataclass(frozen=True, slots=True)
class View:
    """A frame, and what is known of it.

    Attributes
    ----------
    z : ndarray of complex, shape (n,)
        The brightest measurements, x + iy in pixels, brightest first.
    tree : cKDTree
        The same.
    width_px, height_px : int
    scales : (float, float)
        Bounds, arcsec per pixel.
    axis : ndarray, shape (3,), or None
        The frame's center lies within `radius_rad` of it.
    radius_rad : float
    reach_px : float
        No star is said to fall on a measurement farther off than that.
    """

    z: Complex
    tree: cKDTree
    width_px: int
    height_px: int
    scales: tuple[float, float]
    axis: Array | None
    radius_rad: float
    reach_px: float

    @classmethod
    def of(
        cls,
        points: Points,
        scales: tuple[float, float] | None,
        center: Icrs | None,
        radius_deg: float,
        reach_px: float,
    ) -> View:
        """A frame with these points; bounds beyond 0.3 to 200 ″/px are drawn in."""
        low, high = scales or SCALES
        x, y = points.x_px[:MOST_POINTS], points.y_px[:MOST_POINTS]
        return cls(
            z=x + 1j * y,
            tree=cKDTree(np.column_stack((x, y))),
            width_px=points.width_px,
            height_px=points.height_px,
            scales=(max(low, SCALES[0]), min(high, SCALES[1])),
            axis=None
            if center is None or radius_deg >= 180.0
            else unit_vectors(center.ra_deg, center.dec_deg),
            radius_rad=math.radians(radius_deg),
            reach_px=reach_px,
        )

    @property
    def center(self) -> complex:
        """The frame's center in pixels."""
        return complex((self.width_px - 1) / 2, (self.height_px - 1) / 2)

    @property
    def diagonal_px(self) -> float:
        """Corner to corner."""
        return math.hypot(self.width_px, self.height_px)

    @property
    def scale_known(self) -> bool:
        """Whether the scale's bounds tell how wide the frame is."""
        return self.scales[1] <= KNOWN_SCALE * self.scales[0]

    def focal_px(self, side_deg: float) -> float | None:
        """Focal length in pixels by the scale if known, or by a supposed shorter side; None: infinite."""
        if self.scale_known:
            return ARCSEC_PER_RAD / math.sqrt(self.scales[0] * self.scales[1])
        if side_deg > 0.0:
            return 0.5 * min(self.width_px, self.height_px) / math.tan(math.radians(0.5 * side_deg))
        return None

    def inside(self, place: Complex) -> NDArray[np.bool_]:
        """Which places lie in the frame; NaN doesn't."""
        x, y = place.real, place.imag
        within: NDArray[np.bool_] = (x > 0) & (x < self.width_px - 1) & (y > 0) & (y < self.height_px - 1)
        return within

    def possible(self, fit: Placed) -> NDArray[np.bool_]:
        """Which similarities agree with what is known of scale and place, and are a camera's at all."""
        scale = np.abs(fit.turn)
        good = (scale >= 0.99 * self.scales[0]) & (scale <= 1.01 * self.scales[1])
        good &= scale * self.diagonal_px <= 2.0 * math.tan(math.radians(0.5 * WIDEST_DEG)) * ARCSEC_PER_RAD
        if self.axis is not None:
            away = 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(((fit.axis - self.axis) ** 2).sum(axis=1)), 1.0))
            good &= away <= self.radius_rad
        return good
