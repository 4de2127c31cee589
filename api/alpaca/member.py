"""A member of the interface as data: what it is called, what it takes, what it needs, what it does."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal

from api.alpaca.codec import decimal, truth, whole, words
from api.alpaca.errors import invalid_value
from api.alpaca.telescope import AlpacaTelescope, Call
from mountnav.devices import Skill

Read = Callable[[str, str], object]
Act = Callable[[AlpacaTelescope, Call], object]
ActLater = Callable[[AlpacaTelescope, Call], Awaitable[object]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a member's own.

    Attributes
    ----------
    name : str
        In the standard's case.
    read : callable
        Its text as a value; raises `BadParameter`.
    fallback : object
        If it may be left out.
    """

    name: str
    read: Read
    fallback: object = None


@dataclass(frozen=True, slots=True)
class Range:
    """What a parameter's value must lie in.

    Attributes
    ----------
    below : bool
        Whether `high` itself is out.
    """

    name: str
    low: float
    high: float
    below: bool = False

    def check(self, call: Call) -> None:
        """Raise 0x401 if it doesn't."""
        value = call.number(self.name)
        if not self.low <= value or value > self.high or (self.below and value == self.high):
            wanted = f"{self.low:g} up to {self.high:g}" + (", which is out itself" if self.below else "")
            raise invalid_value(self.name, value, wanted)


def always(device: AlpacaTelescope) -> bool:
    """Whatever the mount is."""
    return True


def never(device: AlpacaTelescope) -> bool:
    """Not by this server, whatever the mount is: docs/how-to/alpaca.md tells why."""
    return False


def with_skill(*skills: Skill) -> Callable[[AlpacaTelescope], bool]:
    """If the mount has all of these skills."""

    def able(device: AlpacaTelescope) -> bool:
        return device.can(*skills)

    return able


@dataclass(frozen=True, slots=True)
class Member:
    """A member and one of its verbs.

    Attributes
    ----------
    name : str
        As in the path.
    act : callable
        Gives the value of a GET; does what a PUT asks. May be a coroutine function. Raises `AlpacaError`,
        or errors of the core.
    able : callable
        Whether this is implemented for the device; else 0x400.
    ranges : tuple of Range
        0x401 outside.
    parked : bool
        Whether it is possible while parked; else 0x408.
    offline : bool
        Whether it works while not connected.
    default : object
        The value that stands in the answer to a GET that failed: clients of fixed types read it before they
        look at the error's number.
    answers : bool
        Whether the answer has a value; None of the PUTs but actions and commands.
    orders : str
        The kind of what it orders of the core; empty if nothing.
    why_not : str
        Why it is not implemented, where that isn't the mount's doing.
    """

    verb: Literal["GET", "PUT"]
    name: str
    act: Act | ActLater
    takes: tuple[Parameter, ...] = ()
    able: Callable[[AlpacaTelescope], bool] = always
    ranges: tuple[Range, ...] = ()
    parked: bool = True
    offline: bool = False
    default: object = 0
    answers: bool = False
    orders: str = ""
    why_not: str = ""

    @property
    def has_value(self) -> bool:
        """Whether its answer has a value."""
        return self.verb == "GET" or self.answers


def nothing(device: AlpacaTelescope, call: Call) -> object:
    """What a member does that is never able to."""
    return None


RA = Parameter("RightAscension", decimal)
DEC = Parameter("Declination", decimal)
ALT = Parameter("Altitude", decimal)
AZ = Parameter("Azimuth", decimal)
RA_RANGE = Range("RightAscension", 0.0, 24.0, below=True)
DEC_RANGE = Range("Declination", -90.0, 90.0)
ALT_RANGE = Range("Altitude", -90.0, 90.0)
AZ_RANGE = Range("Azimuth", 0.0, 360.0, below=True)
AXIS = Parameter("Axis", whole)
AXIS_RANGE = Range("Axis", 0, 2)

__all__ = [
    "ALT",
    "ALT_RANGE",
    "AXIS",
    "AXIS_RANGE",
    "AZ",
    "AZ_RANGE",
    "DEC",
    "DEC_RANGE",
    "RA",
    "RA_RANGE",
    "Act",
    "ActLater",
    "Member",
    "Parameter",
    "Range",
    "always",
    "decimal",
    "never",
    "nothing",
    "truth",
    "whole",
    "with_skill",
    "words",
]
