"""What a job has done so far, with numbers: looks of a centering or a series, points of a model run."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from api.http.places import Finite


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


Attempt = Annotated[AttemptView | SeriesLookView | PointView, Field(discriminator="kind")]


__all__ = ["Attempt", "AttemptView", "PointView", "SeriesLookView"]
