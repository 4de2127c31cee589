"""How high the Sun stands, and which night an instant belongs to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import lru_cache

import erfa
import numpy as np

from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.units import SECONDS_PER_DAY, UNIX_ZERO_JD

_TT_MINUS_UTC_DAYS = 69.184 / SECONDS_PER_DAY
"""37 leap seconds since 2017 and the 32.184 s by definition. The Sun moves by 0.04″ in a second of it."""
_DARK_BELOW_DEG = -18.0
"""The Sun's altitude at which astronomical twilight ends, by definition."""
_STEP = timedelta(minutes=5)
"""Between two instants that are tried for the dark: the Sun sinks by up to 1.25° in it. Chosen by hand;
doubled, the simulated night that looks for it begins up to 10 minutes late."""


_PASS_STEP = timedelta(minutes=20)
"""Between two instants at which the Sun is asked for: where it comes to an altitude and goes back within
less, at the edge of polar nights, both are missed. Doubled, twice as much is."""
_PASS_EXACT = timedelta(seconds=0.5)
"""An instant is found to this. Doubled, the second that is told may be the next one."""


def sun_altitude_deg(utc: datetime, site: Site) -> float:
    """Altitude of the Sun's center, no refraction, good to an arcminute.

    Parameters
    ----------
    utc : datetime
        Aware.

    Returns
    -------
    float
        Degrees.
    """
    days = utc.timestamp() / SECONDS_PER_DAY
    earth, _ = erfa.epv00(UNIX_ZERO_JD, days + _TT_MINUS_UTC_DAYS)
    sun = -np.asarray(earth["p"])
    ra = math.degrees(math.atan2(sun[1], sun[0])) % 360.0
    dec = math.degrees(math.atan2(sun[2], math.hypot(sun[0], sun[1])))
    return icrs_to_observed(Icrs(ra, dec), utc, site, Air()).alt_deg


def dark_from(utc: datetime, site: Site) -> datetime:
    """The first dark instant from `utc` on: `utc` itself, or when the Sun next gets 18° below the horizon.

    Where it doesn't within a day, in the summer of high latitudes: when it stands lowest.
    """
    if sun_altitude_deg(utc, site) <= _DARK_BELOW_DEG:
        return utc
    day = [utc + number * _STEP for number in range(int(timedelta(days=1) / _STEP) + 1)]
    heights = [sun_altitude_deg(instant, site) for instant in day]
    dark = next((one for one, height in zip(day, heights, strict=True) if height <= _DARK_BELOW_DEG), None)
    return day[heights.index(min(heights))] if dark is None else dark


def next_dark_from(utc: datetime, site: Site) -> datetime:
    """When it gets dark next: after the present night, if it is dark at `utc`.

    Where it never does, in the summer of high latitudes: when the Sun next stands lowest.
    """
    first = dark_from(utc, site)
    if first > utc:
        return first
    solar_h = (utc.hour + utc.minute / 60.0 + site.longitude_deg / 15.0) % 24.0
    # the present night is over by noon
    return dark_from(utc + timedelta(hours=(12.0 - solar_h) % 24.0), site)


@dataclass(frozen=True, slots=True)
class SunPass:
    """An instant at which the Sun's center comes to an altitude.

    Attributes
    ----------
    utc : datetime
        To a second.
    """

    utc: datetime
    rising: bool


@lru_cache(maxsize=64)
def sun_passes(since: datetime, hours: float, altitude_deg: float, site: Site) -> tuple[SunPass, ...]:
    """When the Sun comes to an altitude, in the order of time; empty where it doesn't, as in polar summers.

    Parameters
    ----------
    since : datetime
        Aware. The answer is kept: give a round one, such as a day's noon.
    hours : float
        How far from there; up to some days.
    altitude_deg : float
        Of the center, no refraction: -0.833 where the upper edge is seen to rise, -18 where it gets dark.
    """

    def above(utc: datetime) -> float:
        return sun_altitude_deg(utc, site) - altitude_deg

    steps = math.ceil(hours * 3600.0 / _PASS_STEP.total_seconds())
    instants = [since + number * _PASS_STEP for number in range(steps + 1)]
    heights = [above(instant) for instant in instants]
    found: list[SunPass] = []
    for begin, end, low, high in zip(instants, instants[1:], heights, heights[1:], strict=False):
        if (low < 0.0) == (high < 0.0):
            continue
        rising, (first, last) = high >= 0.0, (begin, end)
        while last - first > _PASS_EXACT:
            middle = first + (last - first) / 2
            if (above(middle) >= 0.0) == rising:
                last = middle
            else:
                first = middle
        found.append(SunPass(last.replace(microsecond=0), rising))
    return tuple(found)


def night_name(telescope: str, utc: datetime, site: Site) -> str:
    """Name the night that an instant belongs to: by the date of its evening, from noon to noon by the Sun.

    The same before and after a restart of the service.
    """
    local = utc + timedelta(hours=site.longitude_deg / 15.0 - 12.0)
    return f"{telescope}-{local.date().isoformat()}"
