"""Refusals in words: which limit, where, when, and what to do."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from mountnav.errors import LimitKind, OutsideLimits
from mountnav.pointing.limits.bodies import bodies
from mountnav.pointing.limits.directions import of_body
from mountnav.pointing.limits.next_time import place_depths
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Observed, Site

if TYPE_CHECKING:
    from mountnav.pointing.limits.bounds import Limits

_GRAVEST = (LimitKind.SUN, LimitKind.DAYLIGHT, LimitKind.ALTITUDE, LimitKind.HORIZON)


def check_place(limits: Limits, target: Icrs, utc: datetime, site: Site, air: Air) -> None:
    """Refuse a target outside the limits of the sky; see `Limits.check`."""
    depths = {
        limit: depth for limit, depth in place_depths(limits, target, utc, site, air).items() if depth > 0.0
    }
    if not depths:
        return
    limit = next((one for one in _GRAVEST if one in depths), next(iter(depths)))
    place = icrs_to_observed(target, utc, site, air)
    raise OutsideLimits(
        f"the target stands at altitude {place.alt_deg:.2f}°, azimuth {place.az_deg:.2f}°, "
        f"{why(limits, limit, depths[limit], place)}",
        advice=when_allowed(limits, target, utc, site, air),
        limit=limit,
    )


def require_night(limits: Limits, utc: datetime, site: Site) -> None:
    """Refuse what isn't done by day. Raises `OutsideLimits`."""
    if limits.daylight == "allow":
        return
    sun = bodies(utc, site).sun
    sun_deg = float(of_body(sun, site.latitude_deg).altitude_deg)
    if sun_deg > limits.daylight_from_altitude_deg:
        raise OutsideLimits(
            f"the Sun stands at {sun_deg:+.1f}°: nothing but parking is done while it is above "
            f"{limits.daylight_from_altitude_deg:+g}°",
            advice="wait for the night",
            limit=LimitKind.DAYLIGHT,
        )


def when_allowed(limits: Limits, target: Icrs, utc: datetime, site: Site, air: Air) -> str:
    """Tell when a target that isn't allowed will be."""
    when = limits.next_allowed(target, utc, site, air)
    if when is None:
        return "it doesn't come within the limits during the next 24 hours: choose another target"
    hour = f"{when.astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}"
    return f"it comes within the limits at {hour}: wait, or choose another target"


def why(limits: Limits, limit: LimitKind, depth_deg: float, place: Observed) -> str:
    """Tell what is wrong with a place, in words that follow it."""
    match limit:
        case LimitKind.ALTITUDE if place.alt_deg < 0.5 * (limits.min_altitude_deg + limits.max_altitude_deg):
            return f"below the limit of {limits.min_altitude_deg:g}°{_and_margin(limits)}"
        case LimitKind.ALTITUDE:
            return f"above the limit of {limits.max_altitude_deg:g}°{_and_margin(limits)}"
        case LimitKind.HORIZON:
            return f"{depth_deg:.1f}° below the horizon that is set for this direction{_and_margin(limits)}"
        case LimitKind.SUN:
            near = limits.sun_cone_deg - depth_deg
            return f"{near:.1f}° from the Sun, nearer than the {limits.sun_cone_deg:g}° that are kept from it"
        case LimitKind.MOON:
            near = limits.moon_cone_deg - depth_deg
            return (
                f"{near:.1f}° from the Moon, nearer than the {limits.moon_cone_deg:g}° that are kept from it"
            )
        case LimitKind.DAYLIGHT:
            sun = limits.daylight_from_altitude_deg + depth_deg
            return (
                f"and the Sun at {sun:+.1f}°: nothing is slewed or tracked while it is above "
                f"{limits.daylight_from_altitude_deg:+g}°"
            )
        case LimitKind.DECLINATION:
            return f"{depth_deg:.1f}° outside the declination limits {_pair(limits.declination_deg)}"
        case LimitKind.HOUR_ANGLE:
            return f"{depth_deg:.1f}° outside the hour angle limits {_pair(limits.hour_angle_deg)}"
        case LimitKind.MERIDIAN:
            east, west = limits.past_meridian_deg or (0.0, 0.0)
            return (
                f"{depth_deg:.1f}° too far past the meridian (allowed {east:g}° with the tube on the east "
                f"side of the pier, {west:g}° on the west)"
            )
    return f"{depth_deg:.1f}° beyond the range of an axis"


def _and_margin(limits: Limits) -> str:
    return f" (and a margin of {limits.margin_deg:g}°)" if limits.margin_deg > 0.0 else ""


def _pair(pair: tuple[float, float] | None) -> str:
    return "" if pair is None else f"{pair[0]:g}° to {pair[1]:g}°"
