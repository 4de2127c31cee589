"""What a job is aiming at, as ICRS, for those who draw it. Nothing that steers asks this."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from pydantic import TypeAdapter, ValidationError

from api.orders.job import Job
from api.orders.targets import Target, icrs_of
from mountnav.errors import MountnavError
from mountnav.navigation.reports import CenterReport, SlewReport
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site

_TARGET: TypeAdapter[Target] = TypeAdapter(Target)


def aim_of(job: Job, utc: datetime, site: Site, air: Air) -> Icrs | None:
    """Where a job goes, or went; None if it has no target.

    Parameters
    ----------
    job : Job
        Running or over.
    utc : datetime
        When, for targets that are no fixed places.
    site, air : Site, Air
    """
    match job.result:
        case CenterReport() | SlewReport() as report:
            return report.target
        case Mapping() as kept:
            return _place(kept.get("target"), utc)
    target = job.request.get("target")
    if isinstance(target, Mapping):
        try:
            return icrs_of(_TARGET.validate_python(dict(target)), utc, site, air)
        except (ValidationError, MountnavError):
            return None
    return _place(job.request, utc)


def _place(said: object, utc: datetime) -> Icrs | None:
    if not isinstance(said, Mapping):
        return None
    ra_deg, dec_deg = said.get("ra_deg"), said.get("dec_deg")
    if not isinstance(ra_deg, int | float) or not isinstance(dec_deg, int | float):
        return None
    if said.get("frame") == "jnow-apparent":
        return apparent_to_icrs(Apparent(float(ra_deg), float(dec_deg), utc))
    return Icrs(float(ra_deg), float(dec_deg))


__all__ = ["aim_of"]
