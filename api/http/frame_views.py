"""The last frame as the API shows it: stars in pixels, what was seen, believed and aimed at."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
from pydantic import BaseModel, Field

from api.http.sky_views import aim_of
from api.observatory.last_frame import Kept
from api.orders.job import Job
from api.orders.job_views import Finite, Place
from mountnav.clock import utc_now
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import gnomonic, offset_arcsec
from mountnav.sky.wcs import icrs_at_pixel
from mountnav.solution import Solution

_STARS_AT_MOST = 400
"""Stars of a frame that are sent, the brightest first; chosen by hand. Doubled, the answer is up to twice
as long."""
_LONGEST_DEG = 60.0
"""A place further from the frame's center is not projected, deg: the tangent plane has no point beyond 90°,
and a distortion fitted to the frame means nothing long before."""


class FrameStarView(BaseModel):
    """An identified star: where it was measured, and by how much it deviates from the catalog."""

    x_px: float
    y_px: float
    mag: Finite
    used: bool = Field(description="In the fit; false if it was rejected by its deviation")
    east_arcsec: Finite = Field(description="Measured minus catalog")
    north_arcsec: Finite


class FramePointView(BaseModel):
    """A place on the frame; it may lie outside."""

    place: Place
    x_px: Finite
    y_px: Finite
    east_arcsec: Finite = Field(description="From the frame's center")
    north_arcsec: Finite
    distance_arcsec: Finite


class LastFrameView(BaseModel):
    """The last frame of a telescope. Pixels are 0-based from the file's first one, x right and y up."""

    telescope: str
    frame_id: str
    source: str
    mid_exposure_utc: datetime | None
    exposure_s: Finite
    width_px: int
    height_px: int
    solved: bool
    reason: str | None = Field(description="Why it was not solved")
    picture: str = Field(description="Address of its picture")
    measured: int
    measured_px: list[tuple[float, float]] = Field(description="Measured sources, brightest first")
    stars: list[FrameStarView] = Field(description="Those that were identified")
    center: Place | None
    sigma_arcsec: Finite
    scale_arcsec_px: Finite
    rotation_deg: Finite = Field(description="Position angle of +y, east of north")
    parity: int | None = Field(description="+1: east is left when north is up")
    rms_arcsec: Finite
    pairs: int | None
    mode: str | None
    limiting_mag: Finite
    fwhm_arcsec: Finite
    believed: FramePointView | None = Field(description="Where the mount believed the center to be")
    target: FramePointView | None = Field(description="What the job that took it aims at")
    job_id: str | None
    solve_s: Finite


def last_frame_view(
    telescope_id: str, kept: Kept, jobs: Sequence[Job], site: Site, air: Air
) -> LastFrameView:
    """Show a frame that was kept; `jobs` are the telescope's, newest first."""
    verdict = kept.verdict
    solution = verdict.solution
    job = next((job for job in jobs if _took(job, kept)), None)
    target = None if job is None else aim_of(job, utc_now(), site, air)
    reason = None if verdict.reason is None else f"{verdict.reason}: {verdict.detail}".rstrip(": ")
    quality = verdict.quality
    return LastFrameView(
        telescope=telescope_id,
        frame_id=kept.id,
        source=kept.source,
        mid_exposure_utc=kept.mid_exposure_utc,
        exposure_s=kept.exposure_s,
        width_px=kept.width_px,
        height_px=kept.height_px,
        solved=solution is not None,
        reason=reason,
        picture=f"/v1/telescopes/{telescope_id}/last-frame.webp",
        # a glance's count leaves out what was found by its place in the catalog
        measured=max(verdict.measured, len(verdict.seen_px)),
        measured_px=[(round(float(x), 2), round(float(y), 2)) for x, y in verdict.seen_px],
        stars=[] if solution is None else _stars(solution),
        center=None if solution is None else _place(solution.center),
        sigma_arcsec=None if solution is None else solution.center_sigma_arcsec,
        scale_arcsec_px=None if solution is None else solution.scale_arcsec_px,
        rotation_deg=None if solution is None else solution.rotation_deg,
        parity=None if solution is None else solution.parity,
        rms_arcsec=None if solution is None else solution.rms_arcsec,
        pairs=None if solution is None else solution.pairs,
        mode=None if solution is None else solution.mode,
        limiting_mag=None if quality is None else quality.limiting_mag,
        fwhm_arcsec=None if quality is None else quality.fwhm_arcsec,
        believed=_point(solution, kept.believed, kept.width_px, kept.height_px),
        target=_point(solution, target, kept.width_px, kept.height_px),
        job_id=None if job is None else job.id,
        solve_s=verdict.times.total_s,
    )


def pixel_of(cards: Mapping[str, object], place: Icrs, width_px: int, height_px: int) -> tuple[float, float]:
    """Find the pixel (0-based) at which a place lies, by Newton's steps through the WCS.

    Raises
    ------
    BadRequest
        The place is too far from the frame to lie on its plane.
    """
    x_px, y_px = (width_px - 1) / 2, (height_px - 1) / 2
    for _ in range(6):
        here = icrs_at_pixel(cards, x_px, y_px)
        if offset_arcsec(place, here).total_arcsec > _LONGEST_DEG * 3600.0:
            raise BadRequest("the place is nowhere near the frame")
        xi, eta = _plane(place, here)
        sides = [_plane(icrs_at_pixel(cards, x_px + dx, y_px + dy), here) for dx, dy in ((1, 0), (0, 1))]
        step = np.linalg.solve(np.array(sides).T, np.array([xi, eta]))
        x_px, y_px = x_px + float(step[0]), y_px + float(step[1])
        if math.hypot(*step) < 0.01:
            break
    return x_px, y_px


def _plane(place: Icrs, center: Icrs) -> tuple[float, float]:
    xi, eta = gnomonic([place.ra_deg], [place.dec_deg], center.ra_deg, center.dec_deg)
    return float(xi[0]), float(eta[0])


def _took(job: Job, kept: Kept) -> bool:
    """Whether a job ran when the frame was solved."""
    began, ended = job.started_utc, job.finished_utc
    return began is not None and began <= kept.solved_utc and (ended is None or kept.solved_utc <= ended)


def _stars(solution: Solution) -> list[FrameStarView]:
    pairs = solution.identified
    brightest = np.argsort(-pairs.flux)[:_STARS_AT_MOST]
    return [
        FrameStarView(
            x_px=round(float(pairs.x_px[star]), 2),
            y_px=round(float(pairs.y_px[star]), 2),
            mag=round(float(pairs.mag[star]), 3),
            used=bool(pairs.used[star]),
            east_arcsec=round(float(pairs.dx_arcsec[star]), 4),
            north_arcsec=round(float(pairs.dy_arcsec[star]), 4),
        )
        for star in brightest
    ]


def _point(
    solution: Solution | None, place: Icrs | None, width_px: int, height_px: int
) -> FramePointView | None:
    if solution is None or place is None:
        return None
    center = icrs_at_pixel(solution.wcs, (width_px - 1) / 2, (height_px - 1) / 2)
    away = offset_arcsec(place, center)
    try:
        x_px, y_px = pixel_of(solution.wcs, place, width_px, height_px)
    except (BadRequest, np.linalg.LinAlgError):
        x_px = y_px = math.nan
    return FramePointView(
        place=_place(place),
        x_px=x_px,
        y_px=y_px,
        east_arcsec=away.east_arcsec,
        north_arcsec=away.north_arcsec,
        distance_arcsec=away.total_arcsec,
    )


def _place(place: Icrs) -> Place:
    return Place(ra_deg=place.ra_deg, dec_deg=place.dec_deg, frame="icrs")


__all__ = ["FramePointView", "FrameStarView", "LastFrameView", "last_frame_view", "pixel_of"]
