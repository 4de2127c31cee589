"""What the doctor of catalogs finds: a camera, each catalog against it, the verdict and the advice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from mountnav.catalog.doctor.counts import FrameSize
from mountnav.catalog.doctor.known import Known
from mountnav.catalog.doctor.places import Reach

SUFFICIENT = 0.01
"""A catalog suffices when fewer of the fields fail."""
MARGINAL = 0.10
"""Up to here it is marginal: a second try some fields away helps."""


class Verdict(StrEnum):
    """Whether the catalogs suffice for a camera."""

    SUFFICES = "suffices"
    MARGINAL = "marginal"
    INSUFFICIENT = "insufficient"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """A camera of the settings, as far as it is known.

    Attributes
    ----------
    telescope : str
        Id in the settings.
    frame : FrameSize or None
        None when size or scale can't be told.
    width_px, height_px : int or None
    scale_arcsec_px : float or None
    size_from, scale_from, depth_from : str
        Where each comes from, for people.
    depth_is_estimate : bool
    problem : str or None
        What is missing, and what to set.
    """

    telescope: str
    frame: FrameSize | None
    width_px: int | None = None
    height_px: int | None = None
    scale_arcsec_px: float | None = None
    size_from: str = ""
    scale_from: str = ""
    depth_from: str = ""
    depth_is_estimate: bool = False
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class Check:
    """A catalog against a camera.

    Attributes
    ----------
    name, slug : str
    is_here : bool
        Its stars were counted; else they are the model's.
    stars : int
        In the whole catalog.
    pole, median, plane : float
        Stars per frame near the galactic pole, in the median over the reachable sky, near the plane. NaN
        where the catalog or the telescope reaches none of it.
    fails_share : float
        Of the reachable sky: fields that would not be solved, what the catalog has no sky for included.
    uncovered_share : float
        Of the reachable sky: what the catalog has no sky for.
    places : int
        Number of fields that were looked at.
    known : Known or None
    """

    name: str
    slug: str
    is_here: bool
    stars: int
    pole: float
    median: float
    plane: float
    fails_share: float
    uncovered_share: float
    places: int
    known: Known | None = None

    @property
    def verdict(self) -> Verdict:
        """By the share of fields that fail."""
        return verdict_of(self.fails_share)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What the doctor says of a camera.

    Attributes
    ----------
    camera : CameraFacts
    reach : Reach
        The sky that counts.
    here : tuple of Check
        Each catalog on this machine, the best first.
    together : float
        Share of the reachable fields that fail with the best of these for each; NaN if the camera is unknown.
    verdict : Verdict
        Of all of these together.
    remedies : tuple of Check
        Catalogs that would suffice: the smallest, then the most precise if it is another. If none would, the
        one that comes nearest.
    advice : tuple of str
        What to do, one sentence each; empty if nothing need be done.
    """

    camera: CameraFacts
    reach: Reach
    here: tuple[Check, ...]
    together: float
    verdict: Verdict
    remedies: tuple[Check, ...]
    advice: tuple[str, ...]


def verdict_of(fails_share: float) -> Verdict:
    """Judge a share of failing fields."""
    if math.isnan(fails_share):
        return Verdict.UNKNOWN
    if fails_share < SUFFICIENT:
        return Verdict.SUFFICES
    return Verdict.MARGINAL if fails_share < MARGINAL else Verdict.INSUFFICIENT
