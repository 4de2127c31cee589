"""What the doctor says of a telescope: the record of `mountnav catalog doctor --json` and of its address."""

from __future__ import annotations

import math

from pydantic import BaseModel, Field

from api.orders.job_views import Finite
from mountnav.catalog.doctor.diagnosis import Check, Diagnosis, Verdict
from mountnav.catalog.doctor.obtainable import ONLINE


class CameraRecord(BaseModel):
    """The camera, as far as it is known; null where it isn't."""

    width_px: int | None
    height_px: int | None
    scale_arcsec_px: Finite
    field_width_deg: Finite
    field_height_deg: Finite
    depth_mag: Finite = Field(description="Faintest star that is measured")
    depth_is_estimate: bool
    size_from: str
    scale_from: str
    depth_from: str
    problem: str | None = Field(description="What is not known, and what to set")


class SkyRecord(BaseModel):
    """The sky that the telescope reaches: percentages are of it."""

    low_dec_deg: Finite
    high_dec_deg: Finite
    sky_percent: Finite = Field(description="How much of the whole sky that is")


class CheckRecord(BaseModel):
    """A catalog against the camera. Null: the catalog or the telescope reaches none of that sky."""

    name: str
    slug: str
    stars: int = Field(description="In the whole catalog")
    pole_stars: Finite = Field(description="Stars in a frame within 15° of the galactic poles, mean")
    median_stars: Finite = Field(description="Stars in a frame, median of the reachable sky")
    plane_stars: Finite = Field(description="Stars in a frame within 5° of the galactic plane, mean")
    fails_percent: Finite = Field(description="Of the reachable sky: fields that would not be solved")
    uncovered_percent: Finite = Field(description="Of the reachable sky: not in the catalog")
    verdict: Verdict
    fields_counted: int


class RemedyRecord(CheckRecord):
    """A catalog that would help, by a model of the Galaxy."""

    download_gb: Finite
    installed_gb: Finite = Field(description="At most")
    sigma_arcsec: Finite = Field(description="Typical error per coordinate in 2026")
    obtained: str
    command: str
    terms: str


class CatalogsRecord(BaseModel):
    """Whether the catalogs at hand suffice for a camera, and what would help."""

    verdict: Verdict = Field(description="suffices: fewer than 1 % of the fields fail; marginal: up to 10 %")
    fails_percent: Finite = Field(description="With the best of the catalogs at hand for each field")
    camera: CameraRecord
    sky: SkyRecord
    here: list[CheckRecord] = Field(description="The catalogs on this machine, the best first")
    online: list[str] = Field(description="Asked beside them while there is a network; not counted")
    remedies: list[RemedyRecord]
    advice: list[str]


class DoctorRecord(BaseModel):
    """What the doctor says of a telescope."""

    telescope: str
    catalogs: CatalogsRecord


def doctor_record(found: Diagnosis, online: list[str]) -> DoctorRecord:
    """Make the record of a diagnosis; `online` are the names of the online catalogs of the settings."""
    camera, frame = found.camera, found.camera.frame
    return DoctorRecord(
        telescope=camera.telescope,
        catalogs=CatalogsRecord(
            verdict=found.verdict,
            fails_percent=_percent(found.together),
            camera=CameraRecord(
                width_px=camera.width_px,
                height_px=camera.height_px,
                scale_arcsec_px=camera.scale_arcsec_px,
                field_width_deg=None if frame is None else round(frame.width_deg, 5),
                field_height_deg=None if frame is None else round(frame.height_deg, 5),
                depth_mag=None if frame is None else round(frame.depth_mag, 2),
                depth_is_estimate=camera.depth_is_estimate,
                size_from=camera.size_from,
                scale_from=camera.scale_from,
                depth_from=camera.depth_from,
                problem=camera.problem,
            ),
            sky=SkyRecord(
                low_dec_deg=round(found.reach.low_dec_deg, 3),
                high_dec_deg=round(found.reach.high_dec_deg, 3),
                sky_percent=_percent(found.reach.sky_share),
            ),
            here=[CheckRecord.model_validate(_check(check)) for check in found.here],
            online=online,
            remedies=[_remedy(remedy) for remedy in found.remedies],
            advice=[advice for advice in found.advice if advice != ONLINE or not online],
        ),
    )


def _check(one: Check) -> dict[str, object]:
    return {
        "name": one.name,
        "slug": one.slug,
        "stars": one.stars,
        "pole_stars": _rounded(one.pole),
        "median_stars": _rounded(one.median),
        "plane_stars": _rounded(one.plane),
        "fails_percent": _percent(one.fails_share),
        "uncovered_percent": _percent(one.uncovered_share),
        "verdict": one.verdict,
        "fields_counted": one.places,
    }


def _remedy(one: Check) -> RemedyRecord:
    known = one.known
    assert known is not None, "remedies are known catalogs"
    more: dict[str, object] = {
        "download_gb": known.download_gb,
        "installed_gb": round(known.installed_gb, 2),
        "sigma_arcsec": known.sigma_arcsec,
        "obtained": known.obtained,
        "command": known.command,
        "terms": known.terms,
    }
    return RemedyRecord.model_validate(_check(one) | more)


def _rounded(number: float) -> float | None:
    return None if math.isnan(number) else round(number, 1)


def _percent(share: float) -> float | None:
    return None if math.isnan(share) else round(100.0 * share, 2)
