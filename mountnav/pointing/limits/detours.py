"""A way round what isn't allowed: by way of up to three other places, each leg a slew that is allowed.

The legs turn one axis at a time, where nothing depends on how fast the axes are: along the hour circle
towards the pole, round it at a high declination, and down again to the target; or one axis after the other.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator
from datetime import datetime
from typing import TYPE_CHECKING

from mountnav.devices import PierSide
from mountnav.errors import OutsideLimits
from mountnav.pointing.limits.postures import Mounting, from_the_meridian_deg, side_by_rule
from mountnav.pointing.limits.slews import POLE_DOUBT_DEG
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site

if TYPE_CHECKING:
    from mountnav.pointing.limits.bounds import Limits

# Declinations, degrees towards the pole above the horizon, that a detour may pass, the nearest to the pole
# first: there a German mount clears most obstacles. Chosen by hand; more of them cost time only when there
# is no way. Last comes one so near to the pole that the tube hardly sinks below it while the mount changes
# sides: a mount that may hang on either may have to be sent there, where the pole is little above the limit.
_DECLINATIONS_DEG = (80.0, 65.0, 50.0, 35.0, 20.0, 5.0, 86.0)
# So far from the meridian, degrees, no German mount doubts its side of the pier. Chosen by hand.
_PLAIN_DEG = 45.0
_FORESEEN_SLACK_DEG = 1.0
"""A place that is meant to lie `_PLAIN_DEG` from the meridian lies so much nearer at most, °, as refraction
lifts it. Doubled, nothing else changes."""
_FARTHER_DEG = 15.0
"""A mount that was seen to stay on its side is sent so much farther past the meridian, °, to have it change:
two tries lead from 45° to 75°. Doubled, it is sent down to the horizon, and refused there."""
_FARTHEST_DEG = 75.0
"""Farther past the meridian than this, °, no German mount stays on its side."""
_Angles = tuple[float, float]
_Hangs = tuple[PierSide | None, bool]
"""On which side the tube hangs, and whether it may be either."""


def legs_to(
    limits: Limits,
    start: Icrs,
    target: Icrs,
    utc: datetime,
    site: Site,
    air: Air,
    mounting: Mounting | None,
    side: PierSide | None,
    either: bool = False,
    but: Container[Icrs] = (),
    foretold: PierSide | None = None,
) -> tuple[Icrs, ...]:
    """Find places by way of which a target may be slewed to that may not be directly.

    Parameters
    ----------
    mounting : {"german", "fork", "altaz"} or None
        None: not known.
    side : PierSide or None
        On which the tube hangs now.
    either : bool
        That isn't known, and it may be either.
    but : container of Icrs
        By none of these first: the mount was asked, and would go there by a way that isn't allowed.
    foretold : PierSide, optional
        The side on which the mount says that it will look at the target. Such a mount is taken to look at
        places well away from the meridian from the side that faces them; each leg has to be asked of it.

    Returns
    -------
    tuple of Icrs
        The target last; empty if nothing was found, or the target itself isn't allowed.
    """
    try:
        limits.check(target, utc, site, air)
    except OutsideLimits:
        return ()

    def foreseen(place: Icrs) -> PierSide | None:
        ha_deg = icrs_to_hour_angle(place, utc, site, air).ha_deg
        plain = from_the_meridian_deg(ha_deg) > _PLAIN_DEG - _FORESEEN_SLACK_DEG
        return side_by_rule(ha_deg) if plain else None

    def arrives(begin: Icrs, end: Icrs, hangs: _Hangs, stays: bool) -> tuple[bool, _Hangs]:
        try:
            check = limits.check_slew(
                begin,
                end,
                utc,
                site,
                air,
                mounting=mounting,
                side=hangs[0],
                either=hangs[1],
                destination=foreseen(end) if foretold and not stays else foretold,
                track_for_s=None if stays else 0.0,
            )
        except OutsideLimits:
            return False, hangs
        return True, (check.sides[0], False) if len(check.sides) == 1 else (None, len(check.sides) > 1)

    here = icrs_to_hour_angle(start, utc, site, air)
    there = icrs_to_hour_angle(target, utc, site, air)
    reachable: dict[_Angles, tuple[bool, _Hangs]] = {}
    # on which side a German mount looks at the pole nobody can foretell: by way of it comes last
    ways = sorted(
        _ways(here, there, site.latitude_deg, side, limits.stays_to_deg),
        key=lambda via: any(abs(dec_deg) >= POLE_DOUBT_DEG for _, dec_deg in via),
    )
    for via in ways:
        stops = [hour_angle_to_icrs(HourAngle(ha, dec, utc), site, air) for ha, dec in via]
        if stops[0] in but:
            continue
        if via[0] not in reachable:
            reachable[via[0]] = arrives(start, stops[0], (side, either), False)
        good, hangs = reachable[via[0]]
        for begin, end in zip(stops, [*stops[1:], target], strict=True):
            if good:
                # only the target is tracked
                good, hangs = arrives(begin, end, hangs, end is target)
        if good:
            return (*stops, target)
    return ()


def _ways(
    here: HourAngle, there: HourAngle, latitude_deg: float, side: PierSide | None, stays_to_deg: float
) -> Iterator[list[_Angles]]:
    """Hour angles and declinations by way of which to try it, the shortest ones first."""
    yield [(here.ha_deg, there.dec_deg)]
    yield [(there.ha_deg, here.dec_deg)]
    north = 1.0 if latitude_deg >= 0.0 else -1.0
    # where it is plain from which side of the pier a German mount looks: from there on it only stays
    past_deg = max(_PLAIN_DEG, min(stays_to_deg + _FARTHER_DEG, _FARTHEST_DEG) if stays_to_deg else 0.0)
    plain_deg = math.copysign(past_deg, there.ha_deg)
    # and where there is room to stop a German mount that stays instead of changing sides
    room_deg = {PierSide.WEST: -_PLAIN_DEG, PierSide.EAST: _PLAIN_DEG}.get(
        side or PierSide.UNKNOWN, math.copysign(_PLAIN_DEG, here.ha_deg)
    )
    yield [(room_deg, here.dec_deg)]
    for dec_deg in (north * one for one in _DECLINATIONS_DEG):
        yield [(here.ha_deg, dec_deg)]
        yield [(there.ha_deg, dec_deg)]
        yield [(plain_deg, dec_deg)]
        yield [(room_deg, dec_deg)]
    for dec_deg in (north * one for one in _DECLINATIONS_DEG):
        yield [(here.ha_deg, dec_deg), (there.ha_deg, dec_deg)]
        yield [(here.ha_deg, dec_deg), (plain_deg, dec_deg)]
        yield [(room_deg, dec_deg), (there.ha_deg, dec_deg)]
        yield [(room_deg, dec_deg), (plain_deg, dec_deg)]
        yield [(here.ha_deg, dec_deg), (room_deg, dec_deg), (plain_deg, dec_deg)]
        yield [(here.ha_deg, dec_deg), (plain_deg, dec_deg), (there.ha_deg, dec_deg)]
