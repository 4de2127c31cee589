"""A telescope's limits, its sky, and what its job is aiming at; computed from what is known.

For those who draw it: nothing that steers uses this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta

from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from api.http.headline_views import HeadlineView, headline_view
from api.observatory.last_frame import LastFrame
from api.orders.job import Job
from api.orders.job_views import Finite, Place
from api.orders.targets import Target, icrs_of, moves
from mountnav.clock import utc_now
from mountnav.errors import MountnavError
from mountnav.mount import CheckedMount
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.reports import CenterReport, SlewReport, TelescopeState
from mountnav.pointing.limits.bodies import bodies
from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
    icrs_to_observed,
    sidereal_time_deg,
)
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, GeometricHourAngle, HourAngle, Icrs, Site
from mountnav.sky.sphere import gnomonic, gnomonic_inverse, half_turn_deg

__all__ = ["LimitsView", "SkyView", "aim_of", "has_target", "headline_target", "limits_view", "sky_view"]


_TARGET: TypeAdapter[Target] = TypeAdapter(Target)


def has_target(job: Job) -> bool:
    """Whether a job goes, or went, to a target; the place by which a frame is solved is none."""
    if job.kind == "solve":
        return False
    kept = job.result.get("target") if isinstance(job.result, Mapping) else None
    said = (job.request.get("target"), kept)
    return (
        isinstance(job.result, CenterReport | SlewReport)
        or any(isinstance(one, Mapping) for one in said)
        or "ra_deg" in job.request
    )


def aim_of(job: Job, utc: datetime, site: Site, air: Air, *, bodies_too: bool = True) -> Icrs | None:
    """Where a job goes, or went; None if it has no target.

    Parameters
    ----------
    job : Job
        Running or over.
    utc : datetime
        When, for targets that are no fixed places.
    bodies_too : bool
        Whether it is computed where a body that moves stands: an orbit takes tens of milliseconds.
    """
    if not has_target(job):
        return None
    match job.result:
        case CenterReport() | SlewReport() as report:
            return report.target
        case Mapping() as kept:
            return _place(kept.get("target"), utc)
    target = job.request.get("target")
    if isinstance(target, Mapping):
        try:
            asked = _TARGET.validate_python(dict(target))
            return icrs_of(asked, utc, site, air) if bodies_too or not moves(asked) else None
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


AHEAD_S = 43_200.0
"""So far ahead a limit is sought."""
_TRACK_STEP_S = 900.0
"""Between two points of the drawn track, s: 3.75° of the sky, which a map shows as a smooth line. Doubled,
corners show near the pole."""
_TRACK_S = 6 * 3600.0
"""Length of the drawn track, s: as far ahead as a target is followed. Doubled, twice the points."""
_WAY_STEPS = 32
"""Straight parts of the drawn way to a target; chosen by hand. Halved, long ways show corners."""


class DirectionView(BaseModel):
    """A direction as seen from the site: azimuth north through east."""

    altitude_deg: Finite
    azimuth_deg: Finite


class HorizonPointView(BaseModel):
    """A corner of what stands round the telescope; between corners it is straight."""

    azimuth_deg: float
    altitude_deg: float


class LimitsView(BaseModel):
    """Where a telescope may point. Null: no such limit."""

    telescope: str
    latitude_deg: float
    longitude_deg: float
    height_m: float
    mounting: str | None
    min_altitude_deg: float
    max_altitude_deg: float
    way_min_altitude_deg: float | None
    horizon: list[HorizonPointView]
    hour_angle_deg: tuple[float, float] | None = Field(description="West positive")
    declination_deg: tuple[float, float] | None
    past_meridian_deg: tuple[float, float] | None = Field(
        description="How far past the meridian a German mount's tube may look: hanging east, hanging west"
    )
    sun_cone_deg: float = Field(description="0: no such limit")
    sun_cone_from_altitude_deg: float
    moon_cone_deg: float
    daylight: str
    daylight_from_altitude_deg: float
    margin_deg: float
    tolerance_arcsec: float = Field(description="A target counts as centered within this")


class LimitAheadView(BaseModel):
    """A limit that tracking leads to."""

    limit: str
    utc: datetime
    after_s: float
    altitude_deg: Finite
    azimuth_deg: Finite


class TrackPointView(DirectionView):
    """Where it will be."""

    utc: datetime


class PlaceAskedView(DirectionView):
    """A place, whether it is allowed now, and the way there."""

    place: Place
    of_date: Place
    hour_angle_deg: Finite
    allowed: bool
    why: str | None = Field(description="Why it is not allowed, and when it will be")
    ahead: LimitAheadView | None = Field(description="The limit that following it reaches first")


class SkyView(BaseModel):
    """The sky over a telescope at one moment; null where unknown."""

    telescope: str
    utc: datetime
    sidereal_deg: Finite = Field(description="Local apparent sidereal time")
    icrs: Place | None
    of_date: Place | None = Field(description="True equator and equinox of now")
    hour_angle_deg: Finite = Field(description="West positive, refraction included")
    altitude_deg: Finite
    azimuth_deg: Finite
    pier_side: str | None
    sun: DirectionView
    moon: DirectionView
    ahead: LimitAheadView | None = Field(
        description="The limit that tracking reaches first within twelve hours"
    )
    track: list[TrackPointView] = Field(description="Where tracking leads in six hours, up to the limit")
    target: PlaceAskedView | None = Field(description="Of the job that runs, else of the last one")
    target_job_id: str | None
    way: list[DirectionView] = Field(
        description="The great circle from here to the target of a job that runs; the axes may go another way"
    )
    asked: PlaceAskedView | None = Field(description="The place that was asked for")
    headline: HeadlineView = Field(description="What it is on, how well, and for how long yet")


def limits_view(telescope_id: str, navigator: Navigator) -> LimitsView:
    """Show a telescope's limits."""
    limits, mount = navigator.limits, navigator.mount
    site = mount.site
    return LimitsView(
        telescope=telescope_id,
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        height_m=site.height_m,
        mounting=mount.mounting,
        min_altitude_deg=limits.min_altitude_deg,
        max_altitude_deg=limits.max_altitude_deg,
        way_min_altitude_deg=limits.way_min_altitude_deg,
        horizon=[
            HorizonPointView(azimuth_deg=az, altitude_deg=alt)
            for az, alt in (limits.horizon.points_deg if limits.horizon is not None else ())
        ],
        hour_angle_deg=limits.hour_angle_deg,
        declination_deg=limits.declination_deg,
        past_meridian_deg=limits.past_meridian_deg,
        sun_cone_deg=limits.sun_cone_deg,
        sun_cone_from_altitude_deg=limits.sun_cone_from_altitude_deg,
        moon_cone_deg=limits.moon_cone_deg,
        daylight=limits.daylight,
        daylight_from_altitude_deg=limits.daylight_from_altitude_deg,
        margin_deg=limits.margin_deg,
        tolerance_arcsec=navigator.policy.tolerance_arcsec,
    )


def sky_view(
    navigator: Navigator,
    state: TelescopeState,
    running: Job | None,
    jobs: Sequence[Job],
    asked: Icrs | None,
    frames: LastFrame | None = None,
) -> SkyView:
    """Show the sky of a telescope.

    Parameters
    ----------
    state : TelescopeState
        What is known of it now.
    running : Job or None
        What holds it.
    jobs : sequence of Job
        Its own, newest first.
    asked : Icrs or None
        A place to be told of as well.
    frames : LastFrame, optional
        What its frames showed.
    """
    site, air = navigator.mount.site, navigator.mount.air
    utc = utc_now()
    around = bodies(utc.replace(microsecond=0), site)
    here = state.icrs if state.connected else None
    seen = None if here is None else icrs_to_observed(here, utc, site, air)
    side = None if state.reading is None else state.reading.pier_side
    ahead = None if here is None else _ahead(navigator, here, utc, at_its_side=True, state=state)
    aimed_by = next((job for job in jobs if aim_of(job, utc, site, air) is not None), None)
    aim = None if aimed_by is None else aim_of(aimed_by, utc, site, air)
    goes_there = aim is not None and aimed_by is running and running is not None
    return SkyView(
        telescope=state.name,
        utc=utc,
        sidereal_deg=sidereal_time_deg(utc, site),
        icrs=None if here is None else _icrs(here),
        of_date=None if here is None else _of_date(here, utc),
        hour_angle_deg=None if here is None else icrs_to_hour_angle(here, utc, site, air).ha_deg,
        altitude_deg=None if seen is None else seen.alt_deg,
        azimuth_deg=None if seen is None else seen.az_deg,
        pier_side=None if side is None else str(side),
        sun=_body(around.sun, site),
        moon=_body(around.moon, site),
        ahead=ahead,
        track=[] if here is None else _track(navigator, here, utc, ahead),
        target=None if aim is None else _place_asked(navigator, aim, utc, state),
        target_job_id=None if aimed_by is None else aimed_by.id,
        way=_way(navigator, here, aim, utc) if here is not None and aim is not None and goes_there else [],
        asked=None if asked is None else _place_asked(navigator, asked, utc, state),
        headline=headline_view(navigator.mount, state, running, aimed_by, aim, frames, utc),
    )


def headline_target(
    mount: CheckedMount, state: TelescopeState, running: Job | None, utc: datetime
) -> Icrs | None:
    """What a telescope goes to, else where it looks; None where that isn't known."""
    if running is not None and (aim := aim_of(running, utc, mount.site, mount.air)) is not None:
        return aim
    return state.icrs if state.connected else None


def _ahead(
    navigator: Navigator, place: Icrs, utc: datetime, *, at_its_side: bool, state: TelescopeState
) -> LimitAheadView | None:
    side = state.reading.pier_side if at_its_side and state.reading is not None else None
    mount = navigator.mount
    found = navigator.limits.reached(
        place, utc, mount.site, mount.air, mounting=mount.mounting, side=side, within_s=AHEAD_S
    )
    if found is None:
        return None
    return LimitAheadView(
        limit=str(found.limit),
        utc=utc + timedelta(seconds=found.after_s),
        after_s=found.after_s,
        altitude_deg=found.alt_deg,
        azimuth_deg=found.az_deg,
    )


def _place_asked(navigator: Navigator, place: Icrs, utc: datetime, state: TelescopeState) -> PlaceAskedView:
    site, air = navigator.mount.site, navigator.mount.air
    seen, why = icrs_to_observed(place, utc, site, air), None
    try:
        navigator.limits.check(place, utc, site, air)
    except MountnavError as refusal:
        why = refusal.what
    return PlaceAskedView(
        altitude_deg=seen.alt_deg,
        azimuth_deg=seen.az_deg,
        place=_icrs(place),
        of_date=_of_date(place, utc),
        hour_angle_deg=icrs_to_hour_angle(place, utc, site, air).ha_deg,
        allowed=why is None,
        why=why,
        ahead=_ahead(navigator, place, utc, at_its_side=False, state=state) if why is None else None,
    )


def _track(
    navigator: Navigator, place: Icrs, utc: datetime, ahead: LimitAheadView | None
) -> list[TrackPointView]:
    """Where tracking leads: the hour angle turned on, good to what refraction changes, an arcminute or so."""
    site, air = navigator.mount.site, navigator.mount.air
    here = icrs_to_hour_angle(place, utc, site, air)
    end_s = _TRACK_S if ahead is None else min(_TRACK_S, ahead.after_s)
    steps = [_TRACK_STEP_S * one for one in range(int(end_s // _TRACK_STEP_S) + 1)]
    track = []
    for later_s in dict.fromkeys((*steps, end_s)):
        at = utc + timedelta(seconds=later_s)
        turned = HourAngle(half_turn_deg(here.ha_deg + SIDEREAL_DEG_S * later_s), here.dec_deg, at)
        seen = hour_angle_to_observed(turned, site)
        track.append(TrackPointView(utc=at, altitude_deg=seen.alt_deg, azimuth_deg=seen.az_deg))
    return track


def _way(navigator: Navigator, here: Icrs, there: Icrs, utc: datetime) -> list[DirectionView]:
    """Directions along the great circle; none for places more than 89° apart, which no plane shows."""
    site, air = navigator.mount.site, navigator.mount.air
    xi, eta = gnomonic([there.ra_deg], [there.dec_deg], here.ra_deg, here.dec_deg)
    if not abs(float(xi[0])) + abs(float(eta[0])) < 57.0:  # NaN too
        return []
    way = []
    for step in range(_WAY_STEPS + 1):
        share = step / _WAY_STEPS
        ra, dec = gnomonic_inverse([share * xi[0]], [share * eta[0]], here.ra_deg, here.dec_deg)
        seen = icrs_to_observed(Icrs(float(ra[0]), float(dec[0])), utc, site, air)
        way.append(DirectionView(altitude_deg=seen.alt_deg, azimuth_deg=seen.az_deg))
    return way


def _icrs(place: Icrs) -> Place:
    return Place(ra_deg=place.ra_deg, dec_deg=place.dec_deg, frame="icrs")


def _of_date(place: Icrs, utc: datetime) -> Place:
    apparent = icrs_to_apparent(place, utc)
    return Place(ra_deg=apparent.ra_deg, dec_deg=apparent.dec_deg, frame="jnow-apparent", utc=utc)


def _body(body: GeometricHourAngle, site: Site) -> DirectionView:
    seen = hour_angle_to_observed(HourAngle(body.ha_deg, body.dec_deg, body.utc), site)
    return DirectionView(altitude_deg=seen.alt_deg, azimuth_deg=seen.az_deg)
