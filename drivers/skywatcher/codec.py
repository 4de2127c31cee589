"""Sky-Watcher motor controller commands, their values and the readers of their replies; no I/O.

Numbers of 24 bits are hex with their bytes swapped: 0x123456 travels as ``563412``; positions are counted
from 0x800000 [SKYWATCHER]. A ratio of 8 bits is plain hex. Status is three digits of flags [SKYWATCHER :f].

``:`` command axis data CR is answered ``=`` data CR or ``!`` code CR. Replies don't say what they answer, and
many are of one length, so a reader asks for the exact length and leaves the rest to the exchange (and, for
positions, to what an axis can have reached).

A board that got a question damaged says ``!1`` or ``!3``: that is no answer of the mount and is asked again.
All commands but ``:J`` may be sent twice: they set registers, and only ``:J`` starts a motor.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

from drivers.wire.command import Command, Read, Unreadable
from mountnav.errors import Refusal

POSITION_ZERO = 0x800000
"""The count that a board gives an axis at power-up: the middle of its 24 bits, so that both ways are free
[SKYWATCHER :j]."""
LARGEST = 0xFFFFFF
"""Numbers have 24 bits on this wire [SKYWATCHER]."""
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
        """Why, as far as the code says."""
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
        It can't turn (only boards that drive direct current motors report it).
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
        raise Unreadable(f"{text!r} is not a status")
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
"""Names of mounts by the last byte of the board's answer [SKYWATCHER :e, INDI eqmod]."""
NOT_EQUATORIAL = frozenset({0x80, 0x81, 0x82, 0x90})
"""Models of that list that stand in azimuth and altitude."""


def read_board(text: str) -> Board:
    """Read six digits: major, minor, model - not swapped. Raises `Unreadable`."""
    if not _HEX6.fullmatch(text):
        raise Unreadable(f"{text!r} is not a version")
    return Board(*(int(text[at : at + 2], 16) for at in (0, 2, 4)))


@dataclass(frozen=True, slots=True)
class Features:
    """What a newer board has [SKYWATCHER :q]; older ones don't know the question."""

    flags: int

    @property
    def encoders(self) -> bool:
        """Whether it has encoders on its axes."""
        return bool(self.flags & 0x01)


def read_features(text: str) -> Features:
    """Read six digits of flags. Raises `Unreadable`."""
    return Features(number(text))


def number(text: str) -> int:
    """Read a number of 24 bits. Raises `Unreadable`."""
    if not _HEX6.fullmatch(text):
        raise Unreadable(f"{text!r} is not a number of 24 bits")
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
        raise Unreadable(f"{text!r} is not a ratio")
    return value


T = TypeVar("T")
_END = b"\r"
_LONGEST = 8
"""A reply without its end after so many bytes is damaged: the longest ones are `=`, six digits and a
carriage return."""


def _whole(buffer: bytes) -> tuple[bytes, str, int] | None:
    """Cut one answer off the front: its first byte, its data, its length; None while it isn't whole."""
    if buffer[:1] not in (b"", b"=", b"!"):
        raise Unreadable(f"{buffer!r} begins with neither = nor !")
    end = buffer.find(_END)
    if end < 0:
        if len(buffer) > _LONGEST:
            raise Unreadable(f"{buffer!r} is longer than any answer")
        return None
    return buffer[:1], buffer[1:end].decode("latin-1"), end + 1


def _answer(understand: Callable[[str], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """Make a reader of an answer that is never refused: a board that refuses it got it damaged."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        whole = _whole(buffer)
        if whole is None:
            return None
        kind, text, length = whole
        if kind == b"!":
            raise Unreadable(f"refused with code {text!r}")
        return Read(understand(text), length)

    return read


def _answer_or_nack(
    understand: Callable[[str], T], codes: str
) -> Callable[[bytes, bool], Read[T | Nack] | None]:
    """Make a reader of an answer or of a refusal by one of some codes."""

    def read(buffer: bytes, final: bool) -> Read[T | Nack] | None:
        whole = _whole(buffer)
        if whole is None:
            return None
        kind, text, length = whole
        if kind == b"=":
            return Read(understand(text), length)
        if len(text) != 1 or text not in codes:
            raise Unreadable(f"refused with code {text!r}")
        return Read(Nack(text), length)

    return read


def _count(smallest: int, largest: int) -> Callable[[str], int]:
    def understand(text: str) -> int:
        value = number(text)
        if not smallest <= value <= largest:
            raise Unreadable(f"{value} is not between {smallest} and {largest}")
        return value

    return understand


def _nothing(text: str) -> None:
    if text:
        raise Unreadable(f"{text!r} where nothing was expected")


def _ask(letter: str, axis: Axis, meaning: str, understand: Callable[[str], T], data: str = "") -> Command[T]:
    # a question that is refused at all arrived damaged: asked again, and nonsense in the end
    sent = f":{letter}{int(axis)}{data}\r".encode("ascii")
    return Command(sent, f"{meaning} of axis {int(axis)}", _answer(understand))


def _set(
    letter: str, axis: Axis, meaning: str, data: str = "", *, repeatable: bool = True
) -> Command[Nack | None]:
    sent = f":{letter}{int(axis)}{data}\r".encode("ascii")
    refusals = "0245678" if repeatable else "012345678"
    return Command(
        sent, f"{meaning} of axis {int(axis)}", _answer_or_nack(_nothing, refusals), repeatable=repeatable
    )


# -- questions ---------------------------------------------------------------------------------------


def board() -> Command[Board]:
    """Ask for firmware and model [SKYWATCHER :e]."""
    return _ask("e", Axis.HOUR_ANGLE, "version", read_board)


def counts_per_turn(axis: Axis) -> Command[int]:
    """Ask how many counts make one turn [SKYWATCHER :a]."""
    return _ask("a", axis, "counts per turn", _count(100_000, 0xFFFFFF))


def timer_hz(axis: Axis) -> Command[int]:
    """Ask for the frequency that step periods are counted in [SKYWATCHER :b]."""
    return _ask("b", axis, "timer frequency", _count(1_000, 0xFFFFFF))


def fast_ratio(axis: Axis) -> Command[int]:
    """Ask by how much the high speed range is faster [SKYWATCHER :g]."""
    return _ask("g", axis, "high speed ratio", ratio)


def features(axis: Axis) -> Command[Features | Nack]:
    """Ask what the board has [SKYWATCHER :q]; older boards answer ``!0``."""
    sent = f":q{int(axis)}010000\r".encode("ascii")
    return Command(sent, f"features of axis {int(axis)}", _answer_or_nack(read_features, "0123"))


def status(axis: Axis) -> Command[MotorStatus]:
    """Ask what a motor does [SKYWATCHER :f]."""
    return _ask("f", axis, "status", read_status)


def position(axis: Axis) -> Command[int]:
    """Ask for the count of an axis, 0x800000 at power-up [SKYWATCHER :j]."""
    return _ask("j", axis, "position", number)


def step_period(axis: Axis) -> Command[int]:
    """Ask for the step period in force, in ticks of the timer [SKYWATCHER :i]."""
    return _ask("i", axis, "step period", number)


def sidereal_period(axis: Axis) -> Command[int]:
    """Ask for the step period that the board itself takes for sidereal [SKYWATCHER :D]."""
    return _ask("D", axis, "sidereal step period", number)


# -- orders ------------------------------------------------------------------------------------------


def energize(axis: Axis) -> Command[Nack | None]:
    """Switch a motor's current on [SKYWATCHER :F]; it doesn't move, and its count stays."""
    return _set("F", axis, "energizing")


def set_position(axis: Axis, count: int) -> Command[Nack | None]:
    """Give the present place a count; only at rest [SKYWATCHER :E]."""
    return _set("E", axis, "setting the position", number_text(count))


def motion(axis: Axis, *, goto: bool, fast: bool, backward: bool) -> Command[Nack | None]:
    """Choose how it will run; refused while it runs [SKYWATCHER :G]."""
    mode = (0 if fast else 2) if goto else (3 if fast else 1)
    return _set("G", axis, "motion mode", f"{mode}{int(backward)}")


def goto_by(axis: Axis, counts: int) -> Command[Nack | None]:
    """Choose how far the next goto runs from here, in the direction of `motion` [SKYWATCHER :H]."""
    return _set("H", axis, "goto increment", number_text(counts))


def brake_by(axis: Axis, counts: int) -> Command[Nack | None]:
    """Choose how long before its target a goto slows down [SKYWATCHER :M]."""
    return _set("M", axis, "brake increment", number_text(counts))


def period(axis: Axis, ticks: int) -> Command[Nack | None]:
    """Set the step period; taken at once by a motor that runs slowly [SKYWATCHER :I]."""
    return _set("I", axis, "step period", number_text(ticks))


def start(axis: Axis) -> Command[Nack | None]:
    """Start a motor [SKYWATCHER :J]. The one command that must not be sent twice."""
    return _set("J", axis, "start", repeatable=False)


def slow_down(axis: Axis) -> Command[Nack | None]:
    """Stop a motor by its ramp [SKYWATCHER :K]; the answer comes long before it rests."""
    return _set("K", axis, "stop")


def stop_hard(axis: Axis) -> Command[Nack | None]:
    """Stop a motor without a ramp [SKYWATCHER :L]."""
    return _set("L", axis, "instant stop")


# -- the path of a stop ------------------------------------------------------------------------------


def urgent(command: Command[Nack | None]) -> Command[None]:
    """Make a command whose answer is left to the next reader."""
    return Command(command.sent, command.meaning, lambda _buffer, _final: Read(None, 0))
