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
    "AxesMovedView",
    "AxisMovedView",
    "BendingView",
    "DitherView",
    "DriftView",
    "Finite",
    "FollowLookView",
    "FollowView",
    "HoldKnownView",
    "HoldLookView",
    "HoldView",
    "ModelRunView",
    "MosaicView",
    "OffsetView",
    "PanelView",
    "Place",
    "PointView",
    "RatesView",
    "SeriesLookView",
    "SeriesView",
    "SkyEventView",
    "SolvedView",
    "TermView",
    "TrendView",
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


class AxisMovedView(BaseModel):
    """One axis that was moved on by hand."""

    axis: Literal["primary", "secondary"]
    rate_deg_s: Finite = Field(description="The last speed that it had, degrees per second")
    moved_s: Finite = Field(description="For so many seconds")
    why: str = Field(description="Why it ended, in words")


class AxesMovedView(BaseModel):
    """How a motion by hand ended, axis by axis."""

    kind: Literal["axes-moved"] = "axes-moved"
    axes: list[AxisMovedView]


class RatesView(BaseModel):
    """Rates beside the sidereal one that the mount has taken, in its own coordinates; 0 and 0: a star's."""

    kind: Literal["offset-rates"] = "offset-rates"
    ra_arcsec_s: Finite = Field(
        description="Of the right ascension, not times cos(dec); positive to the east"
    )
    dec_arcsec_s: Finite
    ends_utc: datetime | None = Field(description="They end by then at the latest; null: none are in force")


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


class PanelView(BaseModel):
    """One panel of a mosaic."""

    kind: Literal["panel"] = "panel"
    number: int = Field(description="In the order in which they are visited, from 1")
    of: int
    column: int = Field(description="From the left; 0 of a pattern of offsets")
    row: int = Field(description="From above")
    ra_deg: Finite = Field(description="Its middle, ICRS")
    dec_deg: Finite
    position_angle_deg: Finite = Field(description="At which its image fits to the others")
    end: Literal["done", "centered", "not allowed", "not centered", "left out"] = Field(
        description="centered: it waits for the camera; done: that is over"
    )
    error_arcsec: Finite = None
    rotation_deg: Finite = Field(default=None, description="How the image stood")
    centered_utc: datetime | None = None
    left_utc: datetime | None = None
    words: str = ""


class MosaicView(BaseModel):
    """How a mosaic ended."""

    kind: Literal["mosaic"] = "mosaic"
    panels: list[PanelView]
    missing: list[int] = Field(description="Numbers of those that were not done")
    notes: list[str]
    began_utc: datetime
    ended_utc: datetime
    elapsed_s: Finite


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
    """What is foretold of a target's way over the sky."""

    kind: str = Field(
        description="rises, sets, meridian, lower-meridian, sun-near, sun-far (it comes within the Sun's "
        "cone, or leaves it), limit, within-limit (it comes outside of a limit, or within it again)"
    )
    utc: datetime
    altitude_deg: Finite = Field(description="Observed, then")
    azimuth_deg: Finite
    limit: str | None = Field(default=None, description="Which limit, if it is about one")
    words: str = Field(description="The same for people")


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
    stated_arcsec: Finite = Field(
        default=None,
        description="Of a fast pass: how far off it may have been by all that was known, rms of one sigma",
    )
    renewed: int = Field(description="So often rates, pulses or slews were ordered")
    verdict: str | None = Field(default=None, description="Of the rates, the last one, in words")
    fault: str | None = Field(default=None, description="The last one that was named")
    correction: str = Field(default="", description="In force at the end, in words")
    events: list[SkyEventView] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    elapsed_s: Finite


class TrendView(BaseModel):
    """A straight line through what was seen."""

    rate_per_h: Finite
    sigma_per_h: Finite
    now: Finite
    scatter: Finite
    points: int


class BendingView(BaseModel):
    """Main camera's center minus the guiding one's, arcsec."""

    east: TrendView
    north: TrendView


class HoldKnownView(BaseModel):
    """What a hold has found out: what the mount does by itself, on the sky."""

    drift_east_arcsec_min: Finite = Field(
        description="Null, as all drift and amplitudes, where it is corrected by pulses and doesn't give its "
        "guide rate: nobody knows how much they do then"
    )
    drift_east_sigma_arcsec_min: Finite
    drift_north_arcsec_min: Finite
    drift_north_sigma_arcsec_min: Finite
    period_s: Finite = Field(description="Of the worm; null: not known")
    amplitudes_arcsec: list[float] = Field(description="Of its turn and its harmonics")
    amplitude_sigma_arcsec: Finite
    noise_arcsec: Finite = Field(description="Scatter of a look, seeing included")
    gain: Finite = Field(description="Share of a correction in declination that arrives")
    gain_sigma: Finite
    play_arcsec: Finite = Field(description="Backlash in declination")
    play_sigma_arcsec: Finite
    rotation_deg: TrendView | None = Field(description="How the field turns")
    bending: BendingView | None = Field(
        description="How main and guiding camera bend apart, where frames of both are there"
    )


class HoldLookView(BaseModel):
    """One look of a hold, and what was corrected after it."""

    kind: Literal["hold-look"] = "hold-look"
    number: int
    utc: datetime
    fate: Literal["taken", "gated", "jump", "stale", "not-solved"] = Field(
        description="gated: too far off to be believed by itself; jump: the second that says so"
    )
    east_arcsec: Finite = Field(description="Seen minus wanted")
    north_arcsec: Finite
    sigma_arcsec: Finite
    step_east_arcsec: Finite = Field(description="Corrected after it")
    step_north_arcsec: Finite
    rate_east_arcsec_s: Finite = Field(description="Beside the sidereal rate since, on the sky")
    rate_north_arcsec_s: Finite
    rms_arcsec: Finite = Field(description="Residual of the last 20 looks, their own noise included")
    dithered_east_arcsec: Finite = Field(description="Where it should look, beside where it began")
    dithered_north_arcsec: Finite
    settled: bool | None = Field(description="Null: no dither is under way")
    problem: str | None
    known: HoldKnownView | None


class HoldView(BaseModel):
    """How a hold ended by its time."""

    kind: Literal["hold"] = "hold"
    target: Place
    target_mount: Place | None = None
    looks: int
    solved: int = Field(description="Solved and believed")
    gated: int
    jumps: int
    corrections: int
    rms_arcsec: Finite = Field(description="Residual of all looks, their own noise included")
    began_utc: datetime
    ended_utc: datetime
    by: Literal["pulses", "rates", "both"]
    known: HoldKnownView


class DitherView(BaseModel):
    """How a dither ended: settled, as looks show."""

    kind: Literal["dither"] = "dither"
    number: int = Field(description="Of the step in its pattern")
    east_arcsec: Finite = Field(description="Where it should look now, beside where the series began")
    north_arcsec: Finite
    off_arcsec: Finite = Field(description="The last look from there")
    looks: int
    elapsed_s: Finite


Attempt = Annotated[
    AttemptView | SeriesLookView | HoldLookView | PointView | PanelView | FollowLookView,
    Field(discriminator="kind"),
]


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
