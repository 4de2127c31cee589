"""What orders report while they run and at their end, as JSON models: looks, points, drifts, models.

Positions are shown in the ICRS and in the mount's own frame; numbers are finite or null.
"""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field, JsonValue

from api.solver.solve_record import SolveRecord
from mountnav.devices import Epoch, for_mount
from mountnav.sky.coordinates import Apparent, Icrs

__all__ = [
    "Attempt",
    "AttemptView",
    "DriftView",
    "Finite",
    "FollowLookView",
    "FollowView",
    "ModelRunView",
    "OffsetView",
    "Place",
    "PointView",
    "SeriesLookView",
    "SeriesView",
    "SkyEventView",
    "SolvedView",
    "TermView",
    "mount_place",
    "place",
]


def _finite_or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


Finite = Annotated[float | None, BeforeValidator(_finite_or_none)]


class Place(BaseModel):
    """A place in the sky; `utc` is the date of an apparent one."""

    ra_deg: Finite
    dec_deg: Finite
    frame: Literal["icrs", "jnow-apparent"]
    utc: datetime | None = None


class OffsetView(BaseModel):
    """Seen minus believed, on the sphere."""

    east_arcsec: Finite
    north_arcsec: Finite
    total_arcsec: Finite


def place(where: Icrs | Apparent) -> Place:
    """View of a place."""
    if isinstance(where, Apparent):
        return Place(ra_deg=where.ra_deg, dec_deg=where.dec_deg, frame="jnow-apparent", utc=where.utc)
    return Place(ra_deg=where.ra_deg, dec_deg=where.dec_deg, frame="icrs")


def mount_place(where: Icrs, epoch: Epoch | None, utc: datetime | None) -> Place | None:
    """A place as the mount counts it; None where its frame is not known.

    Parameters
    ----------
    epoch : {"apparent", "icrs"} or None
        The mount's.
    utc : datetime or None
        For an apparent place.
    """
    return None if epoch is None or utc is None else place(for_mount(where, epoch, utc))


class AttemptView(BaseModel):
    """One look of a centering, and what was done about it."""

    kind: Literal["look"] = "look"
    number: int
    ra_deg: Finite
    dec_deg: Finite
    error_arcsec: Finite
    east_arcsec: Finite
    north_arcsec: Finite
    pairs: int
    rms_arcsec: Finite
    false_probability: Finite
    synced: bool
    sync_outcome: str | None
    slewed: bool
    elapsed_s: Finite
    after_arcsec: Finite | None = Field(default=None, description="The error that the next look found")
    expected_arcsec: Finite | None = Field(default=None, description="How far off it was expected, one sigma")
    sigma_arcsec: Finite | None = Field(default=None, description="Of the error that was seen")
    correction: str | None = Field(default=None, description="none, sync, offset or model")
    why: str | None = Field(
        default=None, description="What was decided and by what numbers; or why it stopped"
    )
    followed: str | None = Field(default=None, description="Whether the tube did what the try before asked")
    approached: bool | None = Field(default=None, description="Whether the last leg came from the fixed side")
    look_id: str | None = None


class SeriesLookView(BaseModel):
    """One look of a series."""

    kind: Literal["series-look"] = "series-look"
    number: int
    solved: bool
    mid_exposure_utc: datetime | None = None
    ra_deg: Finite = Field(default=None, description="Solved, ICRS")
    dec_deg: Finite = None
    sigma_arcsec: Finite = None
    east_arcsec: Finite = Field(default=None, description="From the first solved look")
    north_arcsec: Finite = None
    pairs: int | None = None
    look_id: str | None = None
    problem: str | None = Field(default=None, description="Why it was not solved")
    elapsed_s: Finite = None


class PointView(BaseModel):
    """One point of a model run."""

    kind: Literal["point"] = "point"
    number: int
    of: int = Field(description="How many the run has")
    part: Literal["fit", "held-out", "fresh"] = Field(
        description="What it is for: fitting, judging, or the last check"
    )
    az_deg: Finite = Field(description="As planned")
    alt_deg: Finite
    solved: bool
    ra_deg: Finite = Field(default=None, description="Solved, ICRS")
    dec_deg: Finite = None
    east_arcsec: Finite = Field(default=None, description="Seen minus believed")
    north_arcsec: Finite = None
    error_arcsec: Finite = None
    sigma_arcsec: Finite = None
    pier_side: str | None = None
    look_id: str | None = None
    problem: str | None = Field(default=None, description="Why it has no look")
    elapsed_s: Finite = None


class FollowLookView(BaseModel):
    """One look while a target is followed."""

    kind: Literal["follow-look"] = "follow-look"
    number: int
    mid_exposure_utc: datetime
    look_id: str
    by: Literal["rates", "guide-pulses", "small-slews"]
    off_arcsec: Finite = Field(description="The solved center from the target, in the middle of the exposure")
    off_sigma_arcsec: Finite = None
    verdict: Literal["right", "too-early", "fault", "ambiguous", "unexplained"] | None = Field(
        default=None, description="Of the rates that the mount keeps"
    )
    fault: str | None = Field(default=None, description="What is wrong with them, by name")
    seen_ra_arcsec_s: Finite = Field(
        default=None, description="Measured rates beside the sidereal one, the mount's own coordinates"
    )
    seen_dec_arcsec_s: Finite = None
    seen_ra_sigma_arcsec_s: Finite = None
    seen_dec_sigma_arcsec_s: Finite = None
    ordered_ra_arcsec_s: Finite = Field(default=None, description="What it is to keep")
    ordered_dec_arcsec_s: Finite = None
    sent_ra_arcsec_s: Finite = Field(
        default=None, description="What it was sent for that: other numbers where a correction is in force"
    )
    sent_dec_arcsec_s: Finite = None
    left_s: Finite = None
    next_event: str = Field(default="", description="What comes next on the path")
    words: str = ""


class SkyEventView(BaseModel):
    """What was foretold of a path."""

    kind: str
    utc: datetime
    altitude_deg: Finite
    azimuth_deg: Finite
    limit: str | None = None
    words: str


class FollowView(BaseModel):
    """How a target was followed."""

    kind: Literal["follow"] = "follow"
    outcome: Literal["time", "ephemeris-ends", "limit-ahead"] = Field(description="Why it ended")
    target: str
    began_utc: datetime
    ended_utc: datetime
    by: Literal["rates", "guide-pulses", "small-slews"] = Field(description="At last")
    plan: str = Field(description="How it was planned, with the fastest rates")
    fastest_arcsec_s: Finite
    looks: int
    unsolved: int
    within: int = Field(description="Looks from the second on that were within the tolerance")
    tolerance_arcsec: Finite
    worst_arcsec: Finite = None
    rms_arcsec: Finite = None
    last_arcsec: Finite = None
    renewed: int = Field(description="So often rates, pulses or slews were ordered")
    verdict: str | None = Field(default=None, description="Of the rates, the last one, in words")
    fault: str | None = Field(default=None, description="The last one that was named")
    correction: str = Field(default="", description="In force at the end, in words")
    events: list[SkyEventView] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    elapsed_s: Finite


Attempt = Annotated[AttemptView | SeriesLookView | PointView | FollowLookView, Field(discriminator="kind")]


class SolvedView(BaseModel):
    """A frame of this machine, solved."""

    kind: Literal["solve"] = "solve"
    path: str
    seen: Place = Field(description="Its geometric center, ICRS")
    seen_mount: Place | None = Field(default=None, description="The same in the mount's own frame, of now")
    record: SolveRecord = Field(description="As `POST /v1/solve` answers")


class DriftView(BaseModel):
    """How fast the field drifts on the sky, from straight lines through the solved places."""

    ra_cosdec_arcsec_min: Finite
    ra_cosdec_sigma_arcsec_min: Finite
    dec_arcsec_min: Finite
    dec_sigma_arcsec_min: Finite
    rms_arcsec: Finite = Field(description="Scatter round the lines")
    looks: int
    outliers: int


class SeriesView(BaseModel):
    """How a series ended."""

    kind: Literal["series"] = "series"
    target: Place | None = Field(description="What was slewed to")
    target_mount: Place | None = None
    first: Place = Field(description="The first solved look, ICRS")
    first_mount: Place | None = None
    last: Place
    last_mount: Place | None = None
    looks: int
    solved: int
    began_utc: datetime
    ended_utc: datetime
    drift: DriftView | None = Field(description="Of all segments together, jumps left out")
    jumps: Annotated[list[int], Field(description="Numbers of the looks before which the field jumped")]
    reason: str | None = Field(description="Why there is no drift")


class TermView(BaseModel):
    """One term of a pointing model, by its TPOINT name."""

    name: str
    value_arcsec: Finite
    sigma_arcsec: Finite
    meaning: str


class ModelRunView(BaseModel):
    """How a model run ended: the model, and whether it predicts better than what was there."""

    kind: Literal["model-run"] = "model-run"
    accepted: bool
    reasons: list[str] = Field(description="What spoke against it; what spoke for it if nothing did")
    points: int
    solved: int
    used: int = Field(description="Of the fit; the others were left out as gross errors")
    terms: list[TermView]
    sky_rms_arcsec: Finite | None = Field(description="Null where there are as many unknowns as points")
    before_arcsec: Finite | None = Field(description="Sky RMS with zero points alone")
    loo_arcsec: Finite = Field(description="Each target predicted from the others")
    model_id: str
    model: dict[str, JsonValue] = Field(description="The model's file, as `mountnav model fit` writes it")
    written_to: str | None = Field(description="Where it was put in force; null if it was not")
    in_force: bool
