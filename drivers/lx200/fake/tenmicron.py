"""A 10micron HPS on the other end of the cable: its status word, its refusals in words, its model.

It always speaks as in ultra precision, which INDI's driver and ours ask for first [10MICRON :U2#].
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import cast

from drivers.lx200.codec.angles import dec_from_text, degrees_to_fine_text, ra_from_text, ra_to_fine_text
from drivers.lx200.codec.tenmicron import MountStatus
from drivers.lx200.fake.dialect import FakeDialect
from drivers.lx200.fake.site_and_time import Settings
from drivers.wire.command import Unreadable
from mountnav.clock import utc_now
from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Direction, Mechanics
from mountnav.sky.chain import apparent_to_icrs, icrs_to_observed, sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent
from mountnav.units import SECONDS_PER_DAY, UNIX_ZERO_JD

MOST_POINTS = 100
"""A model holds so many stars [10MICRON]."""
FEWEST_POINTS = 3
"""Fewer stars make no model [10MICRON]."""
_SIDES_OF_POINTS = {b"E": PierSide.EAST, b"W": PierSide.WEST}


@dataclass(frozen=True, slots=True)
class ModelPoint:
    """One place where the mount believed to point, and where it was seen to point.

    Attributes
    ----------
    mount_ra_deg, mount_dec_deg : float
        As it reported, of date.
    pier_side : PierSide
        East or west.
    seen_ra_deg, seen_dec_deg : float
        As solved, of date.
    sidereal_deg : float
        Local sidereal time of the frame.
    """

    mount_ra_deg: float
    mount_dec_deg: float
    pier_side: PierSide
    seen_ra_deg: float
    seen_dec_deg: float
    sidereal_deg: float


def point_from_text(wire: bytes) -> ModelPoint:
    """Understand ``MRA,MDEC,side,PRA,PDEC,LST`` [10MICRON :newalpt#].

    Raises
    ------
    Unreadable
        If it is no such text.
    """
    fields = wire.split(b",")
    if len(fields) != 6 or fields[2] not in _SIDES_OF_POINTS:
        raise Unreadable(f"{wire!r} is not a point of a model")
    return ModelPoint(
        ra_from_text(fields[0]).deg,
        _dec(fields[1]),
        _SIDES_OF_POINTS[fields[2]],
        ra_from_text(fields[3]).deg,
        _dec(fields[4]),
        ra_from_text(fields[5]).deg,
    )


def _dec(field: bytes) -> float:
    # INDI's driver leaves out the plus
    return dec_from_text(field if field[:1] in b"+-" else b"+" + field).deg


class FakeModel:
    """The model in force, and the one that is being entered.

    Attributes
    ----------
    points : list of ModelPoint
        Of the model in force.
    entered : list of ModelPoint or None
        Since `newalig`; None when none is being entered.
    """

    def __init__(self) -> None:
        self.points: list[ModelPoint] = []
        self.entered: list[ModelPoint] | None = None
        self.saved: dict[str, list[ModelPoint]] = {}

    def say(self, text: str) -> bytes | None:
        """Answer a command of the model; None for any other."""
        if text == "newalig":
            self.entered = []
            return b"V#"
        if text.startswith("newalpt"):
            return self._add(text[7:].encode("latin-1"))
        if text == "endalig":
            return self._end()
        if text == "delalig":
            self.points = []
            return b"#"
        if text == "getalst":
            return b"%d#" % len(self.points)
        if text == "modelcnt":
            return b"%03d#" % len(self.saved)
        return self._saving(text)

    def _add(self, wire: bytes) -> bytes:
        if self.entered is None or len(self.entered) >= MOST_POINTS:
            return b"E#"
        try:
            self.entered.append(point_from_text(wire))
        except Unreadable:
            return b"E#"
        return b"%03d#" % len(self.entered)

    def _end(self) -> bytes:
        entered, self.entered = self.entered, None
        if entered is None or len(entered) < FEWEST_POINTS:
            return b"E#"
        self.points = entered
        return b"V#"

    def _saving(self, text: str) -> bytes | None:
        match = re.fullmatch(r"model(sv|ld|del)0(\S{1,15})", text)
        if match is None:
            return None
        what, name = match[1], match[2]
        if what == "sv":
            self.saved[name] = list(self.points)
            return b"1#"
        if name not in self.saved:
            return b"0#"
        if what == "ld":
            self.points = list(self.saved[name])
        else:
            del self.saved[name]
        return b"1#"


_REFUSED = {
    Refusal.BELOW_HORIZON: b"1Object Below Horizon        #",
    Refusal.LIMIT: b"2Object Below Higher         #",
    Refusal.OTHER: b"3Cannot Perform Slew         #",
    Refusal.PARKED: b"4Mount Parked                #",
}
_MATCHED = b"Coordinates     matched        #"
_TOO_FAR = b"Match fail: dist. too large#"
_STANDING = {
    "GVP": b"10micron GM1000HPS#",
    "GVN": b"2.15.1#",
    "GVD": b"Jan 18 2017#",
    "GVT": b"12:00:00#",
    "GVZ": b"Q-TYPE2012#",
    "V": b"G#",
}
_RATES = {
    "TQ": TrackingRate.SIDEREAL,
    "TL": TrackingRate.LUNAR,
    "TSOLAR": TrackingRate.SOLAR,
    "TS": TrackingRate.SOLAR,
}
_HZ = {TrackingRate.SIDEREAL: b"60.2#", TrackingRate.LUNAR: b"57.9#", TrackingRate.SOLAR: b"60.0#"}
_NO_AIR = Air(pressure_hpa=0.0)
"""Positions without refraction, as the mount reports them when refraction is off."""
_GUIDE_RATE_DEG_S = 0.5 * SIDEREAL_DEG_S
"""Half sidereal, what the fake's pulses move at. Chosen by hand: the mount's setting is its owner's."""
_MOVE_RATES = {"G": 0.5, "C": 64.0, "M": 600.0, "S": 1200.0}
"""Rates of `:RG#` to `:RS#`, in times sidereal. Chosen by hand, near the maker's."""
_SIDES = {PierSide.EAST: b"E", PierSide.WEST: b"W", PierSide.UNKNOWN: b"E"}
_SIDE_WORDS = {b"E": b"East#", b"W": b"West#"}


class TenMicronSpeaker:
    """One command in, its answer out.

    Parameters
    ----------
    mechanics : Mechanics
        Its own clock and site are the mechanics'.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self.mechanics = mechanics
        self.settings = Settings(mechanics)
        self.model = FakeModel()
        self._temperature, self._pressure = b"+010.0#", b"1013.2#"
        self.reboot()

    def reboot(self) -> None:
        """Forget targets and the word to flip by itself; place, clock and model it keeps."""
        self.target_ra_deg = self.target_dec_deg = 0.0
        self.unattended_flip = False
        self.stopped = False
        self._move_rate = 64.0

    # -- words -----------------------------------------------------------------------------------

    def say(self, text: str) -> bytes | None:
        """Answer a command, given without its `:` and `#`; None for one it doesn't know."""
        if text in _STANDING:
            return _STANDING[text]
        exact = self._exact().get(text)
        if exact is not None:
            return exact()
        if text[:2] in ("Sr", "Sd", "St", "Sg", "SG", "SL", "SC") or text[:5] in ("SRTMP", "SRPRS"):
            return self._set(text)
        told = self._value(text)
        if told is None:
            told = self.model.say(text)
        return self._pattern(text) if told is None else told

    def _exact(self) -> dict[str, Callable[[], bytes]]:
        return {
            "\x06": lambda: b"P" if self.mechanics.tracking else b"L",
            "U": lambda: b"",
            "U0": lambda: b"",
            "U1": lambda: b"",
            "U2": lambda: b"",
            "Ginfo": self._info,
            "Gstat": lambda: b"%d#" % self.status(),
            "GTRK": lambda: b"%d#" % self.mechanics.tracking,
            "D": lambda: b"\x7f#" if self.mechanics.slewing() else b"#",
            "pS": lambda: _SIDE_WORDS[self._side()],
            "GTsid": self._destination,
            "MS": self._slew,
            "CM": self._sync,
            "CMR": self._sync,
            "CMCFG0": lambda: b"0#",
            "CMCFG1": lambda: b"1#",
            "Q": self._stop,
            "STOP": self._halt,
            "AP": lambda: self._track(True),
            "AL": lambda: self._track(False),
            "KA": self._park,
            "PO": self._unpark,
            "FLIP": self._flip,
            "Guaf": lambda: b"%d#" % self.unattended_flip,
            "Suaf0": lambda: self._set_unattended_flip(False),
            "Suaf1": lambda: self._set_unattended_flip(True),
        }

    def _value(self, text: str) -> bytes | None:
        here, settings, site = self.mechanics.reported(), self.settings, self.mechanics.believed_site
        values: dict[str, Callable[[], bytes]] = {
            "GR": lambda: ra_to_fine_text(here.ra_deg, 2),
            "GD": lambda: degrees_to_fine_text(here.dec_deg, 1, separator=b":"),
            "Gr": lambda: ra_to_fine_text(self.target_ra_deg, 2),
            "Gd": lambda: degrees_to_fine_text(self.target_dec_deg, 1, separator=b":"),
            "Gt": lambda: degrees_to_fine_text(site.latitude_deg, 1, separator=b":"),
            "Gg": lambda: degrees_to_fine_text(-site.longitude_deg, 1, separator=b":", digits=3),
            "GC": lambda: settings.local.strftime("%Y-%m-%d").encode(),
            "GL": lambda: settings.local.strftime("%H:%M:%S.%f")[:-4].encode(),
            "GUDT": lambda: self._utc().strftime("%Y-%m-%d,%H:%M:%S.%f")[:-4].encode(),
            "GS": lambda: ra_to_fine_text(self._sidereal_deg(), 2),
            "GG": lambda: (settings.tell("GG") or b"").removesuffix(b"#") + b":00.0",
            "GJD": lambda: b"%.5f" % self._julian_date(),
            "GJD1": lambda: b"%.8f" % self._julian_date(),
            "GRTMP": lambda: self._temperature.removesuffix(b"#"),
            "GRPRS": lambda: self._pressure.removesuffix(b"#"),
        }
        if text == "GT":
            return _HZ.get(self.mechanics.rate, _HZ[TrackingRate.SIDEREAL])
        return values[text]() + b"#" if text in values else None

    def _pattern(self, text: str) -> bytes | None:
        pulse = re.fullmatch(r"Mg([nsew])(\d{1,4})", text)
        if pulse is not None:
            duration_s = int(pulse[2]) / 1000.0
            self.mechanics.pulse(cast("Direction", pulse[1]), _GUIDE_RATE_DEG_S, duration_s)
            return b""
        if re.fullmatch(r"M[nsew]", text):
            rate = min(self._move_rate * SIDEREAL_DEG_S, self.mechanics.slew_rate_deg_s)
            self.mechanics.move(cast("Direction", text[1]), rate)
            return b""
        if re.fullmatch(r"Q[nsew]", text):
            self.mechanics.stop_move(cast("Direction", text[1]))
            return b""
        if re.fullmatch(r"R[GCMS]\d?", text):
            self._move_rate = _MOVE_RATES[text[1]]
            return b""
        if text in _RATES:
            self.mechanics.rate = _RATES[text]
            return b""
        return None

    # -- state -----------------------------------------------------------------------------------

    def status(self) -> MountStatus:
        """What it does, as `:Gstat#` reports."""
        mechanics = self.mechanics
        if mechanics.parked:
            return MountStatus.PARKED
        if mechanics.slewing():
            if mechanics.parking:
                return MountStatus.PARKING
            return MountStatus.HOMING if mechanics.homing else MountStatus.SLEWING
        if mechanics.at_limit:
            return MountStatus.OUTSIDE_LIMITS
        if mechanics.tracking:
            return MountStatus.TRACKING
        return MountStatus.STOPPED if self.stopped else MountStatus.STATIONARY

    def _side(self) -> bytes:
        return _SIDES[self.mechanics.pier_side()]

    def _utc(self) -> datetime:
        return self.mechanics.believed_utc().astimezone(UTC)

    def _julian_date(self) -> float:
        return UNIX_ZERO_JD + self._utc().timestamp() / SECONDS_PER_DAY

    def _sidereal_deg(self) -> float:
        return sidereal_time_deg(self._utc(), self.mechanics.believed_site)

    def _info(self) -> bytes:
        mechanics = self.mechanics
        here = mechanics.reported()
        utc, site = self._utc(), mechanics.believed_site
        seen = icrs_to_observed(apparent_to_icrs(replace(here, utc=utc)), utc, site, _NO_AIR)
        ra_h = round(here.ra_deg / 15.0, 5) % 24.0
        return b"%08.5f,%+08.4f,%s,%08.4f,%+08.4f,%.8f,%d,%d#" % (
            ra_h,
            here.dec_deg,
            self._side(),
            seen.az_deg,
            seen.alt_deg,
            self._julian_date(),
            self.status(),
            mechanics.slewing(),
        )

    # -- orders ----------------------------------------------------------------------------------

    def _target(self) -> Apparent:
        return Apparent(self.target_ra_deg, self.target_dec_deg, utc_now())

    def _refusal(self) -> Refusal | None:
        target, mechanics = self._target(), self.mechanics
        if mechanics.machine.lowest_altitude_deg is None and mechanics.believed_altitude_deg(target) < 0.0:
            return Refusal.PARKED if mechanics.parked else Refusal.BELOW_HORIZON
        return mechanics.refusal(target)

    def _slew(self) -> bytes:
        refusal = self._refusal()
        if refusal is not None:
            return _REFUSED.get(refusal, _REFUSED[Refusal.OTHER])
        self.mechanics.slew(self._target())
        self.stopped = False
        return b"0"

    def _sync(self) -> bytes:
        return _MATCHED if self.mechanics.sync(self._target()) is None else _TOO_FAR

    def _destination(self) -> bytes:
        if self._refusal() is not None:
            return b"0"
        side = self.mechanics.destination_side(self._target())
        return {PierSide.WEST: b"2", PierSide.EAST: b"3"}.get(side, b"0")

    def _flip(self) -> bytes:
        mechanics = self.mechanics
        here, side = mechanics.reported(), mechanics.pier_side()
        other = PierSide.WEST if side is PierSide.EAST else PierSide.EAST
        if side is PierSide.UNKNOWN or mechanics.refusal(here, other) is not None:
            return b"0"
        mechanics.slew(here, other)
        return b"1"

    def _stop(self) -> bytes:
        self.mechanics.stop()
        return b""

    def _halt(self) -> bytes:
        self.mechanics.stop()
        self.mechanics.tracking = False
        self.stopped = True
        return b""

    def _track(self, on: bool) -> bytes:
        self.mechanics.tracking = on
        self.stopped = False
        return b""

    def _park(self) -> bytes:
        self.mechanics.park()
        return b""

    def _unpark(self) -> bytes:
        self.mechanics.unpark()
        return b""

    def _set_unattended_flip(self, on: bool) -> bytes:
        self.unattended_flip = on
        return b""

    def _set(self, text: str) -> bytes:
        wire = text.encode("latin-1")
        try:
            if text[:2] == "Sr":
                self.target_ra_deg = ra_from_text(wire[2:]).deg
            elif text[:2] == "Sd":
                self.target_dec_deg = dec_from_text(wire[2:]).deg
            elif text[:5] == "SRTMP":
                self._temperature = b"%+06.1f#" % float(wire[5:])
            elif text[:5] == "SRPRS":
                self._pressure = b"%06.1f#" % float(wire[5:])
            else:
                self.settings.take(text[:2], text[2:])
        except (Unreadable, ValueError):
            return b"0"
        return b"1"


TENMICRON_FAKE = FakeDialect(
    name="10micron",
    speaker=lambda fake: TenMicronSpeaker(fake.mechanics),
    classic_too=lambda text: False,
    matched=_MATCHED,
    denials={"MS": _REFUSED[Refusal.BELOW_HORIZON], "CM": _TOO_FAR},
)
