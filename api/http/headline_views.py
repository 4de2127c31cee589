"""The headline of a telescope: what it is on, how well, how long yet until the meridian and the morning.

Each figure carries the instant that it holds for, or is null: a page that shows it can tell its age.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta

from pydantic import BaseModel, Field

from api.observatory.last_frame import LastFrame
from api.orders.job import Job
from api.orders.job_views import Finite
from mountnav.devices import MountReading
from mountnav.mount import CheckedMount
from mountnav.navigation.reports import CenterReport, TelescopeState
from mountnav.night.daylight import SunPass, sun_passes
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

__all__ = [
    "HeadlineView",
    "NightTimesView",
    "OnTarget",
    "coming_night",
    "headline_view",
    "night_times",
    "noon_before",
    "on_target",
    "target_name",
]

_ON_TARGET_ARCSEC = 1800.0
"""A mount that believes to be farther from a finished order's target has left it. Half a degree: more than
what an offset aims beside a target on a mount that points badly. Doubled, a nudge to a neighbor is not
noticed."""
_NOT_MOVED_ARCSEC = 30.0
"""What a reading may change by after a look, while the look's error still counts: rounding of LX200 mounts.
Doubled, an error is told that a nudge of a minute of arc has made wrong."""
_HORIZON_DEG = -0.833
"""The Sun's center when its upper edge rises: 34′ of refraction, 16′ of its radius, by convention."""
_DARK_DEG = -18.0
"""The Sun's altitude at which astronomical twilight ends, by definition."""
_NIGHT_H = 24.0
"""From noon to noon."""


class NightTimesView(BaseModel):
    """The Sun's times of the night that an instant belongs to, from noon to noon; null: not in that night."""

    sun_sets_utc: datetime | None = Field(description="Its upper edge, at a horizon of the sea")
    dark_from_utc: datetime | None = Field(description="The Sun comes 18° below the horizon")
    dark_until_utc: datetime | None = Field(description="It leaves them: dawn")
    sun_rises_utc: datetime | None


class HeadlineView(BaseModel):
    """What a telescope is on, and how well; null where unknown, or where it holds no more."""

    target: str | None = Field(
        description="Name of what it is on, or goes to; null: on nothing that was ordered"
    )
    target_job_id: str | None = Field(description="The job that brought or brings it there")
    arrived: bool | None = Field(description="Whether it is there; false: it is on its way")
    error_arcsec: Finite = Field(
        description="How far from the target the last look saw it; null once the mount has moved since"
    )
    error_utc: datetime | None = Field(description="Mid-exposure of that look")
    tolerance_arcsec: Finite = Field(description="That job's, where it had one")
    fwhm_arcsec: Finite = Field(description="Of the newest solved frame that shows it")
    fwhm_utc: datetime | None
    meridian_s: Finite = Field(
        description="How long until what it looks at crosses the meridian above the pole; negative: since"
    )
    times: NightTimesView


def night_times(utc: datetime, site: Site) -> NightTimesView:
    """The Sun's times of the night from noon to noon, by the Sun, that an instant belongs to."""
    noon = noon_before(utc, site)
    edge = sun_passes(noon, _NIGHT_H, _HORIZON_DEG, site)
    dark = sun_passes(noon, _NIGHT_H, _DARK_DEG, site)
    return NightTimesView(
        sun_sets_utc=_first(edge, rising=False),
        dark_from_utc=_first(dark, rising=False),
        dark_until_utc=_first(dark, rising=True),
        sun_rises_utc=_first(edge, rising=True),
    )


def coming_night(utc: datetime, site: Site) -> NightTimesView:
    """The times of this night; once the Sun has risen, of the next one."""
    times = night_times(utc, site)
    if times.sun_rises_utc is not None and times.sun_rises_utc <= utc:
        return night_times(utc + timedelta(hours=_NIGHT_H), site)
    return times


def noon_before(utc: datetime, site: Site) -> datetime:
    """The last noon, by the mean Sun, before an instant."""
    east = timedelta(hours=site.longitude_deg / 15.0)
    local = utc.astimezone(UTC) + east
    noon = datetime.combine(local.date(), time(12), tzinfo=UTC)
    return (noon if local >= noon else noon - timedelta(days=1)) - east


def _first(passes: tuple[SunPass, ...], *, rising: bool) -> datetime | None:
    return next((one.utc for one in passes if one.rising is rising), None)


def target_name(job: Job) -> str | None:
    """What a job's target is called; None where it has no name."""
    target = job.request.get("target")
    if not isinstance(target, Mapping):
        return None
    name = target.get("name") or target.get("text")
    return str(name) if name else None


@dataclass(frozen=True, slots=True)
class OnTarget:
    """What a telescope is on, or goes to.

    Attributes
    ----------
    job : Job
        That brought or brings it there.
    name : str or None
        Of the target, else its place as people write it; None: it has neither.
    arrived : bool
        Whether it is there.
    error_arcsec : float or None
        How far from the target the last look saw it; None once the mount has moved since.
    error_utc : datetime or None
        Mid-exposure of that look.
    """

    job: Job
    name: str | None
    arrived: bool
    error_arcsec: float | None
    error_utc: datetime | None


def on_target(
    state: TelescopeState, running: Job | None, aimed: Job | None, aim: Icrs | None
) -> OnTarget | None:
    """What a telescope is on or goes to, by the orders it had; None: on nothing that was ordered.

    Parameters
    ----------
    running : Job or None
        What holds it.
    aimed : Job or None
        The newest one that has a target, running or over.
    aim : Icrs or None
        That target, now; without it one that is over counts as left.
    """
    if aimed is None:
        return None
    here = state.icrs if state.connected else None
    under_way = aimed is running
    on_it = here is not None and aim is not None and separation_arcsec(here, aim) <= _ON_TARGET_ARCSEC
    if not under_way and (not on_it or running is not None):
        return None
    error_arcsec, error_utc = _error(aimed, state.reading, under_way)
    following = aimed.progress.get("phase") == "following"
    return OnTarget(
        aimed,
        target_name(aimed) or _place_words(aim),
        following if under_way else on_it,
        error_arcsec,
        error_utc,
    )


def headline_view(
    mount: CheckedMount,
    state: TelescopeState,
    running: Job | None,
    aimed: Job | None,
    aim: Icrs | None,
    frames: LastFrame | None,
    utc: datetime,
) -> HeadlineView:
    """The headline of a telescope.

    Parameters
    ----------
    running : Job or None
        What holds it.
    aimed : Job or None
        The newest one that has a target, running or over.
    aim : Icrs or None
        That target, now.
    frames : LastFrame or None
        What its frames showed.
    """
    here = state.icrs if state.connected else None
    on = on_target(state, running, aimed, aim)
    sky = (
        next((one for one in reversed(frames.seen) if one.fwhm_arcsec is not None), None) if frames else None
    )
    observed = None if here is None else icrs_to_hour_angle(here, utc, mount.site, mount.air)
    return HeadlineView(
        target=None if on is None else on.name,
        target_job_id=None if on is None else on.job.id,
        arrived=None if on is None else on.arrived,
        error_arcsec=None if on is None else on.error_arcsec,
        error_utc=None if on is None else on.error_utc,
        tolerance_arcsec=None if on is None else _tolerance(on.job),
        fwhm_arcsec=None if sky is None else sky.fwhm_arcsec,
        fwhm_utc=None if sky is None else sky.utc,
        meridian_s=None if observed is None else -observed.ha_deg / SIDEREAL_DEG_S,
        times=coming_night(utc, mount.site),
    )


def _place_words(place: Icrs | None) -> str | None:
    """A place without a name, to the second of arc: as people write it."""
    if place is None:
        return None
    tenths = round(place.ra_deg * 2400.0) % 864_000
    seconds = round(abs(place.dec_deg) * 3600.0)
    sign = "−" if place.dec_deg < 0.0 else "+"
    return (
        f"{tenths // 36_000:02d}h{tenths // 600 % 60:02d}m{tenths % 600 // 10:02d}.{tenths % 10}s "
        f"{sign}{seconds // 3600:02d}°{seconds // 60 % 60:02d}′{seconds % 60:02d}″"
    )


def _error(job: Job, reading: MountReading | None, under_way: bool) -> tuple[float | None, datetime | None]:
    """What the job's last look found, if the mount hasn't moved since."""
    if under_way:
        off, seen = job.progress.get("off_arcsec"), job.progress.get("utc")
        if isinstance(off, int | float) and isinstance(seen, str):
            return float(off), datetime.fromisoformat(seen)
        return None, None
    report = job.result
    if not isinstance(report, CenterReport) or report.last is None or reading is None:
        return None, None
    if reading.tracking is False or not _same(report.last.after, reading):
        return None, None
    return report.error_after_arcsec, report.last.mid_exposure_utc


def _same(before: MountReading, now: MountReading) -> bool:
    """Whether a mount reads what it read before."""
    first, second = before.place, now.place
    if isinstance(first, Apparent) and isinstance(second, Apparent):
        return (
            separation_arcsec(first, Apparent(second.ra_deg, second.dec_deg, first.utc)) <= _NOT_MOVED_ARCSEC
        )
    if isinstance(first, Icrs) and isinstance(second, Icrs):
        return separation_arcsec(first, second) <= _NOT_MOVED_ARCSEC
    return False


def _tolerance(job: Job) -> float | None:
    if isinstance(job.result, CenterReport):
        return job.result.tolerance_arcsec
    asked = job.request.get("tolerance_arcsec")
    return float(asked) if isinstance(asked, int | float) else None
