"""One motor of a fake board: its registers, and how they move an axis of the mechanics."""

from __future__ import annotations

from drivers.skywatcher.fake_board import FakeBoard
from drivers.skywatcher.words import LARGEST, POSITION_ZERO, Axis, MotorStatus
from mountnav.simulation.mechanics import AxisName, Mechanics
from mountnav.sky.turning import SIDEREAL_DEG_S

_FASTEST_DEG_S = 1000.0 * SIDEREAL_DEG_S


class FakeMotor:
    """Registers and motion.

    Parameters
    ----------
    axis : Axis
    board : FakeBoard
    mechanics : Mechanics
        German.
    """

    def __init__(self, axis: Axis, board: FakeBoard, mechanics: Mechanics) -> None:
        self.axis = axis
        self._board = board
        self._gear = board.gears[axis]
        self._mechanics = mechanics
        self._name: AxisName = "ha" if axis is Axis.HOUR_ANGLE else "dec"
        self.sidereal_period = self._gear.period(SIDEREAL_DEG_S)
        self.boot()

    def boot(self) -> None:
        """Begin anew: wherever it stands is the zero of its counts."""
        self.initialized = False
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
        return self._mechanics.axis_moving(self._name)

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
        board = self._board
        turn_deg = self._zero_deg + self._gear.turn_deg(self.target - self._zero_count)
        rate_deg_s = board.goto_deg_s if self.fast else board.slow_goto_deg_s
        angle_deg = self._angle_deg(turn_deg)
        self._under_way = True
        self._mechanics.drive_to(self._name, angle_deg, rate_deg_s, board.acceleration_deg_s2)

    def _run(self) -> None:
        rate_deg_s = min(self._gear.rate_deg_s(self.period, fast=self.fast), _FASTEST_DEG_S)
        sign = self._signs()[0] * (-1.0 if self.backward else 1.0)
        self._mechanics.drive(self._name, sign * rate_deg_s, self._board.acceleration_deg_s2)

    def stop(self, *, hard: bool) -> None:
        """Slow down, or stand still at once; the mode is the other one from now on."""
        self.goto = self._under_way = False
        self._mechanics.halt(self._name, instant=hard)
