"""Site and time as the NexStar wire packs them, eight bytes each, and as our values."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from drivers.wire.command import Unreadable
from mountnav.sky.coordinates import Site

_WEST_H, _EAST_H = -12, 14
"""Time zones there are, in hours east of Greenwich."""


@dataclass(frozen=True, slots=True)
class WireSite:
    """Where the hand control believes to stand; longitude EAST positive, both to one arcsecond."""

    latitude_deg: float
    longitude_deg: float


@dataclass(frozen=True, slots=True)
class WireTime:
    """What the hand control's clock shows.

    Attributes
    ----------
    local : datetime
        Naive, as shown, whole seconds, years 2000 to 2255.
    zone_h : float
        Hours east of Greenwich without daylight saving, -12..+14; whole ones, or quarters in the finer form.
    daylight_saving : bool
        Whether the clock shows one hour more.
    """

    local: datetime
    zone_h: float
    daylight_saving: bool

    @property
    def utc(self) -> datetime:
        """The instant in UTC, still naive."""
        return self.local - timedelta(hours=self.zone_h + int(self.daylight_saving))


def _angle(packed: bytes, largest_deg: int) -> float:
    # the sign stands in a byte of its own: degrees above 127 are no negative number [NexStar w]
    degrees, minutes, seconds, sign = packed
    total = degrees * 3600 + minutes * 60 + seconds
    if minutes > 59 or seconds > 59 or sign > 1 or total > largest_deg * 3600:
        raise Unreadable(f"{packed!r} is not an angle up to {largest_deg} degrees")
    return -total / 3600.0 if sign else total / 3600.0


def _packed(angle_deg: float, largest_deg: int) -> bytes:
    total = round(abs(angle_deg) * 3600.0)
    if total > largest_deg * 3600:
        raise ValueError(f"an angle of {angle_deg} degrees is beyond {largest_deg}")
    return bytes([total // 3600, total // 60 % 60, total % 60, int(angle_deg < 0 and total > 0)])


def site_from_bytes(packed: bytes) -> WireSite:
    """Site from ``d m s south, d m s west`` [NexStar w].

    Raises
    ------
    Unreadable
        If there are not eight bytes or a field is out of range.
    """
    if len(packed) != 8:
        raise Unreadable(f"{packed!r} is not a site")
    return WireSite(_angle(packed[:4], 90), _angle(packed[4:], 180))


def site_to_bytes(site: WireSite) -> bytes:
    """``d m s south, d m s west``, rounded to the arcsecond [NexStar W].

    Raises
    ------
    ValueError
        If the latitude is beyond 90 degrees or the longitude beyond 180.
    """
    return _packed(site.latitude_deg, 90) + _packed(site.longitude_deg, 180)


def time_from_bytes(packed: bytes) -> WireTime:
    """Time from ``h m s month day year-2000 zone dst``; a zone west of Greenwich is 256 - n [NexStar h].

    Raises
    ------
    Unreadable
        If there are not eight bytes, there is no such instant, or the zone does not exist.
    """
    return _time(packed, 1)


def fine_time_from_bytes(packed: bytes) -> WireTime:
    """Time whose zone is given in quarters of an hour [NexStar i]; raises as `time_from_bytes` does."""
    return _time(packed, 4)


def _time(packed: bytes, zone_steps: int) -> WireTime:
    if len(packed) != 8:
        raise Unreadable(f"{packed!r} is not a time")
    hour, minute, second, month, day, year, zone, saving = packed
    zone_h = (zone - 256 if zone > 127 else zone) / zone_steps
    if not _WEST_H <= zone_h <= _EAST_H or saving > 1:
        raise Unreadable(f"{packed!r} has no such time zone")
    try:
        local = datetime(2000 + year, month, day, hour, minute, second)
    except ValueError as cause:
        raise Unreadable(f"{packed!r} is not a time: {cause}") from cause
    return WireTime(local, zone_h, saving == 1)


def time_to_bytes(time: WireTime, *, fine: bool = False) -> bytes:
    """``h m s month day year-2000 zone dst`` [NexStar H]; `fine`: the zone in quarter hours [NexStar I].

    Raises
    ------
    ValueError
        If the year is not within 2000 to 2255, or the zone not within -12..+14 or between the steps.
    """
    local, zone = time.local, time.zone_h * (4 if fine else 1)
    if not 2000 <= local.year <= 2255 or not _WEST_H <= time.zone_h <= _EAST_H or zone != round(zone):
        raise ValueError(f"{time} can't be encoded in this protocol")
    shown = (local.hour, local.minute, local.second, local.month, local.day, local.year - 2000)
    return bytes([*shown, round(zone) % 256, int(time.daylight_saving)])


_HALF_A_SECOND = timedelta(seconds=0.5)
"""Clocks show whole seconds, cut: on the average half a second has passed since."""
_A_WHILE = timedelta(seconds=10)
"""Two answers about the clock within this time belong together. Chosen by hand: asked twice on a bad line,
they are a few seconds apart."""


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
