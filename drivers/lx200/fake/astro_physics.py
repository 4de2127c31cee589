"""An Astro-Physics GTO controller from the other side of the cable [AP protocol, :GOS#].

It answers neither ACK nor a product; until it was unparked or calibrated it says that it looks at 0 h, +90°.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, cast

from drivers.lx200.codec.angles import dec_to_text, ra_to_text
from drivers.lx200.fake.base import from_the_horizon_up
from drivers.lx200.fake.dialect import MATCHED, FakeDialect
from mountnav.devices import PierSide, TrackingRate
from mountnav.simulation.mechanics import Direction
from mountnav.sky.coordinates import SIDEREAL_DEG_S

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

_VERSION = b"VCP4-P02-12"
_PULSE = re.compile(r"M([nsew])(\d{3})")
_OFFSET = re.compile(r"R([RD])([+-]?\d{1,3}\.\d{4})")
"""A rate on top of tracking, in times sidereal [AP protocol :RR :RD]."""
_RATE = {"0": TrackingRate.LUNAR, "1": TrackingRate.SOLAR, "2": TrackingRate.SIDEREAL}
_CENTER_RATES = {"0": 12.0, "1": 64.0, "2": 200.0, "3": 600.0, "4": 1200.0, "5": 0.25, "6": 0.5, "7": 1.0}
"""What the numbers of `:RCn#` mean to the fake, in times sidereal."""
_GUIDE_RATES = {"0": 0.25, "1": 0.5, "2": 1.0}
"""What the numbers of `:RGn#` mean to the fake, in times sidereal."""
# what has no answer and does nothing here: pier swap, buttons, slew rates, error correction
_QUIET = re.compile(r"p[PR]?|NS|EW|FLIP")


class _Controller:
    """What it says, and keeps: its rates, and whether it was ever calibrated."""

    def __init__(self, fake: FakeLx200, *, version: bytes = _VERSION, rates_unpark: bool = False) -> None:
        self._fake = fake
        self._version, self._rates_unpark = version, rates_unpark
        self._calibrated = True
        self._center, self._guide = "1", "1"
        self._hand = "C"

    def reboot(self) -> None:
        """Know nothing."""
        self._calibrated = False

    def say(self, text: str) -> bytes | None:
        """Answer, or None for a word that is the classic's."""
        if text == "V":
            return self._version + b"#"
        if text in ("GR", "GD"):
            return self._place(text)
        if text == "MS":
            return from_the_horizon_up(self._fake)
        if text in ("KA", "PO"):
            return self._park(text)
        if text in ("CM", "CMR"):
            refused = self._fake.synced()
            self._calibrated = True
            return refused or MATCHED
        if text[:1] == "R" and len(text) in (2, 3):
            return self._rate(text[1:])
        offset = _OFFSET.fullmatch(text)
        if offset is not None:
            return self._beside(offset[1], float(offset[2]))
        return self._status(text) or self._moving(text)

    def _place(self, text: str) -> bytes:
        fake = self._fake
        if not self._calibrated:
            unset = b"00:00.0#" if fake.short else b"00:00:00.0#"
            return unset if text == "GR" else dec_to_text(90.0, short=fake.short) + b"#"
        place = fake.mechanics.reported()
        if text == "GD":
            return dec_to_text(place.dec_deg, short=fake.short) + b"#"
        if fake.short:
            return ra_to_text(place.ra_deg, short=True) + b"#"
        return ra_to_text(place.ra_deg, decimals=1) + b"#"

    def _park(self, text: str) -> bytes:
        mechanics = self._fake.mechanics
        if text == "KA":
            # where it stands: its drivers slew to their park place before
            mechanics.set_park()
            mechanics.park()
        else:
            mechanics.unpark()
            self._calibrated = True
        return b""

    def _rate(self, what: str) -> bytes | None:
        mechanics = self._fake.mechanics
        kind, number = what[0], what[1:]
        if kind == "T" and number in (*_RATE, "9"):
            if number != "9":
                mechanics.rate = _RATE[number]
                if self._rates_unpark:
                    mechanics.unpark()
            mechanics.tracking = number != "9"
        elif kind == "G" and number in _GUIDE_RATES:
            self._guide = number
        elif kind == "C" and number in _CENTER_RATES:
            self._center = number
        elif not (kind == "S" and number in ("0", "1", "2")) and what not in ("G", "C"):
            return None
        if kind in "GC":
            self._hand = kind
        return b""

    def _beside(self, axis: str, times: float) -> bytes:
        """Take a rate on top of tracking: faster, to the west; in declination to the south."""
        ra, dec = self._fake.mechanics.beside_arcsec_s
        rate_arcsec_s = -times * SIDEREAL_DEG_S * 3600.0
        rates = (rate_arcsec_s, dec) if axis == "R" else (ra, rate_arcsec_s)
        self._fake.mechanics.track_beside(*rates)
        return b"1"

    def _status(self, text: str) -> bytes | None:
        mechanics = self._fake.mechanics
        if text == "GOS":
            rate = next((number for number, rate in _RATE.items() if rate is mechanics.rate), "2")
            return (
                ("P" if mechanics.parked else "0")
                + (rate if mechanics.tracking else "9")
                + "9"
                + ("S" if mechanics.slewing() else "0")
                + "00"
                + self._guide
                + self._center
                + "2O0000#"
            ).encode()
        if text == "pS":
            return b"West#" if mechanics.pier_side() is PierSide.WEST else b"East#"
        if text == "G\x05" or text == "G_E":
            return b"0#"
        # place on the worm, of its error correction; backlash compensation
        return {"Gp": b"0123#"}.get(text) or (b"1" if text[:2] == "Br" else None)

    def _moving(self, text: str) -> bytes | None:
        fake, mechanics = self._fake, self._fake.mechanics
        pulse = _PULSE.fullmatch(text)
        if pulse is not None:
            rate_deg_s = _GUIDE_RATES[self._guide] * SIDEREAL_DEG_S
            mechanics.pulse(cast("Direction", pulse[1]), rate_deg_s, int(pulse[2]) / 1000.0)
            return b""
        if text in ("Mn", "Ms", "Me", "Mw"):
            factor = _GUIDE_RATES[self._guide] if self._hand == "G" else _CENTER_RATES[self._center]
            mechanics.move(cast("Direction", text[1:]), factor * SIDEREAL_DEG_S)
            return b""
        if text == "GG":
            return b"%+03d:00:00#" % round(fake.hours_to_utc)
        return b"" if _QUIET.fullmatch(text) else None


ASTRO_PHYSICS_FAKE = FakeDialect(
    name="ap",
    ack=b"",
    speaker=_Controller,
    pulses=False,
    unparks_by_itself=False,
)

GTOCP2_FAKE = FakeDialect(
    name="ap-gtocp2",
    ack=b"",
    # a GTOCP1 or 2 says one letter [AP protocol, :V#]; `:PO#` is for the beginning only, a rate goes on after
    # a park, as INDI's driver has it from Astro-Physics
    speaker=lambda fake: _Controller(fake, version=b"E", rates_unpark=True),
    pulses=False,
    unparks_by_itself=False,
)
