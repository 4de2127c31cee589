"""The motor boards behind a fake hand control: what it passes through to them, over the same mechanics."""

from __future__ import annotations

from collections.abc import Callable

from drivers.nexstar.handsets import Version
from drivers.nexstar.passthrough import LUNAR, SIDEREAL, SOLAR, Axis, Order, PassThrough, is_tracking_rate
from mountnav.devices import PierSide, TrackingRate
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.turning import SIDEREAL_DEG_S

_GUIDE_RATE = 0x80
_RATES = {SIDEREAL: TrackingRate.SIDEREAL, SOLAR: TrackingRate.SOLAR, LUNAR: TrackingRate.LUNAR}
# of the nine keys of the hand control; where a mount is slower, its own limit holds
_FIXED_RATES_DEG_S = (
    0.0,
    *(SIDEREAL_DEG_S * times for times in (2.0, 4.0, 8.0, 16.0, 32.0)),
    0.3,
    1.0,
    2.0,
    4.0,
)
_KEYS_ONLY = (Order.MOVE_UP, Order.MOVE_DOWN, Order.RATE_UP, Order.RATE_DOWN)
_OTHER_WAY: dict[Direction, Direction] = {"n": "s", "s": "n", "e": "w", "w": "e"}


class FakeMotors:
    """Two motor boards, right ascension and declination; no focuser.

    Parameters
    ----------
    mechanics : Mechanics
        What moves. Plus is the way it tracks in the north on the one axis; on the other it raises the
        declination, but lowers it where the tube of a German mount hangs in the east.
    version : Version or None
        Of their firmware; None: behind a SynScan, which passes speeds on and nothing else.
    monotonic : callable
        Seconds, for timed pulses.
    """

    def __init__(self, mechanics: Mechanics, version: Version | None, monotonic: Callable[[], float]) -> None:
        self.southern = False
        self._mechanics = mechanics
        self._version = version
        self._monotonic = monotonic
        self._pulses: dict[Axis, float] = {}
        self._rates = {Axis.RA: _GUIDE_RATE, Axis.DEC: _GUIDE_RATE}

    def reboot(self) -> None:
        """Forget what runs."""
        self._pulses.clear()

    def dues(self) -> list[float]:
        """Instants at which pulses end."""
        return list(self._pulses.values())

    def end_pulses(self) -> None:
        """Forget the pulses whose time is over; the mechanics have ended them."""
        now = self._monotonic()
        self._pulses = {axis: due for axis, due in self._pulses.items() if due > now}

    def answer(self, message: PassThrough) -> bytes | None:
        """Carry out a message; None where there is no such board, or it does not know the order."""
        if message.device not in (Axis.RA, Axis.DEC):
            return None
        axis, data = Axis(message.device), message.data
        if self._version is None:
            return self._rate(axis, message.order, data) if message.order in _KEYS_ONLY else None
        if message.order == Order.VERSION:
            return bytes([self._version.major, self._version.minor])
        if message.order == Order.PULSE_RATE:
            return bytes([self._rates[axis]])
        if message.order == Order.PULSING:
            return bytes([axis in self._pulses])
        if message.order == Order.SET_PULSE_RATE and data:
            self._rates[axis] = data[0]
            return b""
        if message.order == Order.PULSE and len(data) >= 2:
            self._pulse(axis, data[0] - 256 if data[0] > 127 else data[0], data[1] / 100.0)
            return b""
        return self._rate(axis, message.order, data)

    def _pulse(self, axis: Axis, percent: int, pulse_s: float) -> None:
        rate_deg_s = abs(percent) / 100.0 * SIDEREAL_DEG_S
        if self._mechanics.pulse(self._direction(axis, percent < 0), rate_deg_s, pulse_s):
            self._pulses[axis] = self._monotonic() + pulse_s

    def _rate(self, axis: Axis, order: int, data: bytes) -> bytes | None:
        if order in (Order.MOVE_UP, Order.MOVE_DOWN) and data and data[0] < len(_FIXED_RATES_DEG_S):
            rate_deg_s = _FIXED_RATES_DEG_S[data[0]]
            self._move(axis, -rate_deg_s if order == Order.MOVE_DOWN else rate_deg_s)
            return b""
        if order in (Order.RATE_UP, Order.RATE_DOWN) and len(data) >= 2:
            if is_tracking_rate(data):
                self._mechanics.rate = _RATES[int.from_bytes(data[:2], "big")]
                self._mechanics.tracking = True
                return b""
            rate_deg_s = int.from_bytes(data[:2], "big") / 4.0 / 3600.0
            self._move(axis, -rate_deg_s if order == Order.RATE_DOWN else rate_deg_s)
            return b""
        return None

    def _move(self, axis: Axis, rate_deg_s: float) -> None:
        self._pulses.pop(axis, None)
        direction = self._direction(axis, rate_deg_s < 0)
        if rate_deg_s == 0.0:
            self._mechanics.stop_move(direction)
        else:
            self._mechanics.move(direction, abs(rate_deg_s))

    def _direction(self, axis: Axis, down: bool) -> Direction:
        if axis is Axis.RA:
            direction: Direction = "e" if down else "w"
            return _OTHER_WAY[direction] if self.southern else direction
        direction = "s" if down else "n"
        return _OTHER_WAY[direction] if self._mechanics.pier_side() is PierSide.EAST else direction
