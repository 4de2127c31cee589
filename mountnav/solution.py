"""Solution of a frame with its WCS, and Verdict: the solution, or the reason for none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.measurements import SkyQuality
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs import icrs_at_pixel

Array = NDArray[np.float64]


class Reason(StrEnum):
    """Why a frame was not solved."""

    TOO_FEW_MEASUREMENTS = "too few stars measured"
    NO_MATCH = "stars enough, but no arrangement matches the catalog"
    CHANCE = "the best match could be chance"
    CLOUD_OR_DEFOCUS = "cloud, dew or defocus: far fewer or far wider stars than the catalog promises"
    TRAILED = "the stars' light is drawn out or doubled, and its middle can't be told"
    HINT_CONTRADICTS = "the hints contradict each other"
    CATALOG_TOO_SHALLOW = "field too narrow for the installed catalogs"
    OTHER_CATALOG = "found by the index, but not in the catalogs that were ordered"
    NO_HINT = "no position hint, none in the header, and no blind search"
    BAD_FRAME = "no usable image"
    TIMED_OUT = "out of time"

    @property
    def whole_sky_may_help(self) -> bool:
        """Whether the frame may be found blind where its hint failed: not without stars."""
        return self not in (Reason.BAD_FRAME, Reason.TOO_FEW_MEASUREMENTS, Reason.OTHER_CATALOG)


@dataclass(frozen=True, slots=True)
class Times:
    """Wall seconds spent."""

    read_s: float = 0.0
    measure_s: float = 0.0
    identify_s: float = 0.0
    total_s: float = 0.0


@dataclass(frozen=True, slots=True)
class IdentifiedPairs:
    """Measurements and the stars they are; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Measured places, 0-based.
    ra_deg, dec_deg : ndarray
        The stars' ICRS places at the frame's epoch.
    dx_arcsec, dy_arcsec : ndarray
        Deviations measured minus catalog, east (with cos δ) and north: about the frame's center ξ and η.
    flux, flux_sigma : ndarray
        Measured, ADU.
    mag : ndarray
        The stars' magnitudes, in `band`.
    centroid_sigma_arcsec, catalog_sigma_arcsec : ndarray
        Expected errors per coordinate.
    flags : ndarray of int64
        The measurements' flags.
    used : ndarray of bool
        In the fit; False for those that were rejected by their deviation (K_rej).
    leverage : ndarray
        How much each pair holds the plate at its own position: its deviation is (1 - leverage) times the one
        from a plate that was fit without it. 0 for those not in the fit.
    color_mag : ndarray
        The stars' color index `color_name`; NaN where unknown.
    star_flags : ndarray of uint8
        What the catalog warns of: bits of `mountnav.catalog.stars.StarFlag`.
    band, color_name : str
        Which magnitudes and colors these are; empty if unknown.
    """

    x_px: Array
    y_px: Array
    ra_deg: Array
    dec_deg: Array
    dx_arcsec: Array
    dy_arcsec: Array
    flux: Array
    flux_sigma: Array
    mag: Array
    centroid_sigma_arcsec: Array
    catalog_sigma_arcsec: Array
    flags: NDArray[np.int64]
    used: NDArray[np.bool_]
    leverage: Array
    color_mag: Array = field(default_factory=lambda: np.zeros(0))
    star_flags: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    band: str = ""
    color_name: str = ""

    def __post_init__(self) -> None:
        # pairs without colors or flags needn't say so for each star
        if self.color_mag.size == 0:
            object.__setattr__(self, "color_mag", np.full(self.x_px.size, np.nan))
        if self.star_flags.size == 0:
            object.__setattr__(self, "star_flags", np.zeros(self.x_px.size, dtype=np.uint8))

    def __len__(self) -> int:
        return int(self.x_px.size)


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Where the residuals of the pairs in the fit come from; arcsec per coordinate, root mean square.

    Attributes
    ----------
    centroid_arcsec : float
        Noise of the measured positions.
    catalog_arcsec : float
        The catalog's own errors at the frame's epoch.
    other_arcsec : float
        What neither knows of: seeing, the camera's finer distortions, errors that were stated too small.
    """

    centroid_arcsec: float
    catalog_arcsec: float
    other_arcsec: float

    @property
    def expected_arcsec(self) -> float:
        """All parts together, in quadrature."""
        return float(np.sqrt(self.centroid_arcsec**2 + self.catalog_arcsec**2 + self.other_arcsec**2))

    @property
    def largest(self) -> str:
        """What limits the accuracy most: "centroid", "catalog" or "other"."""
        parts = {
            "centroid": self.centroid_arcsec,
            "catalog": self.catalog_arcsec,
            "other": self.other_arcsec,
        }
        return max(parts, key=parts.__getitem__)


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A hint that the solved frame disproves, or two hints that disprove each other.

    Attributes
    ----------
    about : str
        "scale" or "center".
    source : str
        Who said it: "FOCALLEN and XPIXSZ", "OBJCTRA", "caller".
    said, found : str
        With units, for people.
    """

    about: str
    source: str
    said: str
    found: str

    def __str__(self) -> str:
        return f"{self.about}: {self.source} says {self.said}, found {self.found}"


@dataclass(frozen=True, slots=True)
class Solution:
    """A frame's position in the sky.

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
        Chance that a wrong position would have looked as good.
    mode : str
        Which identification and model: e.g. "full/cubic", or "blind/linear" when it was found over the whole
        sky, not where the hint said.
    wcs : dict
        FITS cards (1-based CRPIX): TAN, TAN-SIP, or ZPN where a lens is too wide for these.
    center_covariance_arcsec2 : ndarray, shape (2, 2)
        Of the center's position: east, north.
    identified : IdentifiedPairs
        The pairs, those in the fit and those rejected by their deviation.
    rejected_by : dict
        How many candidate pairs each rule of [S23 §3] threw out, by the rule's name.
    catalog : str
        Which catalog was used.
    catalog_steps : tuple of str
        How that catalog's stars were come by: which one was chosen and why, what was tried and what failed.
    errors : ErrorBudget or None
        Where the residuals come from; None where only a shift was fit.
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
    center_covariance_arcsec2: Array
    identified: IdentifiedPairs
    rejected_by: dict[str, int] = field(default_factory=dict)
    catalog: str = ""
    catalog_steps: tuple[str, ...] = ()
    errors: ErrorBudget | None = None

    def icrs_at(self, x_px: float, y_px: float) -> Icrs:
        """The place at a pixel (0-based), through the WCS: never read CRVAL as the center."""
        return icrs_at_pixel(self.wcs, x_px, y_px)


SEEN_AT_MOST = 1000
"""Number of measured positions that a verdict carries along, the brightest: enough to draw over a frame."""


MOVED_KEY = "moved_px"
"""Among a verdict's numbers: how far the plate was moved to the middle of the light; absent where it
stayed."""


def _nothing_seen() -> NDArray[np.float32]:
    return np.zeros((0, 2), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a frame comes from, as its header says; empty where it doesn't.

    Attributes
    ----------
    instrument, telescope, field : str
        INSTRUME, TELESCOP and OBJECT, at most `MOST_CARD` printable characters of each.
    mid_exposure_utc : datetime or None
        None: the header doesn't say.
    """

    instrument: str = ""
    telescope: str = ""
    field: str = ""
    mid_exposure_utc: datetime | None = None


MOST_CARD = 68
"""Characters of a header's text that are kept: a FITS card holds no more. Doubled, long texts of other files
fill results."""


@dataclass(frozen=True, slots=True)
class PriorPart:
    """What was assumed of a frame from others of its camera.

    Attributes
    ----------
    frames : int
        From how many of them.
    scale_low_arcsec_px, scale_high_arcsec_px : float
        Between these the scale was sought first.
    held : bool
        The frame was solved so, and the odds are those of these scales alone; else it was solved, or not, as
        without any assumption, and the odds count what was tried in vain.
    """

    frames: int
    scale_low_arcsec_px: float
    scale_high_arcsec_px: float
    held: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """Solved (`solution` set) or not (`reason` set).

    Attributes
    ----------
    detail : str
        For people, with the numbers behind it.
    measured : int
        Sources measured; for a frame solved at a glance, those that the glance found.
    numbers : mapping
        The numbers behind the reason, by name with unit ("measured", "catalog_stars", "hypotheses", ...).
    contradictions : tuple of Contradiction
        Hints that turned out wrong; a wrong hint never makes a wrong answer.
    quality : SkyQuality or None
        What the frame shows of the night, solved or not.
    notes : tuple of str
        What else should be known of this verdict: masters that were not applied, a date that is unknown.
    seen_px : ndarray of float32, shape (n, 2)
        Where the sources lie that were measured, 0-based, brightest first, at most `SEEN_AT_MOST`.
    seen_flux : ndarray of float32, shape (n,)
        Their brightness, in the unit of the frame; NaN where a list of stars doesn't tell it.
    origin : Origin or None
        What the file's header says of where it comes from; None where no file was read.
    prior : PriorPart or None
        What was assumed from other frames of the same camera; None where nothing was.
    further : tuple of Solution
        Of a plate that was exposed several times: its other exposures.
    """

    solution: Solution | None
    reason: Reason | None
    detail: str
    measured: int
    times: Times
    numbers: Mapping[str, float] = field(default_factory=dict)
    contradictions: tuple[Contradiction, ...] = ()
    quality: SkyQuality | None = None
    notes: tuple[str, ...] = ()
    seen_px: NDArray[np.float32] = field(default_factory=_nothing_seen, compare=False, repr=False)
    seen_flux: NDArray[np.float32] = field(
        default_factory=lambda: np.zeros(0, dtype=np.float32), compare=False, repr=False
    )
    origin: Origin | None = field(default=None, compare=False)
    prior: PriorPart | None = None
    further: tuple[Solution, ...] = ()

    @property
    def solved(self) -> bool:
        """Whether there is a solution."""
        return self.solution is not None

    @property
    def moved(self) -> bool:
        """Whether the plate was moved from where its sources were found to the middle of their light."""
        return MOVED_KEY in self.numbers

    @property
    def apart_px(self) -> float:
        """How far apart a tube that moved in the exposure has put each star's light; 0 where it rested.

        The plate was moved by a half of that, from one end to the middle.
        """
        return 2.0 * self.numbers.get(MOVED_KEY, 0.0)
