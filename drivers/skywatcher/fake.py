"""A Sky-Watcher motor controller that isn't there: registers and frames for tests and demonstrations.

It knows no sky, like a real one: two motors that turn the axes of a German mount.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.skywatcher.fake_board import BOARDS, FakeBoard
from drivers.skywatcher.fake_motor import FakeMotor
from drivers.skywatcher.words import POSITION_ZERO, Axis, number, number_text
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import utc_now

_LONGEST = 16
_WORM_TEETH = 180
# how many hex digits follow each command that it knows
_LENGTHS = {
    **dict.fromkeys("abcdefghijmsDFJKL", 0),
    **dict.fromkeys("OP", 1),
    **dict.fromkeys("GV", 2),
    **dict.fromkeys("EHIMSTUWq", 6),
}
_FOR_BOTH = "FJKL"
_OK = b"=\r"


class FakeSkywatcher(WireFake):
    """Two motors behind one wire.

    Parameters
    ----------
    mechanics : Mechanics
        A German mount, standing at home and not tracking at the start.
    board : FakeBoard
        Whose numbers it answers; an EQ6 by default.
    faults, clock, monotonic
        As of every fake.
    """

    IDENTITY = (b":e", b":a", b":b", b":g", b":q", b":s", b":D")

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        board: FakeBoard = BOARDS["eq6"],
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(mechanics, faults=faults, clock=clock, monotonic=monotonic)
        self.board = board
        self.motors = {axis: FakeMotor(axis, board, mechanics) for axis in Axis}

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        """Cut ``:...CR`` off; what stands before the last colon of it is dropped, as boards do."""
        done = 0
        while (end := buffer.find(b"\r", done)) >= 0:
            begin = buffer.rfind(b":", done, end)
            if begin >= 0:
                return buffer[begin : end + 1], buffer[end + 1 :]
            done = end + 1
        begin = buffer.rfind(b":", done)
        rest = buffer[begin:] if begin >= 0 else b""
        return None, rest if len(rest) <= _LONGEST else b""

    def carry_out(self, command: bytes) -> bytes | None:
        """Do it."""
        return self._answered(command.decode("latin-1")[1:-1], command)

    def _answered(self, text: str, command: bytes) -> bytes:
        letter, axes, data = text[:1], text[1:2], text[2:]
        if letter not in _LENGTHS or (letter == "q" and self.board.features is None):
            if letter not in _LENGTHS:
                self.unknown.append(command)
            return b"!0\r"
        if not axes or len(data) != _LENGTHS[letter]:
            return b"!1\r"
        if axes not in ("1", "2", "3") or (axes == "3" and letter not in _FOR_BOTH):
            return b"!3\r"
        if not re.fullmatch("[0-9A-F]*", data):
            return b"!3\r"
        answer = _OK
        for axis in Axis if axes == "3" else (Axis(int(axes)),):
            answer = self._one(letter, self.motors[axis], data)
        return answer

    def _one(self, letter: str, motor: FakeMotor, data: str) -> bytes:
        if letter.islower():
            return f"={self._asked(letter, motor, data)}\r".encode("ascii")
        if letter in "EG" and motor.running:
            return b"!2\r"
        if letter == "J" and not motor.initialized:
            return b"!4\r"
        self._ordered(letter, motor, data)
        if letter == "D":
            return f"={number_text(motor.sidereal_period)}\r".encode("ascii")
        return _OK

    def _asked(self, letter: str, motor: FakeMotor, data: str) -> str:
        gear = self.board.gears[motor.axis]
        match letter:
            case "e":
                return self.board.board.wire()
            case "f":
                return motor.status().text()
            case "g":
                return f"{gear.ratio:02X}"
            case "q":
                return (self.board.features or "") if data == "010000" else number_text(0)
        values = {
            "a": gear.counts,
            "b": gear.timer_hz,
            "c": motor.brake,
            "d": motor.count if self.board.features else POSITION_ZERO,
            "h": motor.target,
            "i": motor.period,
            "j": motor.count,
            "m": motor.target,
            "s": gear.counts // _WORM_TEETH,
        }
        return number_text(values[letter])

    def _ordered(self, letter: str, motor: FakeMotor, data: str) -> None:
        match letter:
            case "F":
                motor.initialized = True
            case "E":
                motor.set_count(number(data))
            case "G":
                motor.mode(int(data[0], 16), int(data[1], 16))
            case "H":
                motor.aim_by(number(data))
            case "S":
                motor.target = number(data)
            case "M":
                motor.brake = number(data)
            case "I":
                motor.take_period(number(data))
            case "J":
                motor.start()
            case "K" | "L":
                motor.stop(hard=letter == "L")

    def deaf_reply(self, command: bytes) -> bytes:
        """Answer questions, and orders as if they were carried out."""
        return _OK if command[1:2].isupper() else self._answered(command.decode("latin-1")[1:-1], command)

    def denial(self, command: bytes) -> bytes | None:
        """Orders it denies by an error: the motor isn't stopped."""
        return b"!2\r" if command[1:2].isupper() else None

    def reboot(self) -> None:
        """Power blinks: motors off, counts from where the axes stand."""
        super().reboot()
        for motor in self.motors.values():
            motor.boot()
