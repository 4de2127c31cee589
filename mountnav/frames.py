"""Frame: pixels, mid-exposure UTC, header facts; StarList: stars that others measured."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.coordinates import Icrs


@dataclass(frozen=True, slots=True)
class Hint:
    """What is believed about a frame before it is solved. None means not known.

    Attributes
    ----------
    center : Icrs or None
        Believed place of the frame's geometric center.
    radius_deg : float
        How far off `center` may be.
    scale_low_arcsec_px, scale_high_arcsec_px : float or None
        Between what bounds the scale lies.
    center_source, scale_source : str
        Who says so ("caller", "OBJCTRA", "FOCALLEN and XPIXSZ", ...); for the report of a contradiction.
    alternatives : tuple of Hint
        Other readings of the same words, to be tried after this one fails: right ascension in hours or
        degrees, pixels counted with or without binning. None of them has alternatives of its own.
    """

    center: Icrs | None = None
    radius_deg: float = 1.0
    scale_low_arcsec_px: float | None = None
    scale_high_arcsec_px: float | None = None
    center_source: str = "caller"
    scale_source: str = "caller"
    alternatives: tuple[Hint, ...] = ()


@dataclass(frozen=True, slots=True)
class Frame:
    """One exposed image.

    Attributes
    ----------
    pixels : ndarray, shape (height, width)
        In file order: row 0 is FITS row 1. Any real dtype; NaN marks missing pixels.
    mid_exposure_utc : datetime or None
        Aware UTC instant of mid-exposure.
    exposure_s : float or None
        Exposure time; None: the header doesn't say.
    saturation_adu : float or None
        Level from which a pixel counts as saturated; None: to be guessed from the data.
    hint : Hint
        What the header says.
    source : str
        File name, or which camera it came from.
    header : dict
        The header's cards as plain values, for callers that want more.
    mosaic : bool
        The pixels are a raw Bayer mosaic: `mountnav.reading.demosaiced` evens it out before measuring.
    notes : tuple of str
        What else should be known of the file: other images that it holds.
    """

    pixels: NDArray[np.generic]
    mid_exposure_utc: datetime | None = None
    exposure_s: float | None = None
    saturation_adu: float | None = None
    hint: Hint = field(default_factory=Hint)
    source: str = "frame"
    header: dict[str, str | int | float | bool] = field(default_factory=dict)
    mosaic: bool = False
    notes: tuple[str, ...] = ()

    @property
    def width_px(self) -> int:
        """Number of columns."""
        return int(self.pixels.shape[1])

    @property
    def height_px(self) -> int:
        """Number of rows."""
        return int(self.pixels.shape[0])


@dataclass(frozen=True, slots=True)
class StarList:
    """Stars that somebody else measured in a frame that isn't at hand. Arrays have shape (n,), n may be 0.

    Attributes
    ----------
    x_px, y_px : ndarray of float64
        0-based, y along the rows of the frame's file as in `Frame.pixels`.
    flux : ndarray of float64
        The larger, the brighter; any unit, NaN where unknown. Ranks are only roughly those of the sky.
    width_px, height_px : int
        Of the frame.
    hint : Hint
        What the list's header says.
    source : str
        File name.
    """

    x_px: NDArray[np.float64]
    y_px: NDArray[np.float64]
    flux: NDArray[np.float64]
    width_px: int
    height_px: int
    hint: Hint = field(default_factory=Hint)
    source: str = "star list"
