"""iOptron's older boards and their like from the other side of the cable: HC8406, 8408 (ZEQ25), GotoNova.

They speak LX200 with words of their own, and local time with an ISO offset and longitudes east positive.
What they answer is known from INDI 1.9.9's drivers, and from the dialogue with an HC8406 noted in the source
of its driver. Nobody has tried it on a real one.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

from drivers.lx200.codec.angles import longitude_from_text, ra_to_text
from drivers.lx200.codec.site_and_time import date_from_text, hours_to_utc_from_text
from drivers.lx200.fake.dialect import MATCHED, FakeDialect
from mountnav.devices import PierSide, TrackingRate
from mountnav.simulation.mechanics import Direction
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

_VERSION = b"V1.00#"
_DATE_TAKEN = (b" " * 32 + b"#") * 2
"""The answer to a date: two texts of 32 blanks [LX200 :SC]."""
_RATES_8406 = {"0": TrackingRate.LUNAR, "1": TrackingRate.SOLAR, "2": TrackingRate.SIDEREAL}
_RATES_8408 = {"0": TrackingRate.SIDEREAL, "1": TrackingRate.LUNAR, "2": TrackingRate.SOLAR}
_RATES_GOTONOVA = {"0": TrackingRate.SIDEREAL, "1": TrackingRate.SOLAR, "2": TrackingRate.LUNAR}
_DIRECTIONS: tuple[Direction, ...] = ("n", "s", "e", "w")
_PULSE = re.compile(r"M([nsew])(\d{3,4})")


class _Iso:
    """Clock and site, written the other way round than Meade's."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake

    def say(self, text: str) -> bytes | None:
        """Answer what concerns clock and site in the ISO sense. Raises `ValueError`."""
        fake = self._fake
        if text == "GG":
            return b"%+03d:00:00#" % -round(fake.hours_to_utc)
        if text[:2] == "SG":
            local = fake.local_time()
            fake.hours_to_utc = -hours_to_utc_from_text(text[2:].strip().encode("latin-1"))
            fake.set_local_time(local)
            return b"1"
        if text == "Gg":
            longitude_deg = fake.mechanics.believed_site.longitude_deg
            minutes = round(abs(longitude_deg) * 60.0)
            return b"%s%03d*%02d:00#" % (b"-" if longitude_deg < 0 else b"+", minutes // 60, minutes % 60)
        if text[:2] == "Sg":
            # read as Meade's and turned round
            east_deg = -longitude_from_text(text[2:].strip().encode("latin-1"))
            self._stand_at(east_deg)
            return b"1"
        return None

    def west(self, text: str) -> bytes:
        """Take a longitude that is west positive. Raises `ValueError`."""
        self._stand_at(longitude_from_text(text.encode("latin-1")))
        return b"1"

    def _stand_at(self, longitude_deg: float) -> None:
        site = self._fake.mechanics.believed_site
        self._fake.mechanics.set_believed_site(Site(site.latitude_deg, longitude_deg, site.height_m))

    def take_date(self, text: str) -> None:
        """Take a date; the drivers divide it by slashes or colons."""
        day = date_from_text(text.strip().encode("latin-1"))
        local = self._fake.local_time()
        self._fake.set_local_time(local.replace(year=day.year, month=day.month, day=day.day))


def _side(fake: FakeLx200) -> bytes:
    # a fork has no sides; these always name one
    return b"West#" if fake.mechanics.pier_side() is PierSide.WEST else b"East#"


class _Board8406:
    """An HC8406: much of Astro-Physics' words; parks by `:KA#`, has no word to unpark."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._iso = _Iso(fake)

    def reboot(self) -> None:
        """Nothing to forget."""

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        fake, mechanics = self._fake, self._fake.mechanics
        if text == "V":
            return _VERSION
        if text == "pS":
            return _side(fake)
        if text == "GR":
            return ra_to_text(mechanics.reported().ra_deg, decimals=1) + b"#"
        if text[:2] == "SC":
            self._iso.take_date(text[2:])
            return _DATE_TAKEN
        if text == "CMR":
            return fake.synced() or MATCHED
        if text == "KA":
            mechanics.park()
            return b""
        if text[:2] == "RT" and text[2:] in (*_RATES_8406, "9"):
            # firmware from 1.12 on; 1.10 can't be stopped
            mechanics.tracking = text[2:] != "9"
            mechanics.rate = _RATES_8406.get(text[2:], mechanics.rate)
            return b""
        if re.fullmatch(r"R[CGS]\d", text):
            return b""
        if text[:2] == "Sg":
            # its driver writes them west positive, whatever sign it puts before
            return self._iso.west(text[2:].strip().lstrip("+-"))
        pulsed = _pulsed(fake, text)
        return self._iso.say(text) if pulsed is None else pulsed


def _pulsed(fake: FakeLx200, text: str) -> bytes | None:
    pulse = _PULSE.fullmatch(text)
    if pulse is None:
        return None
    fake.mechanics.pulse(cast("Direction", pulse[1]), 0.5 * SIDEREAL_DEG_S, int(pulse[2]) / 1000.0)
    return b""


class _Board8408:
    """A ZEQ25 (board 8408): says what it does by single digits, 1 for yes; its park is its home."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._iso = _Iso(fake)
        self._move, self._guide = 5, 50

    def reboot(self) -> None:
        """Forget the chosen rates."""
        self._move, self._guide = 5, 50

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        mechanics = self._fake.mechanics
        asked: dict[str, Callable[[], bytes]] = {
            "V": lambda: _VERSION,
            "MountInfo": lambda: b"8408",
            "Gr": lambda: b"%d#" % self._move,
            "AG": lambda: b"%03d#" % self._guide,
            "AP": lambda: b"%d" % mechanics.parked,
            "AH": lambda: b"%d" % mechanics.at_home,
            "SE": lambda: b"%d" % mechanics.slewing(),
            "pS": lambda: b"%d" % (mechanics.pier_side() is PierSide.WEST),
        }
        if text in asked:
            return asked[text]()
        for words in (self._ordered, self._moved, self._iso.say):
            said = words(text)
            if said is not None:
                return said
        return None

    def _ordered(self, text: str) -> bytes | None:
        fake, mechanics = self._fake, self._fake.mechanics
        if text == "MS":
            target = fake.target()
            if target is None or fake.refusal(target) is not None:
                return b"0"
            mechanics.slew(target)
            return b"1"
        if text == "CM":
            target = fake.target()
            return b"%d" % (target is not None and mechanics.sync(target) is None)
        if text == "MH":
            mechanics.home()
            return b"1"
        if text in ("MP0", "MP1"):
            if text == "MP1":
                mechanics.park()
            else:
                mechanics.unpark()
            return b"1"
        if text[:2] == "SC":
            self._iso.take_date(text[2:])
            return b"1"
        return None

    def _moved(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if text[:2] == "RT" and text[2:] in (*_RATES_8408, "4"):
            mechanics.rate = _RATES_8408.get(text[2:], mechanics.rate)
            return b"1"
        if re.fullmatch(r"SR[1-9]", text):
            self._move = int(text[2:]) - 1
            return b"1"
        if re.fullmatch(r"RG\d{3}", text):
            self._guide = int(text[2:])
            return b"1"
        if text in ("mn", "ms", "me", "mw"):
            mechanics.move(cast("Direction", text[1:]), 2.0 ** (self._move + 1) * SIDEREAL_DEG_S)
            return b""
        if text == "q":
            for direction in _DIRECTIONS:
                mechanics.stop_move(direction)
            return b""
        return _pulsed(self._fake, text)


class _GotoNova:
    """A GotoNova kit: parks by `:PK#`, says whether it slews by `:SE?#`."""

    def __init__(self, fake: FakeLx200) -> None:
        self._fake = fake
        self._iso = _Iso(fake)
        self._guide = b"1"

    def reboot(self) -> None:
        """Forget the chosen guide rate."""
        self._guide = b"1"

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        fake, mechanics = self._fake, self._fake.mechanics
        if text == "V":
            return _VERSION
        if text == "pS":
            return _side(fake)
        if text == "SE?":
            return b"%d" % mechanics.slewing()
        if text == "GGS":
            return self._guide
        if text == "PK":
            mechanics.park()
            return b""
        if text == "CMR":
            return fake.synced() or MATCHED
        if text[:2] == "SC":
            self._iso.take_date(text[2:])
            return _DATE_TAKEN
        chosen = self._chosen(text)
        return self._iso.say(text) if chosen is None else chosen

    def _chosen(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if text[:3] == "STR" and text[3:] in (*_RATES_GOTONOVA, "3"):
            mechanics.rate = _RATES_GOTONOVA.get(text[3:], mechanics.rate)
            return b"1"
        if re.fullmatch(r"SGS\d", text):
            self._guide = text[3:].encode()
            return b"1"
        # the corner it parks in; these mechanics keep their own
        if re.fullmatch(r"STPKP\d", text):
            return b"1"
        return b"" if re.fullmatch(r"RC\d", text) else None


HC8406_FAKE = FakeDialect(name="hc8406", ack=b"", speaker=_Board8406, pulses=False)

ZEQ25_FAKE = FakeDialect(name="zeq25", ack=b"", speaker=_Board8408, pulses=False, unparks_by_itself=False)

GOTONOVA_FAKE = FakeDialect(name="gotonova", ack=b"", speaker=_GotoNova)
