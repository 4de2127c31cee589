"""A Sky-Watcher motor controller that isn't there: registers and frames for tests and demonstrations.

It knows no sky, like a real one: two motors that turn the axes of a German mount.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.family import Fakes
from drivers.skywatcher.axes import Gearing
from drivers.skywatcher.codec import LARGEST, POSITION_ZERO, Axis, Board, MotorStatus, number, number_text
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import AxisName, Machine, Mechanics
from mountnav.sky.coordinates import SIDEREAL_DEG_S


@dataclass(frozen=True, slots=True)
class FakeBoard:
    """One kind of mount.

    Attributes
    ----------
    features : str or None
        Answer to ``:q``; None on old boards, which don't know it.
    goto_deg_s, slow_goto_deg_s, acceleration_deg_s2 : float
        Of its gotos.
    least_period : int
        Shorter step periods are taken for this.
    """

    board: Board
    gears: dict[Axis, Gearing]
    features: str | None = None
    goto_deg_s: float = 3.4
    slow_goto_deg_s: float = 0.2134
    acceleration_deg_s2: float = 2.2
    least_period: int = 6


def _both(counts: int, timer_hz: int, ratio: int) -> dict[Axis, Gearing]:
    return {axis: Gearing(counts, timer_hz, ratio) for axis in Axis}


BOARDS = {
    # numbers, speeds and firmware as an owner's HEQ5 Pro reported them; an EQ6 counts alike [INDI eqmod]
    "eq6": FakeBoard(Board(2, 4, 0x00), _both(9_024_000, 64_935, 16)),
    "heq5": FakeBoard(Board(2, 4, 0x01), _both(9_024_000, 64_935, 16)),
    # counts from an owner's log, features from another's notes; timer and firmware are not checked
    "eq8": FakeBoard(Board(3, 0, 0x04), _both(11_136_000, 16_000_000, 16), "076000"),
    "az-eq6": FakeBoard(Board(3, 0, 0x05), _both(9_216_000, 16_000_000, 32), "0B3000"),
    # counts and timer as an owner's reported them: the axes differ; ratio and features are not checked
    "star-adventurer-gti": FakeBoard(
        Board(3, 0x30, 0x0C),
        {
            Axis.HOUR_ANGLE: Gearing(3_628_800, 16_000_000, 1),
            Axis.DECLINATION: Gearing(2_903_040, 16_000_000, 1),
        },
        "008000",
        least_period=1,
    ),
}


_FASTEST_DEG_S = 1000.0 * SIDEREAL_DEG_S
"""A fake's motor turns no faster, whatever its step period. Chosen by hand, above the 800 times sidereal of
real mounts."""


_TRIM_S = 6.5
"""So long a first motor runs at another rate than the stars' before it is taken to follow something, s: a
trim at a slew's end and a guide pulse are over by then, and faults of rates don't strike them. Chosen by
hand, above the longest trim of the driver (6 s). Doubled, a fault of right ascension alone strikes late."""
_FOLLOWS, _GUIDES = 0.19, 0.02
"""In times sidereal: a first motor that runs so near to what a star wants follows something at once, trims
differ by 0.2 at least; and a second one that runs so near to the guide rate may be guided. Chosen by hand.
Doubled, a fault would spoil the end of each slew; some more rates pass for guide pulses."""
_GUIDE = 0.5
"""Guide rate of drivers, in times sidereal [INDI eqmod]. Doubled, guide pulses are taken for following."""


class FakeMotor:
    """Registers and motion.

    Parameters
    ----------
    mechanics : Mechanics
        German.
    monotonic : callable
        Seconds, for how long it runs at a rate.

    Attributes
    ----------
    follows : bool
        It runs after something in the sky: faults of rates spoil that.
    other : FakeMotor or None
        The other one of the board.
    """

    def __init__(
        self, axis: Axis, board: FakeBoard, mechanics: Mechanics, monotonic: Callable[[], float]
    ) -> None:
        self.axis = axis
        self._board = board
        self._gear = board.gears[axis]
        self._mechanics = mechanics
        self._name: AxisName = "ha" if axis is Axis.HOUR_ANGLE else "dec"
        self._monotonic = monotonic
        self.follows = False
        self.other: FakeMotor | None = None
        self.follows_at_s: float | None = None
        """When it will be taken to follow, if it still runs so then."""
        self.sidereal_period = self._gear.period(SIDEREAL_DEG_S)
        self.boot()

    def boot(self) -> None:
        """Begin again: wherever it stands is the zero of its counts."""
        self.initialized = False
        self._follows_no_more()
        self.goto = self.fast = self.backward = self._under_way = False
        self.increment, self.brake = 0, 0
        self.period = self.sidereal_period
        self._zero_deg = self._turn_deg()
        self._zero_count = POSITION_ZERO
        self.target = POSITION_ZERO

    # how turns of the motor lie on the mechanics' axes: counterweight down is 0 here and 90 there, the pole
    # is 90 here; in the south the polar axis stands the other way round

    def _signs(self) -> tuple[float, float, float]:
        south = self._mechanics.site.latitude_deg < 0.0
        if self.axis is Axis.HOUR_ANGLE:
            return (-1.0 if south else 1.0), 90.0, 0.0
        return -1.0, (-90.0 if south else 90.0), 90.0

    def _turn_deg(self) -> float:
        sign, home_deg, home_turn_deg = self._signs()
        return home_turn_deg + sign * (self._mechanics.axis_angle(self._name) - home_deg)

    def _angle_deg(self, turn_deg: float) -> float:
        sign, home_deg, home_turn_deg = self._signs()
        return home_deg + sign * (turn_deg - home_turn_deg)

    @property
    def running(self) -> bool:
        """Whether it turns, slowing down included."""
        # a fault of rates may have it rest: its registers don't know
        return self._mechanics.axis_moving(self._name) or (self.follows and self._mechanics.fails_rates)

    @property
    def count(self) -> int:
        """Its position register."""
        return (self._zero_count + self._gear.counts_of(self._turn_deg() - self._zero_deg)) & LARGEST

    def set_count(self, count: int) -> None:
        """Count the present place so."""
        self._zero_count, self._zero_deg = count, self._turn_deg()

    def status(self) -> MotorStatus:
        """Its flags; a goto that has ended has gone back to the other mode by itself."""
        running = self.running
        if self._under_way and not running:
            self._under_way = self.goto = False
        return MotorStatus(self.goto, self.backward, self.fast, running, False, self.initialized)

    def mode(self, mode: int, flags: int) -> None:
        """Take a motion mode."""
        self.goto, self.fast, self._under_way = mode in (0, 2), mode in (0, 3), False
        self.backward = bool(flags & 1)

    def aim_by(self, counts: int) -> None:
        """Take a goto increment."""
        self.increment = counts
        self.target = (self.count + (-counts if self.backward else counts)) & LARGEST

    def take_period(self, ticks: int) -> None:
        """Take a step period; a motor that runs slowly obeys at once."""
        self.period = max(ticks, self._board.least_period)
        if self.running and not self.goto and not self.fast:
            self._run()

    def start(self) -> None:
        """Start as the registers say."""
        if not self.goto:
            self._run()
            return
        self._follows_no_more()
        board = self._board
        turn_deg = self._zero_deg + self._gear.turn_deg(self.target - self._zero_count)
        rate_deg_s = board.goto_deg_s if self.fast else board.slow_goto_deg_s
        angle_deg = self._angle_deg(turn_deg)
        self._under_way = True
        self._mechanics.drive_to(self._name, angle_deg, rate_deg_s, board.acceleration_deg_s2)

    def _run(self) -> None:
        rate_deg_s = min(self._gear.rate_deg_s(self.period, fast=self.fast), _FASTEST_DEG_S)
        velocity_deg_s = self._signs()[0] * (-rate_deg_s if self.backward else rate_deg_s)
        self.follows_at_s = None
        self.follows = not self.fast and self._is_followed(velocity_deg_s / SIDEREAL_DEG_S)
        self._mechanics.drive(
            self._name, velocity_deg_s, self._board.acceleration_deg_s2, follows=self.follows
        )
        if self.follows and self.other is not None:
            self.other.followed_too()

    def _is_followed(self, times: float) -> bool:
        """Whether at so many times the sidereal rate it runs after something that moves among the stars."""
        if self.axis is Axis.HOUR_ANGLE:
            if self.period == self.sidereal_period:
                return False
            sure = abs(times - 1.0) < _FOLLOWS or (self.other is not None and self.other.follows)
        else:
            sure = abs(abs(times) - _GUIDE) > _GUIDES
        if not (sure or self.follows):
            self.follows_at_s = self._monotonic() + _TRIM_S
        return sure or self.follows

    def followed_too(self) -> None:
        """The other one follows something: so does this one, if it runs at another rate than a star's."""
        if self.follows_at_s is not None:
            self.follows = True
            self._run()

    def tick(self) -> None:
        """Having run so for longer than trims and pulses last, it follows something."""
        if self.follows_at_s is not None and self._monotonic() >= self.follows_at_s:
            self.followed_too()

    def _follows_no_more(self) -> None:
        self.follows, self.follows_at_s = False, None

    def stop(self, *, hard: bool) -> None:
        """Slow down, or stand still at once; the mode is the other one from now on."""
        self.goto = self._under_way = False
        self._follows_no_more()
        self._mechanics.halt(self._name, instant=hard)


_LONGEST = 16
"""Bytes without a carriage return that are kept for a command still to come. Commands have at most ten."""
_WORM_TEETH = 180
"""Teeth of the worm wheel: the fakes' answer to `:s` is the counts of one. An EQ6 has 180; the same for all
fakes."""
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
        self.motors = {axis: FakeMotor(axis, board, mechanics, monotonic) for axis in Axis}
        first, second = self.motors.values()
        first.other, second.other = second, first

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

    def dues(self) -> list[float]:
        """When motors are taken to follow something."""
        return [one.follows_at_s for one in self.motors.values() if one.follows_at_s is not None]

    def tick(self) -> None:
        """Take motors that have run long enough at a rate to follow something."""
        for motor in self.motors.values():
            motor.tick()

    def reboot(self) -> None:
        """Power blinks: motors off, counts from where the axes stand."""
        super().reboot()
        for motor in self.motors.values():
            motor.boot()


def _make(
    dialect: str,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeSkywatcher:
    return FakeSkywatcher(mechanics, board=BOARDS[dialect], faults=faults, clock=clock, monotonic=monotonic)


FAKES = Fakes(
    dialects=tuple(BOARDS),
    make=_make,
    # syncs never reach the wire
    moves=(b":J",),
    stops=(b":K", b":L"),
    machine=Machine(mounting="german", starts_at="home", tracks_at_start=False),
)
