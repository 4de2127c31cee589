"""What a glance saw, and the precise fits at places that someone asks for afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.glance.learning import learn_shape
from mountnav.measuring.glance.scene import Scene
from mountnav.measuring.glance.star_image import StarImage
from mountnav.measuring.glance.wanted import measured_near, quality_of
from mountnav.measuring.measurements import Measurements
from mountnav.measuring.quality import SkyQuality
from mountnav.measuring.settings import MeasuringSettings

Array = NDArray[np.float64]

_DISC_FWHM = 1.25


@dataclass(slots=True)
class Glance:
    """The brightest sources of a frame, and the means to measure any of its sources precisely.

    Attributes
    ----------
    measurements : Measurements
        Brightest first, rough places; ``quality`` is None.
    scene : Scene
        The frame, and what was found out about it.
    settings : MeasuringSettings
    """

    measurements: Measurements
    scene: Scene
    settings: MeasuringSettings
    _learned: tuple[StarImage, SkyQuality] | None = field(default=None, repr=False)

    def measured_at(self, x_px: Array, y_px: Array, *, reach_px: float) -> Measurements:
        """Fit the sources found within reach of places, with the shape that the frame's stars share.

        Parameters
        ----------
        x_px, y_px : ndarray, shape (n,)
            Where sources are expected; places outside the frame are passed over.
        reach_px : float
            How far from the place a source may be.

        Returns
        -------
        Measurements
            Brightest first, each source once, with ``quality``; possibly none.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            image, quality = self._learn()
            x, y = np.asarray(x_px, dtype=np.float64), np.asarray(y_px, dtype=np.float64)
            return measured_near(self.scene, image, quality, x, y, reach_px, self.settings.threshold_sigma)

    def _learn(self) -> tuple[StarImage, SkyQuality]:
        """The common star and the frame's quality, found out when they are first wanted."""
        if self._learned is None:
            half = int(np.clip(np.ceil(_DISC_FWHM * self.scene.fwhm_px), 4, 12))
            shape, _ = learn_shape(self.scene, self.measurements, half)
            quality = quality_of(self.scene, shape, self.measurements, self.settings, half)
            self._learned = StarImage.of(shape, half), quality
        return self._learned
