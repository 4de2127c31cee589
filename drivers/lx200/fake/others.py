"""FS-2, SkySensor2000PC and OpenAstroTech mounts from the other side of the cable.

FS-2 and SkySensor: what INDI 1.9.9's drivers say of them. OpenAstroTech: its firmware's own description of
its commands, V1.13.9.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from drivers.lx200.codec.angles import ra_to_text
from drivers.lx200.fake.base import from_the_horizon_up
from drivers.lx200.fake.dialect import FakeDialect

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

# a hundredth of an arcsecond: there the sky doesn't determine the right ascension any more
_POLE_DEG = 90.0 - 0.01 / 3600.0


class _Fs2:
    """An FS-2: no words of its own; at the very pole it says the right ascension that it was sent to."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake

    def reboot(self) -> None:
        """Nothing to forget."""

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        fake = self._fake
        if text == "GR" and fake.target_ra_deg is not None and fake.mechanics.tracking:
            sent = fake.target_dec_deg or 0.0
            here = fake.mechanics.reported().dec_deg
            if sent * here > 0.0 and min(abs(sent), abs(here)) >= _POLE_DEG:
                return ra_to_text(fake.target_ra_deg, short=fake.short) + b"#"
        return from_the_horizon_up(fake) if text == "MS" else None


class _SkySensor:
    """A SkySensor2000PC: without tracking in the alignment for land; one digit of altitude will do."""

    _ALTITUDE = re.compile(r"Sa([+-])(\d)([*:].*)")

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._on_land = False

    def reboot(self) -> None:
        """Begin as one that tracks."""
        self._on_land = False

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        fake = self._fake
        if text in ("AL", "AP"):
            self._on_land = text == "AL"
            if text == "AP":
                fake.mechanics.tracking = True
        if self._on_land and fake.mechanics.tracking and not fake.mechanics.slewing():
            # a slew under way goes to its end
            fake.mechanics.tracking = False
        if text in ("AL", "AP"):
            return b""
        if text == "MS":
            return from_the_horizon_up(fake)
        short = self._ALTITUDE.fullmatch(text)
        if short is not None:
            return fake.carry_out(f":Sa{short[1]}0{short[2]}{short[3]}#".encode("latin-1"))
        return None


class _OpenAstroTech:
    """Its firmware: `:Q#` ends tracking too; `:I#` means the remote control only, `:hU#` unparks."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake

    def reboot(self) -> None:
        """Nothing to forget."""

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        mechanics = self._fake.mechanics
        if text in ("I", "GVD", "GVT", "GVF"):
            # its firmware doesn't know the last three; INDI's driver waits 5 s for each
            return b""
        if text == "hP":
            mechanics.park()
            return b""
        if text == "hF":
            mechanics.home()
            return b""
        if text == "hU":
            mechanics.unpark()
            mechanics.tracking = True
            return b"1"
        if text == "Q":
            mechanics.stop()
            mechanics.tracking = False
            return b""
        if text in ("MT0", "MT1"):
            mechanics.tracking = text == "MT1"
            return b"1"
        if text in ("GIS", "GIT"):
            return b"%d#" % (mechanics.slewing() if text == "GIS" else mechanics.tracking)
        return self._status() if text == "GX" else None

    def _status(self) -> bytes:
        mechanics = self._fake.mechanics
        doing = "Parked" if mechanics.parked else "Parking" if mechanics.parking else None
        if doing is None:
            doing = "SlewToTarget" if mechanics.slewing() else "Tracking" if mechanics.tracking else "Idle"
        axes = mechanics.axes()
        place = mechanics.reported()
        ra = ra_to_text(place.ra_deg).replace(b":", b"").decode()
        seconds = round(abs(place.dec_deg) * 3600.0)
        sign = "-" if place.dec_deg < 0 else "+"
        dec = f"{sign}{seconds // 3600:02d}{seconds // 60 % 60:02d}{seconds % 60:02d}"
        moves = ("rd" if mechanics.slewing() else "--") + ("T" if mechanics.tracking else "-") + "--"
        steps = f"{round(axes.ha_axis_deg * 400.0)},{round(axes.dec_axis_deg * 400.0)},0"
        return f"{doing},{moves},{steps},{ra},{dec},#".encode()


FS2_FAKE = FakeDialect(name="fs2", speaker=_Fs2)

SKY_SENSOR_FAKE = FakeDialect(name="ss2000pc", speaker=_SkySensor)

OPEN_ASTRO_TECH_FAKE = FakeDialect(
    name="openastrotech",
    product={"P": b"OpenAstroTracker", "N": b"V1.13.9"},
    speaker=_OpenAstroTech,
    matched=b"NONE#",
    busy=b"|#",
    idle=b" #",
)
