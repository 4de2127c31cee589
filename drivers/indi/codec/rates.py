"""Rates behind INDI: its units and signs, and what single drivers are known to make of them; no I/O.

`TRACK_RATE_RA` is no offset: it is the speed of the hour angle axis, ″/s, for a star 15.041067. So what moves
to the east has less of it. `TRACK_RATE_DE` is ″/s, positive to the north [INDI::Telescope].

A driver says of its rates what it was told, never what its mount does. What some are known to do otherwise
stands in `KNOWN`, read in the sources of INDI 1.9.9 to 2.2.4 and measured on fakes of their mounts; what they
get wrong is not ordered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.indi.codec.state import Get, Property, writable
from mountnav.devices import MountAxis, OffsetRates, RateSpan
from mountnav.sky.coordinates import SIDEREAL_DEG_S

MODE, RATE = "TELESCOPE_TRACK_MODE", "TELESCOPE_TRACK_RATE"
SIDEREAL, CUSTOM = "TRACK_SIDEREAL", "TRACK_CUSTOM"
OF_A_STAR_ARCSEC_S = 360.0 * 3600.0 / 86164.098903691
"""`TRACK_RATE_RA` of a star: a turn in a stellar day [INDI indicom.h]. With our own sidereal rate, that
differs in the seventh digit, a star would have an offset rate."""
_MOST_ARCSEC_S = 16384.0
"""Largest value of either rate that `INDI::Telescope` takes, ″/s."""
SPEEDS = "TELESCOPE_SLEW_RATE"
MOTIONS: dict[MountAxis, tuple[str, str, str]] = {
    "primary": ("TELESCOPE_MOTION_WE", "MOTION_EAST", "MOTION_WEST"),
    "secondary": ("TELESCOPE_MOTION_NS", "MOTION_NORTH", "MOTION_SOUTH"),
}
"""By axis: the property, the switch to greater coordinates, and the one to smaller ones."""


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of a driver.

    Attributes
    ----------
    ra_most_arcsec_s, dec_most_arcsec_s : float
        Largest offset rates that it carries out; 0 where it doesn't, or wrongly.
    why : str
        What an operator should know of its rates; empty where they are right.
    speeds_deg_s : tuple of float
        Of its motion by hand, by the switches of TELESCOPE_SLEW_RATE from the first; empty where not known.
    """

    ra_most_arcsec_s: float = _MOST_ARCSEC_S - OF_A_STAR_ARCSEC_S
    dec_most_arcsec_s: float = _MOST_ARCSEC_S
    why: str = ""
    speeds_deg_s: tuple[float, ...] = ()


def _times(*sidereal: float) -> tuple[float, ...]:
    return tuple(SIDEREAL_DEG_S * one for one in sidereal)


_NO_DEC = "it takes no rate in declination, and doesn't say so"
_IOPTRON = _times(1, 2, 8, 16, 64, 128, 256, 512)
_AP_DEC = "it moves south at a rate to the north"
KNOWN: Mapping[str, Known] = {
    "indi_simulator_telescope": Known(speeds_deg_s=(*_times(1), 0.5, 2.5, 6.0)),
    "indi_eqmod_telescope": Known(speeds_deg_s=_times(1, 2, 4, 8, 32, 64, 128, 600, 700, 800)),
    "indi_ieq_telescope": Known(0.01, 0.0, f"{_NO_DEC}; in right ascension at most 0.01″/s", _IOPTRON),
    "indi_ioptronv3_telescope": Known(0.9 * OF_A_STAR_ARCSEC_S, 0.0, _NO_DEC, _IOPTRON),
    "indi_pmc8_telescope": Known(0.0, 0.0, "its offset rates are not those of its mount"),
    "indi_lx200_OnStep": Known(0.0, 0.0, "it sets the speed of motions by hand instead"),
    "indi_lx200ap_gtocp2": Known(dec_most_arcsec_s=0.0, why=_AP_DEC),
    "indi_lx200ap_v2": Known(dec_most_arcsec_s=0.0, why=_AP_DEC),
    "indi_lx200_10micron": Known(0.0, 0.0, "it has the switch for them, and refuses it"),
    "indi_alpaca_telescope": Known(0.0, 0.0, "it passes the rate of a star on as an offset"),
}
"""By the name of the program."""
_UNKNOWN = Known()


def known(program: str) -> Known:
    """What is known of a driver by the name of its program."""
    return KNOWN.get(program, _UNKNOWN)


def takes_offsets(get: Get, driver: Known) -> bool:
    """Whether a driver tracks at rates of one's own, in one coordinate at least, as far as is known."""
    mode, rate = get(MODE), get(RATE)
    there = mode is not None and mode.on(CUSTOM) is not None and mode.on(SIDEREAL) is not None
    return there and writable(rate) and (driver.ra_most_arcsec_s > 0.0 or driver.dec_most_arcsec_s > 0.0)


def said(rates: OffsetRates) -> dict[str, float]:
    """Offset rates as INDI has them."""
    return {"TRACK_RATE_RA": OF_A_STAR_ARCSEC_S - rates.ra_arcsec_s, "TRACK_RATE_DE": rates.dec_arcsec_s}


def told(rate: Property | None) -> OffsetRates | None:
    """The offset rates that a driver says it was told; None where it says no numbers."""
    if rate is None:
        return None
    ra, dec = rate.number("TRACK_RATE_RA"), rate.number("TRACK_RATE_DE")
    return None if ra is None or dec is None else OffsetRates(OF_A_STAR_ARCSEC_S - ra, dec)


def reverses(rate: Property | None, wanted: Mapping[str, float]) -> bool:
    """Whether an axis would turn the other way than before: INDI refuses that while it tracks.

    Its drivers then keep the new numbers all the same, and report them.
    """
    return rate is not None and any((rate.number(key) or 0.0) * value < 0.0 for key, value in wanted.items())


def speeds(get: Get, per_switch_deg_s: tuple[float, ...]) -> dict[str, float]:
    """Speeds of motion by hand by the switches that select them; those without a known one are left out."""
    rate = get(SPEEDS)
    if rate is None or any(get(name) is None for name, _, _ in MOTIONS.values()):
        return {}
    return dict(zip(rate.values, per_switch_deg_s, strict=False))


def spans(speeds_deg_s: Mapping[str, float]) -> dict[MountAxis, tuple[RateSpan, ...]]:
    """The same for both axes, ascending."""
    steps = tuple(RateSpan(speed, speed) for speed in sorted(set(speeds_deg_s.values())))
    return {"primary": steps, "secondary": steps} if steps else {}
