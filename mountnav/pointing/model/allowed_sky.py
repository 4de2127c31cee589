"""Where a model run may look: the limits that stay, asked for azimuth, altitude and side of the pier.

Sun, Moon and daylight are not among them: they are checked, like everything else, when the telescope is sent.
"""

from __future__ import annotations

from mountnav.devices import PierSide
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.planning import ANY_TIME, Allowed
from mountnav.sky.chain import observed_to_hour_angle
from mountnav.sky.coordinates import Observed, Site

MARGIN_DEG = 1.0
"""Kept from all limits: between planning and looking the sky turns, and the telescope points wrong still."""


def allowed_by(limits: Limits, site: Site, *, margin_deg: float = MARGIN_DEG) -> Allowed:
    """Make the question that `planning.plan` asks."""

    def allowed(az_deg: float, alt_deg: float, side: PierSide) -> bool:
        # at the zenith there is nothing to keep away from
        highest = limits.max_altitude_deg - (margin_deg if limits.max_altitude_deg < 90.0 else 0.0)
        if not limits.min_altitude_deg + margin_deg <= alt_deg <= highest:
            return False
        if limits.horizon is not None and alt_deg < limits.horizon.altitude_at(az_deg) + margin_deg:
            return False
        place = observed_to_hour_angle(Observed(az_deg, alt_deg, ANY_TIME), site)
        for bounds, value in (
            (limits.hour_angle_deg, place.ha_deg),
            (limits.declination_deg, place.dec_deg),
        ):
            if bounds is not None and not bounds[0] + margin_deg <= value <= bounds[1] - margin_deg:
                return False
        return _on_its_side(limits, place.ha_deg, side, margin_deg)

    return allowed


def _on_its_side(limits: Limits, ha_deg: float, side: PierSide, margin_deg: float) -> bool:
    """Whether the tube doesn't look too far past the meridian; past the lower one neither."""
    if limits.past_meridian_deg is None or side is PierSide.UNKNOWN:
        return True
    past = max(limits.past_meridian_deg[0 if side is PierSide.EAST else 1] - margin_deg, 0.0)
    # east of the pier, in the normal posture, it looks west
    looks = ha_deg if side is PierSide.EAST else -ha_deg
    return looks >= -past or looks <= -180.0 + past
