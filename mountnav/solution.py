"""Solution: what a solved frame says, and Verdict: solved, or why not."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from mountnav.sky.coordinates import Icrs


class Reason(StrEnum):
    """Why a frame was not solved."""

    TOO_FEW_MEASUREMENTS = "too few stars measured"
    TOO_FEW_CATALOG_STARS = "too few catalog stars here for a field this size"
    NO_MATCH = "stars enough, but no arrangement matches the catalog"
    CHANCE = "the best match could be chance"
    NO_HINT = "no position or scale hint, and none in the header"
    BAD_FRAME = "no usable image"
    TIMED_OUT = "out of time"


@dataclass(frozen=True, slots=True)
class Times:
    """Wall seconds spent."""

    read_s: float = 0.0
    measure_s: float = 0.0
    identify_s: float = 0.0
    total_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Solution:
    """A frame's place in the sky.

    Attributes
    ----------
    center : Icrs
        The place of the frame's geometric center, pixel ((W-1)/2, (H-1)/2) 0-based.
    center_sigma_arcsec : float
        Its one-sigma error per coordinate.
    scale_arcsec_px : float
        sqrt(|det CD|) at the center.
    rotation_deg : float
        Position angle of the image's +y axis, east of north, [0, 360).
    parity : int
        +1: x right, y up shows east LEFT when north is up (the sky as seen); -1 mirrored.
    rms_arcsec : float
        RMS over pairs of the on-sky residual (both coordinates in quadrature).
    pairs, rejected : int
        Pairs in the fit, and pairs thrown out.
    false_probability : float
        Chance that a wrong place would have looked as good.
    mode : str
        Which identification and model: e.g. "full/cubic".
    wcs : dict
        FITS cards (1-based CRPIX), TAN or TAN-SIP.
    pair_x_px, pair_y_px, pair_dx_arcsec, pair_dy_arcsec : ndarray, shape (pairs,)
        Where the pairs lie and their residuals (ξ, η: measured minus catalog).
    catalog : str
        Which catalog was used.
    """

    center: Icrs
    center_sigma_arcsec: float
    scale_arcsec_px: float
    rotation_deg: float
    parity: int
    rms_arcsec: float
    pairs: int
    rejected: int
    false_probability: float
    mode: str
    wcs: dict[str, str | int | float]
    pair_x_px: NDArray[np.float64]
    pair_y_px: NDArray[np.float64]
    pair_dx_arcsec: NDArray[np.float64]
    pair_dy_arcsec: NDArray[np.float64]
    catalog: str = ""

    def icrs_at(self, x_px: float, y_px: float) -> Icrs:
        """The place at a pixel (0-based), through the WCS: never read CRVAL as the center."""
        from mountnav.identification.wcs import icrs_at_pixel

        return icrs_at_pixel(self.wcs, x_px, y_px)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Solved (`solution` set) or not (`reason` set, `detail` with the numbers behind it)."""

    solution: Solution | None
    reason: Reason | None
    detail: str
    measured: int
    times: Times

    @property
    def solved(self) -> bool:
        """Whether there is a solution."""
        return self.solution is not None
