"""The middle of a frame, searched as a frame of its own, where a lens is too wide or bent for the whole."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mountnav.frames import Hint
from mountnav.identification.plate import Plate
from mountnav.identification.selection import Index
from mountnav.identification.verification import Identified
from mountnav.measuring.measurements import Measurements

MIDDLE_SHARES = (0.4, 0.27, 0.18)
"""Sides of the middle, in the frame's shorter side. Of fields of 54° to 150° these are 20° to 55°, 13° to
37°, 9° to 25°; the search is promised for 40°, and finds bent lenses up to 20° with ease. Of eight lists of
150° seven are found; with 0.4 and 0.2 alone, six."""
LEAST_SOURCES = 12
"""With fewer sources in the middle nothing is searched: four make a quad, five more have to confirm it."""
SEARCHED_PX = 1000.0
"""The middle is looked at as if it had so many pixels a side: limits of the search that are stated in pixels,
its coarsest scale among them, are made for frames, not for stamps. Chosen by hand."""


@dataclass(frozen=True, slots=True)
class Middle:
    """The sources of a frame's middle.

    Attributes
    ----------
    measurements : Measurements
        In pixels of the middle, `zoom` times as fine as the frame's.
    of_frame : ndarray of int
        Which of the frame's measurements each is.
    left_px, low_px : int
        The middle's first pixel in the frame.
    """

    measurements: Measurements
    of_frame: Index
    left_px: int
    low_px: int
    width_px: int
    height_px: int
    zoom: float

    def hint(self, hint: Hint) -> Hint:
        """What is believed of the frame, said of its middle; alternatives likewise."""

        def finer(one: Hint) -> Hint:
            low, high = one.scale_low_arcsec_px, one.scale_high_arcsec_px
            return replace(
                one,
                scale_low_arcsec_px=None if low is None else low / self.zoom,
                scale_high_arcsec_px=None if high is None else high / self.zoom,
            )

        return replace(finer(hint), alternatives=tuple(map(finer, hint.alternatives)))

    def native(self, found: Identified, measurements: Measurements) -> tuple[Identified, Measurements]:
        """A solution of the middle in pixels as fine as the frame's, and the measurements it points into."""
        assert found.reference is not None
        plate = _zoomed(found.reference.plate, 1.0 / self.zoom)
        own = _chosen(measurements, self.of_frame)
        own = replace(
            own,
            x_px=own.x_px - self.left_px,
            y_px=own.y_px - self.low_px,
            width_px=self.width_px,
            height_px=self.height_px,
        )
        return replace(found, reference=replace(found.reference, plate=plate)), own

    def in_frame(self, plate: Plate) -> Plate:
        """A plate of the middle, as fine as the frame, in the frame's pixels."""
        return replace(
            plate, center_x_px=plate.center_x_px + self.left_px, center_y_px=plate.center_y_px + self.low_px
        )


def middle_of(measurements: Measurements, share: float) -> Middle | None:
    """The middle of a frame; None where it has too few sources.

    Parameters
    ----------
    share : float
        Its side, in the frame's shorter side. It is a square about the frame's center.
    """
    width, height = measurements.width_px, measurements.height_px
    side = share * min(width, height)
    # as odd or even as the frame: the centers are the same then
    across, up = (2 * math.ceil(0.5 * (side - whole % 2)) + whole % 2 for whole in (width, height))
    left, low = (width - across) // 2, (height - up) // 2
    x, y = measurements.x_px - left, measurements.y_px - low
    inside = np.flatnonzero((x > 0) & (x < across - 1) & (y > 0) & (y < up - 1))
    if inside.size < LEAST_SOURCES:
        return None
    zoom = max(1.0, SEARCHED_PX / min(across, up))
    m = _chosen(measurements, inside)
    finer = replace(
        m,
        # the middle of the first pixel is 0 on both grids
        x_px=(x[inside] + 0.5) * zoom - 0.5,
        y_px=(y[inside] + 0.5) * zoom - 0.5,
        x_sigma_px=m.x_sigma_px * zoom,
        y_sigma_px=m.y_sigma_px * zoom,
        fwhm_px=m.fwhm_px * zoom,
        width_px=round(across * zoom),
        height_px=round(up * zoom),
    )
    return Middle(finer, inside, left, low, across, up, zoom)


def _zoomed(plate: Plate, factor: float) -> Plate:
    """The same plate on pixels that are `factor` times as fine."""
    return replace(
        plate,
        center_x_px=(plate.center_x_px + 0.5) * factor - 0.5,
        center_y_px=(plate.center_y_px + 0.5) * factor - 0.5,
        unit_px=plate.unit_px * factor,
    )


def _chosen(m: Measurements, which: Index) -> Measurements:
    return replace(
        m,
        x_px=m.x_px[which],
        y_px=m.y_px[which],
        x_sigma_px=m.x_sigma_px[which],
        y_sigma_px=m.y_sigma_px[which],
        flux=m.flux[which],
        flux_sigma=m.flux_sigma[which],
        fwhm_px=m.fwhm_px[which],
        ellipticity=m.ellipticity[which],
        flags=m.flags[which],
        elongation_deg=None if m.elongation_deg is None else m.elongation_deg[which],
    )
