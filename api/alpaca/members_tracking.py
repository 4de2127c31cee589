"""Members that track and guide. There are no offsets of rates: no limit of ours would hold [Alpaca §5]."""

from __future__ import annotations

from typing import Literal

from api.alpaca.errors import invalid_operation, invalid_value, parked
from api.alpaca.member import Member, Parameter, Range, decimal, never, nothing, truth, whole, with_skill
from api.alpaca.motion import DIRECTIONS
from api.alpaca.telescope import AlpacaTelescope, Call
from api.orders.vocabulary import GuideOrder, TrackingOrder
from mountnav.devices import Skill, TrackingRate

RATES = (TrackingRate.SIDEREAL, TrackingRate.LUNAR, TrackingRate.SOLAR, TrackingRate.KING)
"""As Alpaca counts them: 0 to 3."""
LONGEST_PULSE_MS = 60_000
"""Longest pulse, ms: that of `GuideOrder.duration_s`. A larger one would be taken here and refused
there."""


def rates_of(device: AlpacaTelescope) -> tuple[TrackingRate, ...]:
    """The rates that the mount takes, in Alpaca's order; sidereal alone where it has no choice."""
    if not device.can(Skill.TRACKING_RATES):
        return (TrackingRate.SIDEREAL,)
    told = device.mount.told("tracking_rates")
    known = told if isinstance(told, frozenset) else _UNKNOWN
    return tuple(rate for rate in RATES if rate is TrackingRate.SIDEREAL or rate in known)


def rate_of(device: AlpacaTelescope) -> TrackingRate:
    """The rate in force: as last ordered, by whatever face; else as asked for here; else sidereal."""
    ordered = device.mount.tracking_rate if device.is_tracking else None
    found = ordered or device.rate or TrackingRate.SIDEREAL
    return found if found in RATES else TrackingRate.SIDEREAL


_WORDS: dict[TrackingRate, Literal["sidereal", "lunar", "solar", "king"]] = {
    TrackingRate.SIDEREAL: "sidereal",
    TrackingRate.LUNAR: "lunar",
    TrackingRate.SOLAR: "solar",
    TrackingRate.KING: "king",
}
_UNKNOWN = frozenset({TrackingRate.LUNAR, TrackingRate.SOLAR})
"""Taken to be there on a mount that has rates and doesn't tell which."""


async def _set_tracking(device: AlpacaTelescope, call: Call) -> None:
    on = call.flag("Tracking")
    if device.is_parked:
        if on:
            raise parked("Tracking True")
        return
    if device.is_slewing and on and device.reading.tracking:
        return  # it does, and will when it is there
    await device.carry_out(call, TrackingOrder(on=on, rate=_WORDS[device.rate or rate_of(device)]))


async def _set_rate(device: AlpacaTelescope, call: Call) -> None:
    number = int(call.number("TrackingRate"))
    known = rates_of(device)
    if not 0 <= number < len(RATES) or RATES[number] not in known:
        can = ", ".join(f"{RATES.index(rate)} ({rate})" for rate in known)
        raise invalid_value("TrackingRate", number, f"this mount can {can}")
    rate = RATES[number]
    if device.can(Skill.TRACKING_RATES) and device.is_tracking and not device.is_parked:
        await device.carry_out(call, TrackingOrder(on=True, rate=_WORDS[rate]))
    device.rate = rate


def _guide_rates_deg_s(device: AlpacaTelescope) -> tuple[float, float] | None:
    """How fast a pulse moves in right ascension and in declination, where the mount tells."""
    match device.mount.told("guide_rates_deg_s"):
        case (float(ra_deg_s), float(dec_deg_s)):
            return ra_deg_s, dec_deg_s
    return None


def _tells_guide_rates(device: AlpacaTelescope) -> bool:
    return device.can(Skill.GUIDE) and _guide_rates_deg_s(device) is not None


def _guide_rate_ra(device: AlpacaTelescope, call: Call) -> float:
    return (_guide_rates_deg_s(device) or (0.0, 0.0))[0]


def _guide_rate_dec(device: AlpacaTelescope, call: Call) -> float:
    return (_guide_rates_deg_s(device) or (0.0, 0.0))[1]


async def _guide(device: AlpacaTelescope, call: Call) -> None:
    if device.is_slewing:
        raise invalid_operation("no guide pulse while the telescope slews")
    duration_ms = call.number("Duration")
    if duration_ms == 0:
        return
    direction = DIRECTIONS[int(call.number("Direction"))]
    await device.pulses.guide(call.caller, GuideOrder(direction=direction, duration_s=duration_ms / 1000.0))


_GUIDE_RATES = {"GuideRateRightAscension": _guide_rate_ra, "GuideRateDeclination": _guide_rate_dec}
_UNTOLD = "the mount doesn't tell it"
_AT_THE_MOUNT = "it is set at the mount"
_OFFSETS = "an offset of the tracking rate has no end that a limit could be checked against"

MEMBERS: tuple[Member, ...] = (
    Member(
        "PUT",
        "tracking",
        _set_tracking,
        (Parameter("Tracking", truth),),
        with_skill(Skill.TRACK),
        orders="tracking",
    ),
    Member(
        "GET",
        "trackingrates",
        lambda device, call: [RATES.index(rate) for rate in rates_of(device)],
        default=[],
    ),
    Member("GET", "trackingrate", lambda device, call: RATES.index(rate_of(device))),
    Member("PUT", "trackingrate", _set_rate, (Parameter("TrackingRate", whole),), orders="tracking"),
    Member("GET", "rightascensionrate", lambda device, call: 0.0, default=0.0),
    Member(
        "PUT",
        "rightascensionrate",
        nothing,
        (Parameter("RightAscensionRate", decimal),),
        never,
        why_not=_OFFSETS,
    ),
    Member("GET", "declinationrate", lambda device, call: 0.0, default=0.0),
    Member(
        "PUT", "declinationrate", nothing, (Parameter("DeclinationRate", decimal),), never, why_not=_OFFSETS
    ),
    Member(
        "PUT",
        "pulseguide",
        _guide,
        (Parameter("Direction", whole), Parameter("Duration", whole)),
        with_skill(Skill.GUIDE),
        (Range("Direction", 0, 3), Range("Duration", 0, LONGEST_PULSE_MS)),
        parked=False,
        orders="guide",
    ),
    *(
        Member("GET", name.lower(), rate, able=_tells_guide_rates, default=0.0, why_not=_UNTOLD)
        for name, rate in _GUIDE_RATES.items()
    ),
    *(
        Member("PUT", name.lower(), nothing, (Parameter(name, decimal),), never, why_not=_AT_THE_MOUNT)
        for name in _GUIDE_RATES
    ),
)

__all__ = ["LONGEST_PULSE_MS", "MEMBERS", "RATES", "rate_of", "rates_of"]
