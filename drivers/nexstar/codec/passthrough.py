"""What the hand control passes through to the motors: pure words, for both ends of the cable.

A pass-through is always eight bytes: ``P``, how many bytes count (command and data), the device, the
command, three bytes of data, and how many bytes the answer holds [NexStar P].
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from drivers.nexstar.codec.dialect import Tracking
from drivers.wire.command import Unreadable
from mountnav.devices import Direction, PierSide

FASTEST_FIXED_RATE = 9
"""Rates of the hand control's keys are numbered 1 to 9; 0 lets go [NexStar P]."""
LONGEST_PULSE_S = 2.55
"""A pulse's length is one byte of hundredths of a second [NexStar P 0x26]."""
SIDEREAL, SOLAR, LUNAR = 0xFFFF, 0xFFFE, 0xFFFD
"""In place of a speed: follow the sky, the Sun, the Moon [INDI CELESTRON_TRACK_RATE]."""
_TRACKING_RATES = (SIDEREAL, SOLAR, LUNAR)


class Axis(IntEnum):
    """Motor boards: azimuth or right ascension, altitude or declination [NexStar P]."""

    RA = 0x10
    DEC = 0x11


class Order(IntEnum):
    """What a motor board understands [NexStar P]."""

    RATE_UP = 0x06
    RATE_DOWN = 0x07
    MOVE_UP = 0x24
    MOVE_DOWN = 0x25
    PULSE = 0x26
    PULSING = 0x27
    SET_PULSE_RATE = 0x46
    PULSE_RATE = 0x47
    VERSION = 0xFE


@dataclass(frozen=True, slots=True)
class PassThrough:
    """One message to a board.

    Attributes
    ----------
    device, order : int
        To whom, and what.
    data : bytes
        At most three.
    answer_length : int
        Bytes of the answer before its ``#``.
    """

    device: int
    order: int
    data: bytes = b""
    answer_length: int = 0

    def to_bytes(self) -> bytes:
        """Return the eight bytes.

        Raises
        ------
        ValueError
            If there are more than three bytes of data.
        """
        if len(self.data) > 3:
            raise ValueError(f"{self.data!r} is longer than three bytes")
        head = bytes([0x50, 1 + len(self.data), self.device, self.order])
        return head + self.data.ljust(3, b"\0") + bytes([self.answer_length])


def pass_through_from_bytes(packed: bytes) -> PassThrough:
    """Read the eight bytes back.

    Raises
    ------
    Unreadable
        If they are none.
    """
    if len(packed) != 8 or packed[0] != 0x50 or not 1 <= packed[1] <= 4:
        raise Unreadable(f"{packed!r} is not a pass-through")
    return PassThrough(packed[2], packed[3], packed[4 : 3 + packed[1]], packed[7])


def fixed_rate(axis: Axis, rate: int) -> PassThrough:
    """Move an axis at one of nine rates; the sign is the direction, 0 ends it.

    Raises
    ------
    ValueError
        If there is no such rate.
    """
    if abs(rate) > FASTEST_FIXED_RATE:
        raise ValueError(f"there is no fixed rate {rate}")
    return PassThrough(axis, Order.MOVE_DOWN if rate < 0 else Order.MOVE_UP, bytes([abs(rate)]))


def variable_rate(axis: Axis, rate_arcsec_s: float) -> PassThrough:
    """Move an axis at a rate in quarters of an arcsecond per second; the sign is the direction.

    Raises
    ------
    ValueError
        If the rate is too fast to be said, or would be taken for one of the tracking rates.
    """
    quarters = round(abs(rate_arcsec_s) * 4.0)
    if quarters >= min(_TRACKING_RATES):
        raise ValueError(f"{rate_arcsec_s} arcsec/s can't be encoded in this protocol")
    order = Order.RATE_DOWN if rate_arcsec_s < 0 else Order.RATE_UP
    return PassThrough(axis, order, quarters.to_bytes(2, "big"))


def tracking_rate(rate: int, *, south: bool) -> PassThrough:
    """Follow at one of the tracking rates, the way the sky turns on that hemisphere [INDI set_track_rate].

    Raises
    ------
    ValueError
        If it is none of them.
    """
    if rate not in _TRACKING_RATES:
        raise ValueError(f"{rate:#x} is not a tracking rate")
    return PassThrough(Axis.RA, Order.RATE_DOWN if south else Order.RATE_UP, rate.to_bytes(2, "big"))


def is_tracking_rate(data: bytes) -> bool:
    """Whether the data of a rate order names sidereal, solar or lunar tracking, and no speed."""
    return int.from_bytes(data[:2], "big") in _TRACKING_RATES


def pulse(axis: Axis, rate_percent: int, pulse_s: float) -> PassThrough:
    """Guide for a moment, at percents of the sidereal rate; the sign is the direction.

    Raises
    ------
    ValueError
        If the rate is beyond 100 % or the moment longer than 2.55 s.
    """
    if abs(rate_percent) > 100 or not 0.0 <= pulse_s <= LONGEST_PULSE_S:
        raise ValueError(f"a pulse of {pulse_s} s at {rate_percent} % can't be encoded in this protocol")
    return PassThrough(axis, Order.PULSE, bytes([rate_percent % 256, round(pulse_s * 100.0)]))


_POLE_DEG = 89.999
"""Nearer to the pole than this both sides of the pier look alike. Chosen by hand: less than a step of the
wire."""


def side_of(letter: str, dec_deg: float, *, mirrored: bool) -> PierSide:
    """Tell where the tube hangs: W says that it looks west, so it hangs in the east [INDI celestrongps].

    Parameters
    ----------
    letter : str
        E or W [NexStar p].
    dec_deg : float
        At the very pole it means nothing.
    mirrored : bool
        Whether this hand control has the letters the other way round on this hemisphere.
    """
    if abs(dec_deg) > _POLE_DEG:
        return PierSide.UNKNOWN
    return PierSide.EAST if (letter == "W") is not mirrored else PierSide.WEST


def motor_for(direction: Direction, side: PierSide | None, mode: Tracking | None) -> tuple[Axis, int]:
    """Which motor moves the tube there, and which way it turns: 1 or -1.

    West is the way it tracks. The declination motor's plus raises the declination where the tube looks east,
    and lowers it where it looks west [INDI celestrongps MoveNS].
    """
    if direction in (Direction.NORTH, Direction.SOUTH):
        up = 1 if direction is Direction.NORTH else -1
        return Axis.DEC, -up if side is PierSide.EAST else up
    west = 1 if direction is Direction.WEST else -1
    return Axis.RA, -west if mode is Tracking.EQUATORIAL_SOUTH else west
