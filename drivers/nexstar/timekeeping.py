"""Clock and site between the wire's words and ours."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from drivers.nexstar.site_and_time import WireSite, WireTime
from mountnav.sky.coordinates import Site

_HALF_A_SECOND = timedelta(seconds=0.5)
_A_WHILE = timedelta(seconds=10)


def clock_of(shown: WireTime, way: timedelta) -> datetime:
    """Say what the clock shows now, aware UTC.

    Parameters
    ----------
    shown : WireTime
        Whole seconds, cut: on the average half a second has passed since.
    way : timedelta
        Between question and answer.
    """
    return (shown.utc + _HALF_A_SECOND + way / 2).replace(tzinfo=UTC)


def goes_on(before: WireTime, after: WireTime) -> bool:
    """Whether a clock that was read twice went on between, and nothing else."""
    return timedelta(0) <= after.utc - before.utc <= _A_WHILE and before.zone_h == after.zone_h


def time_for(utc: datetime) -> WireTime:
    """Say an instant in whole seconds, in the zone of UTC."""
    return WireTime((utc + _HALF_A_SECOND).astimezone(UTC).replace(microsecond=0, tzinfo=None), 0.0, False)


def site_of(wire: WireSite) -> Site:
    """Take a site from the wire."""
    return Site(wire.latitude_deg, wire.longitude_deg)


def wire_site(site: Site) -> WireSite:
    """Say a site; longitudes from -180 to 180, as the wire has them."""
    return WireSite(site.latitude_deg, (site.longitude_deg + 180.0) % 360.0 - 180.0)
