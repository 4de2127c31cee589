"""A Gemini Pulsar2 from the other side of the cable: `:Y` words, UTC for its clock.

Known from INDI 1.9.9's driver and from nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

from drivers.lx200.codec.angles import dec_to_text, longitude_from_text, ra_to_text
from drivers.lx200.fake.dialect import FakeDialect
from mountnav.devices import PierSide, TrackingRate
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

_RATES = {1: TrackingRate.SIDEREAL, 2: TrackingRate.LUNAR, 3: TrackingRate.SOLAR}
"""Tracking rates by their numbers in `:YGS#` and `:YSS#`."""
# corrections, speeds, gears, currents, ramps, rotation, a rate of the user's
_SETTINGS = {
    "P": b"0,0",
    "R": b"0,0",
    "A": b"5,5",
    "B": b"32,32",
    "C": b"128,128",
    "D": b"800,800",
    "E": b"800,800",
    "p": b"3,3",
    "r": b"1440,1440",
    "m": b"144,144",
    "b": b"0:00",
    "X": b"+00.0000,000.0000",
    "Z1": b"+0.0000000,+0.0000000",
    "t": b"0500,0500",
    "s": b"0300,0300",
    "g": b"0800,0800",
    "Q": b"0",
    "n": b"0,0",
}
_SET = re.compile(r"YS([A-Za-z])(.*)")
_SITE = re.compile(r"S([tl])\s*(-?)(\d{2,3}):(\d{2})")


class _Pulsar:
    """What it says, and keeps: settings that turn nothing here."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._settings = dict(_SETTINGS)

    def reboot(self) -> None:
        """Settings outlast a power cycle."""

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        fake, mechanics = self._fake, self._fake.mechanics
        if text[:2] == "YG":
            return self._asked(text[2:])
        if text == "YV":
            return b"PULSAR V5.70aR  ,2016.03.07.     #"
        if text in ("YH", "YL"):
            if text == "YH":
                mechanics.park()
            elif mechanics.parked or mechanics.parking:
                mechanics.unpark()
                mechanics.tracking = True
            return b"1#"
        if text == "CM":
            return self._synced()
        if text == "MS":
            target = fake.target()
            if target is None or fake.refusal(target) is not None:
                return None
            mechanics.slew(target)
            return b"0#"
        if text == "U":
            fake.short = not fake.short
            return b"1"
        return self._set(text)

    def _asked(self, what: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if what == "l":
            site = mechanics.believed_site
            return b"%+09.4f,%+09.4f#" % (site.latitude_deg, -site.longitude_deg)
        flags: dict[str, Callable[[], bool]] = {
            "h": lambda: True,
            "k": lambda: mechanics.parked,
            "j": lambda: mechanics.parking,
            "i": mechanics.slewing,
            "N": lambda: mechanics.pier_side() is PierSide.WEST,
        }
        if what in flags:
            return b"%d#" % flags[what]()
        if what == "M":
            return b"1#" if mechanics.machine.mounting == "german" else b"2#"
        if what == "S":
            number = next((number for number, rate in _RATES.items() if rate is mechanics.rate), 1)
            return b"%d,0#" % (number if mechanics.tracking else 0)
        return self._settings[what] + b"#" if what in self._settings else None

    def _synced(self) -> bytes:
        fake = self._fake
        target = fake.target()
        if target is not None:
            fake.mechanics.sync(target)
        place = fake.mechanics.reported()
        # where it believes to look now
        return ra_to_text(place.ra_deg) + b"#" + dec_to_text(place.dec_deg) + b"#"

    def _set(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        where = _SITE.fullmatch(text)
        if where is not None:
            size_deg = int(where[3]) + int(where[4]) / 60.0
            site = mechanics.believed_site
            latitude_deg, longitude_deg = site.latitude_deg, site.longitude_deg
            if where[1] == "t":
                latitude_deg = -size_deg if where[2] else size_deg
            else:
                longitude_deg = longitude_from_text(text[2:].strip().encode("latin-1"))
            mechanics.set_believed_site(Site(latitude_deg, longitude_deg, site.height_m))
            return b"1"
        match = _SET.fullmatch(text)
        if match is None:
            return None
        if match[1] == "S":
            number = int(match[2].partition(",")[0])
            mechanics.rate = _RATES.get(number, mechanics.rate)
            mechanics.tracking = number != 0
        elif match[1] in self._settings:
            self._settings[match[1]] = match[2].encode("latin-1")
        elif match[1] not in ("M", "N", "Z"):
            return None
        return b"1"


PULSAR_FAKE = FakeDialect(name="pulsar2", speaker=_Pulsar, unparks_by_itself=False)
