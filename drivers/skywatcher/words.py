"""The values that travel between a host and a Sky-Watcher motor controller, as they stand on the wire.

Numbers of 24 bits are hex with their bytes swapped: 0x123456 travels as ``563412``; positions are counted
from 0x800000 [SKYWATCHER]. A ratio of 8 bits is plain hex. Status is three digits of flags [SKYWATCHER :f].
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

from drivers.wire.command import Unreadable
from mountnav.errors import Refusal

POSITION_ZERO = 0x800000
LARGEST = 0xFFFFFF
_HEX6 = re.compile(r"[0-9A-F]{6}")


class Axis(IntEnum):
    """Which motor."""

    HOUR_ANGLE = 1
    DECLINATION = 2


@dataclass(frozen=True, slots=True)
class Nack:
    """An answer ``!code``: understood as a message, and refused.

    Attributes
    ----------
    code : str
        One hex digit.
    """

    code: str

    @property
    def words(self) -> str:
        """What the code means."""
        return _NACKS.get(self.code, ("refused for a reason it numbers " + self.code, Refusal.OTHER))[0]

    @property
    def reason(self) -> Refusal:
        """Why, as far as the code tells."""
        return _NACKS.get(self.code, ("", Refusal.OTHER))[1]


# owners saw 0, 1 and 3 on real boards; 4 may never come: there are boards that start uninitialized motors
_NACKS = {
    "0": ("it doesn't know the command", Refusal.UNSUPPORTED),
    "1": ("the command has the wrong length", Refusal.OTHER),
    "2": ("the motor is not stopped", Refusal.BUSY),
    "3": ("the command has a character that is no hex digit", Refusal.OTHER),
    "4": ("the motor is not initialized", Refusal.NOT_ALIGNED),
    "5": ("the driver is asleep", Refusal.OTHER),
    "7": ("the training of its periodic error correction runs", Refusal.BUSY),
    "8": ("it holds no valid periodic error correction", Refusal.OTHER),
}


@dataclass(frozen=True, slots=True)
class MotorStatus:
    """What one motor does [SKYWATCHER :f].

    Attributes
    ----------
    goto : bool
        It runs to a target by itself; else it runs on until stopped.
    backward : bool
        Counts go down.
    fast : bool
        High speed range.
    running : bool
        It turns; also while it slows down after a stop.
    blocked : bool
        It can't turn (only boards that drive direct current motors tell).
    initialized : bool
        It was energized since power-up: False is the sign of a power-up.
    level : bool
        A switch that only altazimuth mounts have.
    """

    goto: bool
    backward: bool
    fast: bool
    running: bool
    blocked: bool
    initialized: bool
    level: bool = False

    def text(self) -> str:
        """Three digits for the wire."""
        first = (not self.goto) | self.backward << 1 | self.fast << 2
        return f"{first:X}{self.running | self.blocked << 1:X}{self.initialized | self.level << 1:X}"


def read_status(text: str) -> MotorStatus:
    """Read three digits of flags. Raises `Unreadable`."""
    if not re.fullmatch(r"[0-9A-F]{3}", text):
        raise Unreadable(f"{text!r} is no status")
    mode, motion, power = (int(digit, 16) for digit in text)
    if mode > 7 or motion > 3 or power > 3:
        raise Unreadable(f"{text!r} has flags that no board has")
    return MotorStatus(
        goto=not mode & 1,
        backward=bool(mode & 2),
        fast=bool(mode & 4),
        running=bool(motion & 1),
        blocked=bool(motion & 2),
        initialized=bool(power & 1),
        level=bool(power & 2),
    )


@dataclass(frozen=True, slots=True)
class Board:
    """Who answers: firmware and model of the board [SKYWATCHER :e]."""

    major: int
    minor: int
    model: int

    @property
    def name(self) -> str:
        """Name of the mount, as far as the number is known."""
        return MODELS.get(self.model, f"mount of model {self.model:02X}")

    @property
    def text(self) -> str:
        """In words."""
        return f"Sky-Watcher {self.name}, firmware {self.major:X}.{self.minor:02X}"

    def wire(self) -> str:
        """Six digits for the wire."""
        return f"{self.major:02X}{self.minor:02X}{self.model:02X}"


MODELS = {
    0x00: "EQ6",
    0x01: "HEQ5",
    0x02: "EQ5",
    0x03: "EQ3",
    0x04: "EQ8",
    0x05: "AZ-EQ6",
    0x06: "AZ-EQ5",
    0x0C: "Star Adventurer GTi",
    0x80: "80GT",
    0x81: "MF",
    0x82: "114GT",
    0x90: "Dobsonian",
}
NOT_EQUATORIAL = frozenset({0x80, 0x81, 0x82, 0x90})


def read_board(text: str) -> Board:
    """Read six digits: major, minor, model - not swapped. Raises `Unreadable`."""
    if not _HEX6.fullmatch(text):
        raise Unreadable(f"{text!r} is no version")
    return Board(*(int(text[at : at + 2], 16) for at in (0, 2, 4)))


@dataclass(frozen=True, slots=True)
class Features:
    """What a newer board has [SKYWATCHER :q]; older ones don't know the question."""

    flags: int

    @property
    def pec_training(self) -> bool:
        """Whether the training of its periodic error correction runs."""
        return bool(self.flags & 0x10)

    @property
    def encoders(self) -> bool:
        """Whether it has encoders on its axes."""
        return bool(self.flags & 0x01)

    @property
    def home_sensors(self) -> bool:
        """Whether it has sensors that mark its home."""
        return bool(self.flags & 0x04)

    @property
    def wifi(self) -> bool:
        """Whether it has a network of its own."""
        return bool(self.flags & 0x8000)


def read_features(text: str) -> Features:
    """Read six digits of flags. Raises `Unreadable`."""
    return Features(number(text))


def number(text: str) -> int:
    """Read a number of 24 bits. Raises `Unreadable`."""
    if not _HEX6.fullmatch(text):
        raise Unreadable(f"{text!r} is no number of 24 bits")
    return int(text[4:6] + text[2:4] + text[0:2], 16)


def number_text(value: int) -> str:
    """Write a number of 24 bits. Raises `ValueError` for one that has more."""
    if not 0 <= value <= LARGEST:
        raise ValueError(f"{value} doesn't fit in 24 bits")
    text = f"{value:06X}"
    return text[4:6] + text[2:4] + text[0:2]


def ratio(text: str) -> int:
    """Read a ratio: two plain digits, or six swapped ones (imitations). Raises `Unreadable`."""
    value = int(text, 16) if re.fullmatch(r"[0-9A-F]{2}", text) else number(text)
    if not 1 <= value <= 0xFF:
        raise Unreadable(f"{text!r} is no ratio")
    return value
