"""What we reckon for an iOptron mount that doesn't say it: why it said no, and where a slew would end."""

from __future__ import annotations

from drivers.ioptron import codec
from drivers.ioptron.talk import Talk, site_of
from drivers.ioptron.values import Status
from mountnav.devices import PierSide
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.chain import apparent_to_hour_angle, hour_angle_to_observed, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, GeometricHourAngle, HourAngle, Icrs, Site, utc_now

_NEAR_MERIDIAN_DEG = 1.0


async def why_not(talk: Talk, place: Apparent | Icrs, status: Status) -> DeviceRefused:
    """Tell why a slew was answered 0, as far as its altitude limit does [IOPTRON310 :MS1# :GAL#]."""
    limit_deg = await talk.known(codec.ALTITUDE_LIMIT)
    site = site_of(status)
    angle = _hour_angle(place, site)
    seen = hour_angle_to_observed(HourAngle(angle.ha_deg, angle.dec_deg, angle.utc), site)
    if limit_deg is not None and seen.alt_deg < limit_deg:
        return talk.no(
            f"refused the slew: the place is {seen.alt_deg:.1f}° high, its limit is {limit_deg}°",
            Refusal.BELOW_HORIZON,
            "wait until it has risen, or lower the mount's altitude limit",
        )
    return talk.no(
        "refused the slew: 0", Refusal.LIMIT, "below its altitude limit, or beyond a mechanical one"
    )


async def destination_side(talk: Talk, place: Apparent | Icrs, flips_past_deg: float) -> PierSide | None:
    """On which side `:MS1#` ends: its normal posture looks west from the east side.

    None near the meridian, where it depends on what it does there and where it comes from.
    """
    ha_deg = _hour_angle(place, site_of(await talk.ask(talk.words.status))).ha_deg
    near_deg = flips_past_deg + _NEAR_MERIDIAN_DEG
    if not near_deg < abs(ha_deg) < 180.0 - near_deg:
        return None
    return PierSide.EAST if ha_deg > 0.0 else PierSide.WEST


def _hour_angle(place: Apparent | Icrs, site: Site) -> GeometricHourAngle:
    """Hour angle now, as a mount reckons it that knows no refraction."""
    if isinstance(place, Icrs):
        place = icrs_to_apparent(place, utc_now())
    return apparent_to_hour_angle(Apparent(place.ra_deg, place.dec_deg, utc_now()), site)
