"""What the telescope can: from the mount's skills, and honestly no where nobody may [Alpaca §5]."""

from __future__ import annotations

from collections.abc import Callable

from api.alpaca.member import (
    AXIS,
    AXIS_RANGE,
    Member,
    Parameter,
    always,
    decimal,
    never,
    nothing,
    with_skill,
)
from api.alpaca.members_parking import can_unpark
from api.alpaca.members_slewing import can_slew_alt_az
from api.alpaca.telescope import AlpacaTelescope, Call
from mountnav.devices import Skill

_CAN: dict[str, Callable[[AlpacaTelescope], bool]] = {
    "canfindhome": with_skill(Skill.HOME),
    "canpark": with_skill(Skill.PARK),
    "canpulseguide": with_skill(Skill.GUIDE),
    "cansetdeclinationrate": never,
    "cansetguiderates": never,
    "cansetpark": with_skill(Skill.SET_PARK),
    "cansetpierside": never,
    "cansetrightascensionrate": never,
    "cansettracking": with_skill(Skill.TRACK),
    "canslew": always,
    "canslewasync": always,
    "canslewaltaz": can_slew_alt_az,
    "canslewaltazasync": can_slew_alt_az,
    "cansync": always,
    "cansyncaltaz": never,
    "canunpark": can_unpark,
}


def _can(able: Callable[[AlpacaTelescope], bool]) -> Callable[[AlpacaTelescope, Call], object]:
    return lambda device, call: able(device)


_ENDLESS = "motion at a rate has no end that a limit could be checked against: slew, or guide by pulses"

MEMBERS: tuple[Member, ...] = (
    *(Member("GET", name, _can(able), default=False) for name, able in _CAN.items()),
    # motion at a rate until told otherwise: nothing could check where it ends
    Member("GET", "canmoveaxis", lambda device, call: False, (AXIS,), ranges=(AXIS_RANGE,), default=False),
    Member("GET", "axisrates", lambda device, call: [], (AXIS,), ranges=(AXIS_RANGE,), default=[]),
    Member("PUT", "moveaxis", nothing, (AXIS, Parameter("Rate", decimal)), never, why_not=_ENDLESS),
)

__all__ = ["MEMBERS"]
