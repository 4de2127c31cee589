"""Rates of an Alpaca telescope: their units and signs, and which values are none; no I/O.

`RightAscensionRate` is in seconds of right ascension per *sidereal* second, positive to the east;
`DeclinationRate` in arcseconds per SI second, positive to the north; both beside the sidereal rate [ASCOM
ITelescopeV4]. Drivers have had the first one wrong by its sign, by 15 and by 220.

Which way a positive `MoveAxis` turns an axis is left open on purpose [ASCOM, FAQ on MoveAxis].
"""

from __future__ import annotations

from collections.abc import Mapping

from drivers.alpaca.codec.base import Malformed, number
from mountnav.devices import MountAxis, OffsetRates, PierSide, RateSpan
from mountnav.sky.coordinates import SOLAR_TO_SIDEREAL

_ARCSEC_IN_S = 15.0
"""Arcseconds in a second of right ascension."""
_FASTEST_ARCSEC_S = 1e6
"""A rate that is read back and lies beyond (278°/s) is nonsense."""
_FASTEST_DEG_S = 360.0
"""A span of speeds of an axis that goes beyond is nonsense: a turn in a second."""
_MOST_SPANS = 64
"""So many spans of an axis are read; more are nonsense. Chosen by hand: mounts have one, or ten steps."""

AXES: dict[MountAxis, int] = {"primary": 0, "secondary": 1}
"""Numbers of axes [ASCOM TelescopeAxes]."""
ALIGNED_ALT_AZ = 0
"""`AlignmentMode` of a mount whose axes are azimuth and altitude [ASCOM AlignmentModes]."""


def said_ra_rate(ra_arcsec_s: float) -> float:
    """`RightAscensionRate` of a rate in ″ per SI second: a sidereal second is shorter by 0.27 %."""
    return ra_arcsec_s / _ARCSEC_IN_S / SOLAR_TO_SIDEREAL


def told_rates(ra: object, dec: object) -> OffsetRates:
    """Read `RightAscensionRate` and `DeclinationRate`.

    Raises
    ------
    Malformed
        If one is no number, or beyond all sense.
    """
    ra_s_s = number(ra, -_FASTEST_ARCSEC_S, _FASTEST_ARCSEC_S)
    return OffsetRates(
        ra_s_s * _ARCSEC_IN_S * SOLAR_TO_SIDEREAL, number(dec, -_FASTEST_ARCSEC_S, _FASTEST_ARCSEC_S)
    )


def spans(value: object) -> tuple[RateSpan, ...]:
    """Read `AxisRates`, ascending; spans that overlap are joined, and 0 alone is no speed.

    Raises
    ------
    Malformed
        If it is no list of spans, or one goes beyond all sense.
    """
    if not isinstance(value, list) or len(value) > _MOST_SPANS:
        raise Malformed(f"{value!r:.80} where speeds of an axis belong")
    read = []
    for one in value:
        if not isinstance(one, Mapping):
            raise Malformed(f"{one!r:.80} where a span of speeds belongs")
        by_name = {str(name).lower(): told for name, told in one.items()}
        least = number(by_name.get("minimum"), 0.0, _FASTEST_DEG_S)
        most = number(by_name.get("maximum"), least, _FASTEST_DEG_S)
        if most > 0.0:
            read.append(RateSpan(least, most))
    joined: list[RateSpan] = []
    for span in sorted(read, key=lambda one: (one.least_deg_s, one.most_deg_s)):
        if joined and span.least_deg_s <= joined[-1].most_deg_s:
            last = joined.pop()
            span = RateSpan(last.least_deg_s, max(last.most_deg_s, span.most_deg_s))
        joined.append(span)
    return tuple(joined)


def usual_sign(axis: MountAxis, side: PierSide | None, *, alt_az: bool) -> float:
    """Which sign of `MoveAxis` moves the tube to greater coordinates, on a mount that nobody has watched yet.

    As the simulator of ASCOM's makers has it, and Conform with it: the primary axis turns with the hour angle
    (against the right ascension), or with the azimuth; the secondary one raises the declination on the normal
    side of the pier and lowers it beyond the pole.
    """
    if alt_az:
        return 1.0
    if axis == "primary":
        return -1.0
    return -1.0 if side is PierSide.WEST else 1.0
