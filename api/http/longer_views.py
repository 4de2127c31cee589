"""How the longer kinds of jobs end: a frame solved, a series' drift, a model run's model."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field, JsonValue

from api.http.places import Finite, Place
from api.solver.solve_record import SolveRecord


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


__all__ = ["DriftView", "ModelRunView", "SeriesView", "SolvedView", "TermView"]
