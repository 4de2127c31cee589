"""The other end of an LX200 cable: bytes in, bytes out, over the mechanics of a telescope that points wrong.

It speaks the classic's words as recorded between the real INDI drivers and a mount [LX200]; what a dialect
has besides, and what it lacks, is its `FakeDialect`. What it doesn't know it answers with silence, as real
ones do.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from typing import cast

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.lx200.codec.angles import (
    dec_from_text,
    dec_to_text,
    longitude_from_text,
    longitude_to_text,
    ra_from_text,
    ra_to_text,
)
from drivers.lx200.codec.site_and_time import date_from_text, hours_to_utc_from_text, time_from_text
from drivers.lx200.fake.dialect import FakeDialect, Speaker
from drivers.lx200.fake.meade import GENERIC_FAKE
from drivers.wire.command import Unreadable
from mountnav.clock import utc_now
from mountnav.devices import TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    hour_angle_to_apparent,
    hour_angle_to_observed,
    observed_to_hour_angle,
    sidereal_time_deg,
)
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, GeometricHourAngle, HourAngle, Observed, Site

_AZIMUTH = re.compile(r"(\d{1,3})[*:](\d{2})(?:[:'](\d{2})(?:\.\d)?)?")


class Horizon:
    """Words in altitude and azimuth, by the mount's own clock and site; azimuths from north through east."""

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._az_deg: float | None = None
        self._alt_deg: float | None = None

    def say(self, text: str, *, short: bool) -> bytes | None:
        """Answer `GS`, `GA`, `GZ`, `Sz`, `Sa`; None for anything else. Raises `Unreadable`."""
        if text == "GS":
            mechanics = self._mechanics
            return ra_to_text(sidereal_time_deg(mechanics.believed_utc(), mechanics.believed_site)) + b"#"
        if text in ("GA", "GZ"):
            seen = self._seen()
            if text == "GA":
                return dec_to_text(max(-90.0, min(90.0, seen.alt_deg)), short=short) + b"#"
            # the sign of a declination is not of an azimuth
            steps = round(seen.az_deg * 3600.0) % 1296000
            degrees, minutes = steps // 3600, steps // 60 % 60
            return b"%03d*%02d%s#" % (degrees, minutes, b"" if short else b":%02d" % (steps % 60))
        if text[:2] == "Sz":
            match = _AZIMUTH.fullmatch(text[2:].strip())
            if match is None or int(match[1]) > 360:
                raise Unreadable(f"{text!r} is not an azimuth")
            self._az_deg = int(match[1]) + int(match[2]) / 60.0 + int(match[3] or 0) / 3600.0
            return b"1"
        if text[:2] == "Sa":
            wire = text[2:].strip().encode("latin-1")
            self._alt_deg = dec_from_text(wire if wire[:1] in b"+-" else b"+" + wire).deg
            return b"1"
        return None

    def target(self) -> Apparent | None:
        """The place that was given in altitude and azimuth, as it would be read now; None without both."""
        if self._az_deg is None or self._alt_deg is None:
            return None
        mechanics = self._mechanics
        utc, site = mechanics.believed_utc(), mechanics.believed_site
        angles = observed_to_hour_angle(Observed(self._az_deg, self._alt_deg, utc), site)
        return hour_angle_to_apparent(GeometricHourAngle(angles.ha_deg, angles.dec_deg, utc), site)

    def _seen(self) -> Observed:
        mechanics = self._mechanics
        utc, site = mechanics.believed_utc(), mechanics.believed_site
        place = mechanics.reported()
        angles = apparent_to_hour_angle(Apparent(place.ra_deg, place.dec_deg, utc), site)
        # only turned from the pole to the zenith: these mechanics know no refraction
        return hour_angle_to_observed(HourAngle(angles.ha_deg, angles.dec_deg, utc), site)


_ACK = 0x06
"""The byte that asks for the alignment letter, alone and without `#` [LX200 0x06]."""
# a point of a 10micron's model has 71 bytes
_LONGEST_COMMAND = 120
_GUIDE_RATE_DEG_S = SIDEREAL_DEG_S
_RATES_DEG_S = {"G": _GUIDE_RATE_DEG_S, "C": 16 * _GUIDE_RATE_DEG_S, "M": 1.0}
"""Rates of `:RG#`, `:RC#`, `:RM#`; the rate of `:RS#` is the mechanics' own [LX200]."""
_TRACKING = {
    "Q": (TrackingRate.SIDEREAL, b"60.1"),
    "L": (TrackingRate.LUNAR, b"57.9"),
    "S": (TrackingRate.SOLAR, b"60.0"),
    "M": (TrackingRate.SIDEREAL, b"60.1"),
}
_THREE_DIGITS = re.compile(rb"^([+-])0(\d\d\D)")
_SETTERS = ("Sr", "Sd", "St", "Sg", "SG", "SL", "SC")
_REFUSALS = {
    Refusal.BELOW_HORIZON: b"1Object below horizon.#",
    Refusal.LIMIT: b"2Object below higher.#",
    Refusal.PARKED: b"1Scope is parked.#",
}


class FakeLx200(WireFake):
    """An LX200 on the wire.

    Parameters
    ----------
    mechanics : Mechanics
        What moves, and what it believes of itself, its clock and its site included.
    short : bool
        Whether it starts in the short format (``HH:MM.T``).
    lowest_altitude_deg : float
        Targets below are refused as under the horizon.
    dialect : FakeDialect, optional
        a clone with Autostar's words if None.
    faults, clock, monotonic
        As of `WireFake`.
    """

    IDENTITY = (b":GV",)

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        short: bool = False,
        lowest_altitude_deg: float = 0.0,
        dialect: FakeDialect | None = None,
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
        seed: int = 0,
    ) -> None:
        super().__init__(mechanics, faults=faults, clock=clock, monotonic=monotonic, seed=seed)
        self.dialect = dialect or GENERIC_FAKE
        self.short = short
        self.target_ra_deg: float | None = None
        self.target_dec_deg: float | None = None
        self.hours_to_utc = 0.0
        self._horizon, self._by_horizon = Horizon(mechanics), False
        self._short_at_boot = short
        self._lowest_altitude_deg = lowest_altitude_deg
        self._high_precision_pointing = False
        self._rate_deg_s = mechanics.slew_rate_deg_s
        self._tracking_hz = b"60.1"
        self._speaker: Speaker | None = self.dialect.speaker(self) if self.dialect.speaker else None

    # -- the wire --------------------------------------------------------------------------------

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        """Cut off a command; a lone `#`, zeros and noise between commands are nothing [LX200 link]."""
        while buffer:
            if buffer[0] == _ACK:
                return buffer[:1], buffer[1:]
            if buffer[:1] == b":" or (buffer[:1] in (b"<", b">", b"b") and self._natives is not None):
                end = buffer.find(b"#")
                if end >= 0 and (buffer[:1] == b":" or self._is_native(buffer[: end + 1])):
                    return buffer[: end + 1], buffer[end + 1 :]
                if end < 0 and len(buffer) <= _LONGEST_COMMAND:
                    return None, buffer
            buffer = buffer[1:]
        return None, b""

    @property
    def _natives(self) -> Callable[[bytes], bool] | None:
        """How to know a command that doesn't begin with a colon; None where there are none."""
        natives: Callable[[bytes], bool] | None = getattr(self._speaker, "natives", None)
        return natives

    def _is_native(self, command: bytes) -> bool:
        return self._natives is not None and self._natives(command)

    def carry_out(self, command: bytes) -> bytes | None:
        """Do it, and answer."""
        text = (command[1:-1] if command[:1] == b":" else command).decode("latin-1")
        try:
            said = None if self._speaker is None else self._speaker.say(text)
            if said is not None:
                return said
            if command == bytes([_ACK]):
                return self.dialect.ack or None
            return self._known(text) if self.dialect.classic_too(text) else None
        except (Unreadable, ValueError):
            return b"0"

    def deaf_reply(self, command: bytes) -> bytes:
        """Answer as if it were done."""
        known = {b":CM#": self.dialect.matched, b":MS#": b"0"}
        return known.get(command, b"1" if command[1:2] == b"S" else b"")

    def denial(self, command: bytes) -> bytes | None:
        """How its dialect says no."""
        return self.dialect.denials.get(command[1:-1].decode("latin-1"))

    def reboot(self) -> None:
        """Forget target, rates and format; the mechanics forget what their machine forgets."""
        super().reboot()
        self.target_ra_deg = self.target_dec_deg = None
        self._horizon, self._by_horizon = Horizon(self.mechanics), False
        self.short = self._short_at_boot
        self._high_precision_pointing = False
        self._rate_deg_s = self.mechanics.slew_rate_deg_s
        if not self.mechanics.machine.remembers_clock:
            self.hours_to_utc = 0.0
        if self._speaker is not None:
            self._speaker.reboot()

    # -- the meaning -----------------------------------------------------------------------------

    def _known(self, text: str) -> bytes | None:
        """Carry out one of the classic's commands; None when it isn't one."""
        of_horizon = self._horizon.say(text, short=self.short)
        if of_horizon is not None:
            self._by_horizon = self._by_horizon or text[:1] == "S"
            return of_horizon
        if text[:2] in _SETTERS:
            self._by_horizon = self._by_horizon and text[:2] not in ("Sr", "Sd")
            return self._set(text[:2], text[2:].strip())
        if text[:1] == "G":
            return self._get(text[1:])
        if text[:1] == "M":
            return self._move(text[1:])
        if text[:1] == "Q" and text[1:] in ("", "n", "s", "e", "w"):
            if text[1:]:
                self.mechanics.stop_move(cast("Direction", text[1:]))
            else:
                self.mechanics.stop()
            return b""
        if text[:1] == "R" and text[1:] in ("G", "C", "M", "S"):
            self._rate_deg_s = _RATES_DEG_S.get(text[1:], self.mechanics.slew_rate_deg_s)
            return b""
        if text[:1] == "T" and text[1:] in _TRACKING:
            self.mechanics.rate, self._tracking_hz = _TRACKING[text[1:]]
            return b""
        return self._other(text)

    def _other(self, text: str) -> bytes | None:
        if text == "D":
            return self.dialect.busy if self.mechanics.slewing() else self.dialect.idle
        if text == "CM":
            return self.synced() or self.dialect.matched
        if text == "U":
            self.short = not self.short
            return b""
        if text == "P":
            self._high_precision_pointing = not self._high_precision_pointing
            return b"HIGH PRECISION" if self._high_precision_pointing else b"LOW  PRECISION"
        # the alignment mode is taken without an answer; these mechanics stay polar
        return b"" if text in ("AP", "AA", "AL") else None

    def target(self) -> Apparent | None:
        """Give the target that was set last; None while a half of it is missing."""
        if self._by_horizon:
            return self._horizon.target()
        if self.target_ra_deg is None or self.target_dec_deg is None:
            return None
        return Apparent(self.target_ra_deg, self.target_dec_deg, utc_now())

    def synced(self) -> bytes:
        """Sync on the target; what there is to say if it doesn't do it."""
        target = self.target()
        refused = None if target is None else self.mechanics.sync(target)
        # Meade's have no words for it: their string is the same whatever happens
        return b"" if refused is None else self.dialect.matched

    def refusal(self, target: Apparent) -> Refusal | None:
        """Why it doesn't slew there, by its own horizon or its mechanics."""
        if self.mechanics.parked and self.dialect.unparks_by_itself:
            self.mechanics.unpark()
        refused = self.mechanics.refusal(target)
        if refused is None and self.mechanics.believed_altitude_deg(target) < self._lowest_altitude_deg:
            return Refusal.BELOW_HORIZON
        return refused

    def _move(self, what: str) -> bytes | None:
        if what in ("S", "A"):
            target = self.target()
            if target is None:
                return b"1No object.#"
            refused = self.refusal(target)
            if refused is not None:
                return _REFUSALS.get(refused, b"1Refused.#")
            self.mechanics.slew(target)
            return b"0"
        pulse = re.fullmatch(r"g([nsew])(\d{1,5})", what)
        if pulse is not None and self.dialect.pulses:
            direction = cast("Direction", pulse[1])
            self.mechanics.pulse(direction, _GUIDE_RATE_DEG_S / 2, int(pulse[2]) / 1000.0)
            return b""
        if what in ("n", "s", "e", "w"):
            self.mechanics.move(cast("Direction", what), self._rate_deg_s)
            return b""
        return None

    def _get(self, what: str) -> bytes | None:
        if what in ("R", "D"):
            place = self.mechanics.reported()
            if what == "R":
                return ra_to_text(place.ra_deg, short=self.short) + b"#"
            return dec_to_text(place.dec_deg, short=self.short) + b"#"
        if what[:1] == "V" and what[1:] in self.dialect.product:
            return self.dialect.product[what[1:]] + b"#"
        local = self.local_time()
        site = self.mechanics.believed_site
        answers: dict[str, Callable[[], bytes]] = {
            "r": lambda: ra_to_text(self.target_ra_deg or 0.0, short=self.short),
            "d": lambda: dec_to_text(self.target_dec_deg or 0.0, short=self.short),
            "t": lambda: dec_to_text(site.latitude_deg, short=True),
            "g": lambda: longitude_to_text(site.longitude_deg),
            "T": lambda: self._tracking_hz,
            "c": lambda: b"24",
            "M": lambda: b"Home",
            "G": lambda: b"%+03d" % round(self.hours_to_utc),
            "L": lambda: local.strftime("%H:%M:%S").encode(),
            "C": lambda: local.strftime("%m/%d/%y").encode(),
        }
        return answers[what]() + b"#" if what in answers else None

    def _set(self, what: str, text: str) -> bytes:
        """Take a value; raises `ValueError` (answered `0`) where it makes no sense."""
        wire = text.encode("latin-1")
        if what == "Sr":
            self.target_ra_deg = ra_from_text(wire).deg
        elif what == "Sd":
            self.target_dec_deg = dec_from_text(wire).deg
        elif what in ("St", "Sg"):
            self._set_site(what, wire)
        elif what == "SG":
            # the local time stays, so its idea of UTC moves
            local = self.local_time()
            self.hours_to_utc = hours_to_utc_from_text(wire)
            self.set_local_time(local)
        else:
            return self._set_clock(what, wire)
        return b"1"

    def _set_site(self, what: str, wire: bytes) -> None:
        site = self.mechanics.believed_site
        latitude_deg, longitude_deg = site.latitude_deg, site.longitude_deg
        if what == "St":
            # some write three digits of degrees
            latitude_deg = dec_from_text(_THREE_DIGITS.sub(rb"\1\2", wire)).deg
        else:
            longitude_deg = longitude_from_text(wire)
        self.mechanics.set_believed_site(Site(latitude_deg, longitude_deg, site.height_m))

    def local_time(self) -> datetime:
        """Show what its clock shows: local time, in a value that calls itself UTC."""
        return self.mechanics.believed_utc() - timedelta(hours=self.hours_to_utc)

    def set_local_time(self, local: datetime) -> None:
        """Set its clock; its idea of where the sky is follows."""
        self.mechanics.set_believed_utc(local + timedelta(hours=self.hours_to_utc))

    def _set_clock(self, what: str, wire: bytes) -> bytes:
        local = self.local_time()
        if what == "SL":
            at = time_from_text(wire)
            self.set_local_time(
                local.replace(hour=at.hour, minute=at.minute, second=at.second, microsecond=at.microsecond)
            )
            return b"1"
        day = date_from_text(wire)
        self.set_local_time(local.replace(year=day.year, month=day.month, day=day.day))
        return b"1Updating        Planetary Data#" + b" " * 30 + b"#"


_ROUNDING_DEG = 1.0 / 60.0
"""A target that rounding put below the horizon by less than this is on it: one step of the short format."""


def from_the_horizon_up(fake: FakeLx200) -> bytes | None:
    """Answer ``:MS#`` to a target at altitude 0, written in arcminutes; None where the classic's words do.

    INDI's drivers park there when no site was ever set.
    """
    target = fake.target()
    if target is None or fake.refusal(target) is not Refusal.BELOW_HORIZON:
        return None
    if fake.mechanics.believed_altitude_deg(target) < -_ROUNDING_DEG:
        return None
    return b"0" if fake.mechanics.slew(target) is None else None
