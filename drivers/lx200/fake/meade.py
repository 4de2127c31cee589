"""Meade's own models from the other side of the cable [Meade Telescope Serial Command Protocol 2010.10]."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from drivers.lx200.fake.dialect import FakeDialect

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

_M31 = b" M31 EX GAL MAG 3.5 SZ178.0'#"
# sixteen bars far off, none when there [LX200 :D#]
_CLASSIC_BARS = b"\x7f" * 16 + b" " * 16 + b"#"
_BASIC = re.compile(r"G[RD]|S[rd].*|MS|CM|Q[nsew]?|U")


class _Parks:
    """Park and home words of Autostar, LX200GPS and the 16 inch."""

    def __init__(self, fake: FakeLx200, *, gps: bool, homes: bool) -> None:
        self._fake = fake
        self._gps, self._homes = gps, homes
        self._sought_home = False
        self._aligned_at_boot = fake.mechanics.boots

    def say(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if text == "hP":
            mechanics.park()
            return b""
        if self._homes and text == "I":
            # the LX200GPS's; INDI's driver sends it to the 16 inch too
            mechanics.unpark()
            mechanics.tracking = True
            return b""
        if text == "CM":
            self._aligned_at_boot = mechanics.boots
            return None
        if self._homes and text in ("hF", "hS"):
            self._sought_home = True
            mechanics.home()
            return b""
        if text == "h?":
            if mechanics.homing:
                return b"2"
            return b"1" if self._sought_home and mechanics.at_home else b"0"
        return self._of_gps(text) if self._gps else None

    def _of_gps(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if text == "GW":
            aligned = b"1" if self._aligned_at_boot == mechanics.boots else b"0"
            return b"P" + (b"T" if mechanics.tracking else b"N") + aligned + b"#"
        if text == "hW":
            mechanics.unpark()
            mechanics.tracking = True
            return b""
        if text == "hN":
            mechanics.tracking = False
            return b""
        if text == "gT":
            return b"1"
        if text == "fT":
            return b"+010.000#"
        # fan, GPS power, derotator, reticle, focuser: taken, nothing turns here
        return b"" if re.fullmatch(r"[fgr][+-]|B.*|F.*|\$[BQ].*", text) else None

    def reboot(self) -> None:
        self._sought_home = False


GENERIC_FAKE = FakeDialect(
    name="generic",
    product={
        "P": b"Generic LX200",
        "N": b"43.0",
        "D": b"Nov 21 2026",
        "T": b"12:00:00",
        "F": b"Generic LX200",
    },
    speaker=lambda fake: _Parks(fake, gps=False, homes=False),
)

CLASSIC_FAKE = FakeDialect(name="classic", pulses=False, busy=_CLASSIC_BARS, idle=b" " * 32 + b"#")

LX200_16_FAKE = FakeDialect(
    name="lx200-16",
    pulses=False,
    product={"P": b"LX200 16", "N": b"3.37", "D": b"Nov 21 1999", "T": b"12:00:00", "F": b"LX200 16"},
    busy=_CLASSIC_BARS,
    idle=b" " * 32 + b"#",
    speaker=lambda fake: _Parks(fake, gps=False, homes=True),
)

AUTOSTAR_FAKE = FakeDialect(
    name="autostar",
    product={
        "P": b"Autostar",
        "N": b"43Eg",
        "D": b"Nov 21 2009",
        "T": b"12:00:00",
        "F": b"ETX Autostar|A|43Eg",
    },
    matched=_M31,
    speaker=lambda fake: _Parks(fake, gps=False, homes=False),
)

LX200GPS_FAKE = FakeDialect(
    name="lx200gps",
    product={"P": b"LX2001", "N": b"4.2g", "D": b"Nov 21 2009", "T": b"12:00:00", "F": b"LX2001|A|4.2g"},
    matched=_M31,
    speaker=lambda fake: _Parks(fake, gps=True, homes=True),
    unparks_by_itself=False,
)

BASIC_FAKE = FakeDialect(
    name="basic",
    ack=b"",
    pulses=False,
    classic_too=lambda text: _BASIC.fullmatch(text) is not None,
)
