"""A TeenAstro from the other side of the cable [TeenAstro v1.6.0, its commands' description and `:GXI#`]."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from drivers.lx200.fake.dialect import FakeDialect
from mountnav.devices import PierSide, TrackingRate

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

_RATES = {TrackingRate.SIDEREAL: "0", TrackingRate.LUNAR: "1", TrackingRate.SOLAR: "2"}
_SIDES = {PierSide.EAST: "E", PierSide.WEST: "W"}
_BY_LETTER = {"TQ": TrackingRate.SIDEREAL, "TL": TrackingRate.LUNAR, "TS": TrackingRate.SOLAR}


class _TeenAstro:
    """Its state in one word, and orders to park and track that are answered by a digit."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._move = 4
        self._site = 0

    def reboot(self) -> None:
        """Forget the chosen rate."""
        self._move = 4

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        fake, mechanics = self._fake, self._fake.mechanics
        if text == "GXI":
            return self._status()
        if text in ("Te", "Td"):
            allowed = not (mechanics.parked or mechanics.parking)
            if allowed:
                mechanics.tracking = text == "Te"
            return b"%d" % allowed
        if text in _BY_LETTER:
            mechanics.rate = _BY_LETTER[text]
            return b""
        if text == "CM":
            return fake.synced() or b"N/A#"
        if text[:1] == "h":
            return self._stations(text[1:])
        return self._settings(text)

    def _stations(self, word: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if word == "P":
            mechanics.park()
        elif word == "R":
            if mechanics.parked:
                mechanics.unpark()
                mechanics.tracking = True
        elif word == "Q":
            mechanics.set_park()
        elif word == "C":
            mechanics.home()
        elif word != "S":
            return None
        return b"1"

    def _settings(self, text: str) -> bytes | None:
        if text == "W?":
            return b"%d#" % self._site
        if re.fullmatch(r"W[0-3]", text):
            self._site = int(text[1])
            return b""
        if text == "Ge":
            return b"%+04d#" % round(self._fake.mechanics.believed_site.height_m)
        if re.fullmatch(r"G[MNOP]", text):
            return b"Site %d#" % ("MNOP".index(text[1]))
        if re.fullmatch(r"R[0-4]", text):
            self._move = int(text[1])
            return b""
        return b"1" if re.fullmatch(r"Se\s*[+-]?\d+|SXR\d[,:]\d+", text) else None

    def _status(self) -> bytes:
        mechanics = self._fake.mechanics
        mark = [" "] * 17
        mark[0] = str(2 * mechanics.slewing() + mechanics.tracking)
        mark[1] = _RATES.get(mechanics.rate, "0")
        mark[2] = "P" if mechanics.parked else "I" if mechanics.parking else "p"
        mark[3] = "H" if mechanics.at_home else " "
        mark[4] = str(self._move)
        mark[5] = "G" if mechanics.guiding() else " "
        mark[10], mark[11] = "0", "1"
        german = mechanics.machine.mounting == "german"
        mark[12] = "E" if german else "K"
        mark[13] = _SIDES.get(mechanics.pier_side(), "?")
        # no satellites, no error, motors on
        mark[14], mark[15], mark[16] = "A", "0", "I"
        return "".join(mark).encode() + b"#"


TEENASTRO_FAKE = FakeDialect(
    name="teenastro",
    ack=b"",
    product={"P": b"TeenAstro", "N": b"1.6.0", "D": b"Mar 12 2026", "T": b"20:50:50"},
    speaker=_TeenAstro,
    unparks_by_itself=False,
)
