"""A Losmandy Gemini from the other side of the cable: boot stages, letters for what moves, native commands.

From the maker's command descriptions [GEMINI L5 V2.1, L6 V1.02] and what its INDI driver asks.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from drivers.lx200.codec.gemini import checksum, native
from drivers.lx200.fake.dialect import FakeDialect
from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import Refusal

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

_NATIVE = re.compile(rb"[<>](\d{1,5}):([^#]*)")
_LETTERS = re.compile(rb"b[CWR]#")
_RATES = {
    131: TrackingRate.SIDEREAL,
    132: TrackingRate.KING,
    133: TrackingRate.LUNAR,
    134: TrackingRate.SOLAR,
}
"""Tracking rates by the numbers of native commands [GEMINI native]."""
# what its INDI driver asks for at connecting: speeds, guiding, error correction, flip points
_SETTINGS = {
    27: b"25600",
    120: b"800",
    140: b"800",
    145: b"50",
    150: b"0.5",
    151: b"0.5",
    152: b"0.5",
    170: b"20",
    220: b"0",
    221: b"90d00",
    222: b"90d00",
    223: b"114d00",
    224: b"123d00",
    225: b"114d00",
    226: b"123d00",
    400: b"100;100",
    401: b"0",
    501: b"0",
    502: b"0.5",
    508: b"0",
    509: b"0",
}
_SLEW_REFUSALS = {
    Refusal.BELOW_HORIZON: b"1Object below horizon.#",
    Refusal.LIMIT: b"6Outside Limits.#",
    Refusal.PARKED: b"7Rejected - Mount is parked!#",
}


class _Gemini:
    """What a Gemini says, and keeps: its boot stage, settings, whether it was parked by an order."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._stage = b"G#"
        self._aligned = True
        self._parks = False
        self._settings = dict(_SETTINGS)

    def natives(self, command: bytes) -> bool:
        """Whether it is a native command, or the choice of a startup mode."""
        return _LETTERS.fullmatch(command) is not None or _NATIVE.fullmatch(command[:-1]) is not None

    def reboot(self) -> None:
        """Wait for the startup mode; a cold or warm start forgets its alignment."""
        self._stage = b"b#"
        self._aligned = self._parks = False

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        wire = text.encode("latin-1")
        if text == "\x06":
            return self._stage
        if wire[:1] in (b"<", b">"):
            return self._native(wire)
        if _LETTERS.fullmatch(wire):
            # a warm restart goes on where it was
            self._stage, self._aligned = b"G#", wire[1:2] == b"R"
            return b""
        if self._stage != b"G#":
            return b""
        return self._moving(text)

    def _moving(self, text: str) -> bytes | None:
        fake, mechanics = self._fake, self._fake.mechanics
        if text == "Gv":
            if mechanics.slewing():
                return b"S"
            return b"G" if mechanics.guiding() else b"T" if mechanics.tracking else b"N"
        if text == "h?":
            return b"2" if mechanics.parking else b"1" if mechanics.parked and self._parks else b"0"
        if text == "Gm":
            # a fork has no sides; a Gemini always names one
            return b"W#" if mechanics.pier_side() is PierSide.WEST else b"E#"
        if text in ("hP", "hC", "hZ"):
            self._parks = True
            mechanics.park()
            return b""
        if text == "hH":
            mechanics.set_park()
            return b""
        if text in ("hN", "hW"):
            if text == "hW":
                mechanics.unpark()
                self._parks = False
            mechanics.tracking = text == "hW"
            return b""
        if text == "MS":
            target = fake.target()
            refused = None if target is None else fake.refusal(target)
            if target is None:
                return b"2No object selected.#"
            return None if refused is None else _SLEW_REFUSALS.get(refused, b"4Position unreachable.#")
        if text in ("CM", "Cm"):
            return self._sync()
        if text == "GG":
            return b"%+03d#" % round(fake.hours_to_utc)
        return None

    def _sync(self) -> bytes:
        target = self._fake.target()
        if target is None or self._fake.mechanics.sync(target) is not None:
            return b"No object!#"
        self._aligned = True
        return b"PC Object#"

    def _native(self, wire: bytes) -> bytes:
        said = wire.rstrip(b"#")
        match = _NATIVE.fullmatch(said)
        if match is None or not match[2] or said[-1] != checksum(said[:-1]):
            # a wrong checksum is not answered
            return b""
        number, value = int(match[1]), match[2][:-1]
        if said[:1] == b">":
            self._take(number, value)
            return b""
        return native(self._value(number))

    def _take(self, number: int, value: bytes) -> None:
        # the INDI driver sends the rate as a value of 130, the document as its own number
        chosen = int(value) if number == 130 and value.isdigit() else number
        if chosen in _RATES:
            self._fake.mechanics.rate = _RATES[chosen]
        elif number in self._settings:
            self._settings[number] = value

    def _value(self, number: int) -> bytes:
        mechanics = self._fake.mechanics
        if number == 99:
            return b"%d" % (1 * self._aligned + 8 * mechanics.slewing())
        if number == 130:
            for rate_number, rate in _RATES.items():
                if mechanics.rate is rate:
                    return b"%d" % rate_number
        return self._settings.get(number, b"0")


GEMINI_FAKE = FakeDialect(
    name="gemini",
    product={"P": b"Losmandy Gemini", "N": b"5.21", "D": b"11 21 2020", "T": b"12:00:00"},
    speaker=_Gemini,
    unparks_by_itself=False,
)
