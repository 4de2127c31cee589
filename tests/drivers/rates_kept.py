"""What a fake's tube truly does among the stars: the judge of the rates that it was ordered."""

from __future__ import annotations

from datetime import datetime, timedelta

from mountnav.devices import PierSide
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import half_turn_deg


def kept_rates(
    mechanics: Mechanics, begin: datetime | None = None, *, for_s: float = 200.0, planned: bool = False
) -> tuple[float, float]:
    """The rates of apparent right ascension and declination at which the tube will move, ″/s.

    What the mechanics will do is asked for, so that nobody waits: from two seconds on, when all ramps are
    over. The air and the errors of the mount bend it by far less than a thousandth where it stands high.

    Parameters
    ----------
    planned : bool
        Over a second only, of a motion that is fast.
    """
    begin = (begin or mechanics._clock()) + timedelta(seconds=2.0)
    if planned:
        for_s = 1.0
    one, two = (
        mechanics.reported(begin),
        mechanics.reported(begin + timedelta(seconds=for_s)),
    )
    ra = half_turn_deg(two.ra_deg - one.ra_deg) * 3600.0 / for_s
    return ra, (two.dec_deg - one.dec_deg) * 3600.0 / for_s


def beside_the_meridian(mechanics: Mechanics, side: PierSide, dec_deg: float = 10.0) -> Apparent:
    """A place that a German mount looks at from a side: a little west of the meridian from the east one."""
    utc = mechanics._clock()
    hours_west = 0.3 if side is PierSide.EAST else -0.3
    return Apparent((sidereal_time_deg(utc, mechanics.site) - 15.0 * hours_west) % 360.0, dec_deg, utc)
