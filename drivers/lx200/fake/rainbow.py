"""A RainbowAstro RST from the other side of the cable: answers that begin with their question.

It says by itself when a slew has ended (`:MM0#`) or why it doesn't go (`:MML#`). Known from INDI 1.9.9's
driver and from nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from drivers.lx200.codec.angles import ra_to_text
from drivers.lx200.fake.base import FakeLx200, Horizon
from drivers.lx200.fake.dialect import FakeDialect
from mountnav.clock import utc_now
from mountnav.devices import TrackingRate
from mountnav.sky.coordinates import Apparent, Site

_RATES = {"R": TrackingRate.SIDEREAL, "S": TrackingRate.SOLAR, "M": TrackingRate.LUNAR}
_SYNC = re.compile(r"C[kN](\d{3}\.\d{3})([+-]\d{2}\.\d{3})")
_SPEED = re.compile(r"Cu([0-3])=([\d.]+)")
_SITE = re.compile(r"S([tg])([+-])(\d{2,3})\*(\d{2})'(\d{2})")
_LOOK_S = 0.05
"""How often the fake looks whether what it has to announce has happened. Chosen by hand."""
# what rounding puts below the horizon is not below it
_LOWEST_DEG = -1.0 / 60.0


def _sexagesimal(deg: float, digits: int, sign: str) -> bytes:
    tenths = round(abs(deg) * 36000.0)
    degrees, minutes, seconds = tenths // 36000, tenths // 600 % 60, tenths % 600
    return f"{sign}{degrees:0{digits}d}*{minutes:02d}'{seconds // 10:02d}.{seconds % 10}".encode()


def _sign(deg: float) -> str:
    return "-" if deg < 0.0 else "+"


class _Rainbow:
    """What it says when asked; `FakeRainbow` adds what it says unasked."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._horizon = Horizon(fake.mechanics)
        self._speeds = {"0": "0.5", "1": "0016", "2": "0128", "3": "0800"}

    def reboot(self) -> None:
        """Speeds outlast a power cycle, targets don't."""
        self._horizon = Horizon(self._fake.mechanics)

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's. Raises `ValueError`."""
        if text in ("AV", "AS", "AT"):
            tracks = b"1" if self._fake.mechanics.tracking else b"0"
            return b":" + text.encode() + {"AV": b"190905", "AS": b"123456", "AT": tracks}[text] + b"#"
        if text[:1] == "G" and len(text) == 2:
            value = self._value(text[1])
            return None if value is None else b":" + text.encode() + value + b"#"
        if text[:1] == "C":
            return self._control(text)
        if text[:2] in ("Sz", "Sa"):
            # its driver awaits no answer to these
            return b"" if self._horizon.say(text, short=False) is not None else None
        if text in ("MS", "MA"):
            return self._go(self._fake.target() if text == "MS" else self._horizon.target(), text == "MS")
        if text == "Q":
            if isinstance(self._fake, FakeRainbow):
                self._fake.canceled()
            return None
        return self._stand(text)

    def _value(self, what: str) -> bytes | None:
        fake, mechanics = self._fake, self._fake.mechanics
        place, site = mechanics.reported(), mechanics.believed_site
        local = fake.local_time()
        values: dict[str, Callable[[], bytes]] = {
            "R": lambda: ra_to_text(place.ra_deg, decimals=1),
            "D": lambda: _sexagesimal(place.dec_deg, 2, _sign(place.dec_deg)),
            "Z": lambda: (self._horizon.say("GZ", short=False) or b"").rstrip(b"#"),
            "A": lambda: (self._horizon.say("GA", short=False) or b"").rstrip(b"#"),
            "t": lambda: _sexagesimal(site.latitude_deg, 2, _sign(site.latitude_deg)),
            # east is minus
            "g": lambda: _sexagesimal(site.longitude_deg, 3, _sign(-site.longitude_deg)),
            "G": lambda: b"%+03d" % round(fake.hours_to_utc),
            "L": lambda: local.strftime("%H:%M:%S").encode(),
            "C": lambda: local.strftime("%m/%d/%y").encode(),
        }
        return values[what]() if what in values else None

    def _control(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        sync = _SYNC.fullmatch(text)
        if sync is not None:
            mechanics.sync(Apparent(float(sync[1]), float(sync[2]), utc_now()))
            return b""
        if text in ("CtA", "CtL"):
            # its driver says L for off and for the Moon
            mechanics.tracking = text == "CtA"
            return b""
        if text[:2] == "Ct" and text[2:] in (*_RATES, "U"):
            mechanics.rate = _RATES.get(text[2:], mechanics.rate)
            return b""
        speed = _SPEED.fullmatch(text)
        if speed is not None:
            self._speeds[speed[1]] = speed[2]
            return b""
        if re.fullmatch(r"CU[0-3]", text):
            return f":{text}={self._speeds[text[2]]}#".encode()
        if text == "Ch":
            mechanics.home()
            self._await(b":CHO#", tracks=False)
            return b""
        return {"Cv": b":Cv12.1#", "CT": b":CT20.0|21.0|21.5#", "CP": b":CP03.0|03.5#"}.get(text)

    def _go(self, target: Apparent | None, tracks: bool) -> bytes:
        mechanics = self._fake.mechanics
        if target is None:
            return b""
        if mechanics.believed_altitude_deg(target) < _LOWEST_DEG or mechanics.slew(target) is not None:
            self._fake.say(b":MML#")
            return b""
        self._await(b":MM0#", tracks=tracks)
        return b""

    def _await(self, word: bytes, *, tracks: bool) -> None:
        if isinstance(self._fake, FakeRainbow):
            self._fake.announce(word, tracks=tracks)

    def _stand(self, text: str) -> bytes | None:
        where = _SITE.fullmatch(text)
        if where is None:
            return None
        size_deg = int(where[3]) + int(where[4]) / 60.0 + int(where[5]) / 3600.0
        deg = -size_deg if where[2] == "-" else size_deg
        site = self._fake.mechanics.believed_site
        latitude_deg, longitude_deg = site.latitude_deg, site.longitude_deg
        if where[1] == "t":
            latitude_deg = deg
        else:
            longitude_deg = (180.0 - deg) % 360.0 - 180.0
        self._fake.mechanics.set_believed_site(Site(latitude_deg, longitude_deg, site.height_m))
        return b""


class FakeRainbow(FakeLx200):
    """A fake that says by itself when it has arrived."""

    _awaited: bytes | None = None
    _then_tracks = True

    def announce(self, word: bytes, *, tracks: bool) -> None:
        """Say a word once it rests; after a slew in altitude and azimuth it doesn't track."""
        self._awaited, self._then_tracks = word, tracks

    def canceled(self) -> None:
        """Say nothing any more: its driver awaits no word after a stop."""
        self._awaited = None

    def dues(self) -> list[float]:
        """Look again soon while something moves."""
        return [] if self._awaited is None else [self._monotonic() + _LOOK_S]

    def tick(self) -> None:
        """Say that it has arrived."""
        mechanics = self.mechanics
        if self._awaited is None or mechanics.slewing() or mechanics.homing:
            return
        word, self._awaited = self._awaited, None
        if not self._then_tracks:
            mechanics.tracking = False
        self.say(word)

    def reboot(self) -> None:
        """Forget where it was going."""
        super().reboot()
        self._awaited = None


RAINBOW_FAKE = FakeDialect(name="rainbow", ack=b"", speaker=_Rainbow, pulses=False)
