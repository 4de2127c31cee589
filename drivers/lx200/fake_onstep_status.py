"""An OnStep's status as its two words tell it: letters, and bytes with high bits [ONSTEP :GU#, :Gu#]."""

from __future__ import annotations

from drivers.lx200.onstep_codec import Status
from mountnav.devices import PierSide, TrackingRate

HZ = {
    TrackingRate.SIDEREAL: 60.16427,
    TrackingRate.LUNAR: 57.9,
    TrackingRate.SOLAR: 60.0,
    TrackingRate.KING: 60.136,
}
SIDE_LETTERS = {PierSide.EAST: b"E", PierSide.WEST: b"W", PierSide.UNKNOWN: b"N"}
_SIDE_FLAGS = {PierSide.EAST: "T", PierSide.WEST: "W", PierSide.UNKNOWN: "o"}
_SIDE_BITS = {PierSide.EAST: 0x20, PierSide.WEST: 0x40, PierSide.UNKNOWN: 0x10}
_RATE_FLAGS = {TrackingRate.LUNAR: "(", TrackingRate.SOLAR: "O", TrackingRate.KING: "k"}
_RATE_BITS = {TrackingRate.LUNAR: 1, TrackingRate.SOLAR: 2, TrackingRate.KING: 3}
_MOUNTING_BITS = {"E": 1, "K": 2, "L": 4, "A": 8}
_PULSE_RATE = 1


def _park_state(status: Status) -> int:
    return 2 if status.parked else 1 if status.parking else 3 if status.park_failed else 0


def flags(status: Status, mounting: str, move_rate: int) -> bytes:
    """Text of `:GU#`; `mounting` is its letter, `move_rate` the number of the selected rate."""
    letters = (
        ("n", not status.tracking),
        ("N", not status.slewing),
        ("pIPF"[_park_state(status)], True),
        ("H", status.at_home),
        ("h", status.homing),
        ("G", status.guiding),
        (_RATE_FLAGS.get(status.rate, ""), True),
    )
    said = "".join(letter for letter, up in letters if up)
    error = chr(ord("0") + status.error)
    return f"{said}{mounting}{_SIDE_FLAGS[status.pier_side]}{_PULSE_RATE}{move_rate}{error}#".encode()


def bits(status: Status, mounting: str, move_rate: int) -> bytes:
    """Bytes of `:Gu#`."""
    numbers = (
        (not status.tracking) | (not status.slewing) << 1 | status.guiding << 3,
        _RATE_BITS.get(status.rate, 0),
        status.at_home | status.homing << 5,
        _MOUNTING_BITS[mounting] | _SIDE_BITS[status.pier_side],
        0,
        _park_state(status),
        _PULSE_RATE,
        move_rate,
        status.error,
    )
    return bytes(0x80 | int(number) for number in numbers) + b"#"
