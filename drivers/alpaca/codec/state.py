"""What an Alpaca telescope claims, as the values that a reading is made of; no I/O, no clock [Alpaca §5]."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from drivers.alpaca.codec.base import Malformed, integer, number, truth
from mountnav.devices import Direction, Epoch, PierSide, Skill, TrackingRate
from mountnav.sky.coordinates import Apparent, Icrs

EPOCHS: dict[int, Epoch] = {1: "apparent", 2: "icrs"}
"""EquatorialSystem: topocentric is "JNow", J2000 is taken as ICRS (0.02″ apart)."""
SYSTEMS = {0: "other", 1: "topocentric (JNow)", 2: "J2000", 3: "J2050", 4: "B1950"}
"""What `EquatorialSystem` numbers mean [Alpaca EquatorialCoordinateType]."""
RATES = {
    TrackingRate.SIDEREAL: 0,
    TrackingRate.LUNAR: 1,
    TrackingRate.SOLAR: 2,
    TrackingRate.KING: 3,
}
"""Numbers of `TrackingRate` [Alpaca DriveRates]."""
PULSES = {Direction.NORTH: 0, Direction.SOUTH: 1, Direction.EAST: 2, Direction.WEST: 3}
"""Numbers of directions in `PulseGuide` [Alpaca GuideDirections]."""
CAN = (
    "canpark",
    "canunpark",
    "cansetpark",
    "canfindhome",
    "cansettracking",
    "canslew",
    "canslewasync",
    "cansync",
    "canpulseguide",
)
_SIDES = {-1: PierSide.UNKNOWN, 0: PierSide.EAST, 1: PierSide.WEST}
"""What `SideOfPier` numbers mean [Alpaca PierSide]."""
_LARGEST_RA_H = 24.0
"""24 itself passes, and is taken for 0."""


def place(ra: object, dec: object, epoch: Epoch, utc: datetime) -> Apparent | Icrs:
    """Read a place in hours and degrees.

    Raises
    ------
    Malformed
        If it is none.
    """
    ra_deg = (15.0 * number(ra, 0.0, _LARGEST_RA_H)) % 360.0
    dec_deg = number(dec, -90.0, 90.0)
    return Icrs(ra_deg, dec_deg) if epoch == "icrs" else Apparent(ra_deg, dec_deg, utc)


def said_place(where: Apparent | Icrs) -> dict[str, float]:
    """Say a place in hours and degrees; hours never reach 24 by rounding."""
    return {"RightAscension": round(where.ra_deg / 15.0, 10) % 24.0, "Declination": where.dec_deg}


def maybe_truth(state: Mapping[str, Any], name: str) -> bool | None:
    """Whether something is so, or None where the state doesn't say."""
    value = state.get(name)
    return None if value is None else truth(value)


def pier_side(value: object) -> PierSide | None:
    """On which side the tube hangs; Alpaca's "east" is the normal posture, looking west, as ours.

    Raises
    ------
    Malformed
        If it is no side.
    """
    if value is None:
        return None
    side = _SIDES.get(integer(value))
    if side is None:
        raise Malformed(f"{value!r} where a side of the pier belongs")
    return side


def skills(can: Mapping[str, bool], implemented: frozenset[str], *, finds_home: bool) -> frozenset[Skill]:
    """What a telescope can do.

    Parameters
    ----------
    can : mapping of str to bool
        What its Can… members say.
    implemented : frozenset of str
        Members that can be read.
    finds_home : bool
        Whether its home is found by a sensor: Alpaca doesn't say, so the configuration must.
    """
    there = {
        Skill.PARK: can.get("canpark", False),
        Skill.UNPARK: can.get("canunpark", False),
        Skill.SET_PARK: can.get("cansetpark", False),
        Skill.HOME: can.get("canfindhome", False),
        Skill.FIND_HOME: can.get("canfindhome", False) and finds_home,
        Skill.TRACK: can.get("cansettracking", False),
        Skill.TRACKING_RATES: "trackingrates" in implemented,
        Skill.GUIDE: can.get("canpulseguide", False),
        Skill.OFFSET_RATES: can.get("cansetrightascensionrate", False)
        and can.get("cansetdeclinationrate", False),
        Skill.PIER_SIDE: "sideofpier" in implemented,
        Skill.DESTINATION_SIDE: "destinationsideofpier" in implemented,
        Skill.CLOCK: "utcdate" in implemented,
        Skill.SET_CLOCK: "utcdate" in implemented,
        Skill.SITE: "sitelatitude" in implemented,
        Skill.SET_SITE: "sitelatitude" in implemented,
    }
    return frozenset(skill for skill, has in there.items() if has)
