"""The other end of an iOptron cable: bytes in, bytes out, over mechanics that point wrong.

It speaks the v3 or the v2 set, as recorded between real INDI drivers and a mount [IOPTRON] and as the
documents have it [IOPTRON310, IOPTRON25]; what that doesn't know it answers with silence. Places are of date
(JNow). It does no I/O: `drivers.fakes.bench` puts it on a wire.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.family import Fakes
from drivers.ioptron.codec import greeting, v2, values
from drivers.ioptron.codec.frames import Order, order_from_text
from drivers.ioptron.codec.values import (
    Horizontal,
    MountClock,
    MountState,
    PierSide,
    Pointing,
    Status,
    TrackingRate,
)
from drivers.wire.command import Unreadable
from mountnav import devices
from mountnav.clock import utc_now
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.posture import axes_at
from mountnav.sky.chain import apparent_to_hour_angle, hour_angle_to_observed, observed_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, GeometricHourAngle, HourAngle, Observed, Site
from mountnav.sky.sphere import half_turn_deg

RATES = {
    devices.TrackingRate.SIDEREAL: TrackingRate.SIDEREAL,
    devices.TrackingRate.LUNAR: TrackingRate.LUNAR,
    devices.TrackingRate.SOLAR: TrackingRate.SOLAR,
    devices.TrackingRate.KING: TrackingRate.KING,
    devices.TrackingRate.CUSTOM: TrackingRate.CUSTOM,
}
_SIDES = {
    devices.PierSide.EAST: PierSide.EAST,
    devices.PierSide.WEST: PierSide.WEST,
    devices.PierSide.UNKNOWN: PierSide.UNKNOWN,
}
_FIRMWARE = b"210105210105#"
_HOURS_MS = 3_600_000
"""Milliseconds in an hour of right ascension."""


@dataclass(slots=True)
class Memory:
    """What the mount keeps beside its mechanics.

    Attributes
    ----------
    model : str
        Four digits.
    guide_rates, meridian, custom_rate : bytes
        As they stand on the wire.
    arrows : set of str
        Directions in which an arrow key is held.
    by_hand : bool
        Whether the motion that runs was begun by an arrow key.
    ordered : bool
        Whether it was ordered; the mount flips of itself.
    """

    model: str
    altitude_limit_deg: int
    park: Horizontal
    northern: bool
    target_ra_deg: float = 0.0
    target_dec_deg: float = 0.0
    arrow_speed: int = 9
    guide_rates: bytes = b"5050"
    meridian: bytes = b"100"
    custom_rate: bytes = b"10000"
    offset_min: int = 0
    summer_time: bool = False
    time_source: int = 2
    arrows: set[devices.Direction] = field(default_factory=set)
    by_hand: bool = False
    ordered: bool = False

    def switched_off(self) -> None:
        """Forget what doesn't outlive a power cut [IOPTRON310 :SRn :RTn]."""
        self.arrow_speed = 5
        self.target_ra_deg = self.target_dec_deg = 0.0
        self.arrows.clear()
        self.by_hand = self.ordered = False


class FakeReports:
    """Answers questions."""

    def __init__(self, mechanics: Mechanics, memory: Memory, dialect: str) -> None:
        self._mechanics = mechanics
        self._memory = memory
        both: dict[str, Callable[[], bytes]] = {
            "MountInfo": lambda: memory.model.encode("ascii"),
            "FW1": lambda: _FIRMWARE,
            "FW2": lambda: _FIRMWARE,
            "AG": lambda: memory.guide_rates + b"#",
            "GMT": lambda: memory.meridian + b"#",
            "GAC": lambda: values.horizontal_to_text(self.horizontal()) + b"#",
            "GPC": lambda: values.park_place_to_text(memory.park) + b"#",
            "GAL": lambda: values.altitude_limit_to_text(memory.altitude_limit_deg) + b"#",
            "GSR": lambda: b"9#",
            # no periodic error is recorded
            "GPE": lambda: b"0",
        }
        own: dict[str, Callable[[], bytes]]
        if dialect == "v3":
            own = {
                "GLS": lambda: values.status_to_text(self.status()) + b"#",
                "GEP": lambda: values.pointing_to_text(self.pointing()) + b"#",
                "GUT": lambda: values.clock_to_text(self.clock()) + b"#",
                "GTR": lambda: self._custom_rate() + b"#",
                "QAP": lambda: b"%d#" % self.postures(),
            }
        else:
            own = {
                "V": lambda: b"V1.00#",
                "GLS": lambda: v2.status_to_text(self.status()) + b"#",
                "GAS": lambda: v2.flags_to_text(self.status()) + b"#",
                "Gg": lambda: v2.signed_arcsec(self.status().longitude_deg) + b"#",
                "Gt": lambda: v2.signed_arcsec(self.status().latitude_deg) + b"#",
                "GEC": lambda: v2.pointing_to_text(self.pointing()) + b"#",
                "GEA": lambda: self._axes() + b"#",
                "GLT": lambda: v2.clock_to_text(self.clock()) + b"#",
            }
        self._answers = both | own

    def told(self, name: str) -> bytes | None:
        """Answer a question; None for what is none."""
        answer = self._answers.get(name)
        return None if answer is None else answer()

    def status(self) -> Status:
        """Site and state."""
        site, memory = self._mechanics.believed_site, self._memory
        return Status(
            half_turn_deg(site.longitude_deg),
            site.latitude_deg,
            2,
            self.state(),
            RATES[self._mechanics.rate],
            memory.arrow_speed,
            memory.time_source,
            memory.northern,
        )

    def state(self) -> MountState:
        """What it is doing."""
        mechanics, memory = self._mechanics, self._memory
        if mechanics.parked:
            return MountState.PARKED
        if mechanics.guiding():
            return MountState.GUIDING
        if not mechanics.slewing():
            memory.by_hand = memory.ordered = False
        elif not memory.by_hand:
            return MountState.SLEWING if memory.ordered else MountState.FLIPPING
        if mechanics.tracking:
            return MountState.TRACKING
        return MountState.HOME if mechanics.at_home else MountState.STOPPED

    def _custom_rate(self) -> bytes:
        # a fault may have dropped what was ordered
        custom = self._mechanics.rate is devices.TrackingRate.CUSTOM
        dropped = custom and self._mechanics.beside_arcsec_s == (0.0, 0.0)
        return b"10000" if dropped else self._memory.custom_rate

    def pointing(self) -> Pointing:
        """Where it believes to point, and from which side."""
        place = self._mechanics.reported()
        side = self._mechanics.pier_side()
        return Pointing(place.ra_deg, place.dec_deg, _SIDES[side], self._counterweight_up(side))

    def _counterweight_up(self, side: devices.PierSide) -> bool:
        if side is devices.PierSide.UNKNOWN:
            return False
        # looking west from the east side, or east from the west side, it hangs down
        west = self._hour_angle().ha_deg > 0.0
        return west is not (side is devices.PierSide.EAST)

    def _hour_angle(self) -> GeometricHourAngle:
        mechanics = self._mechanics
        place = replace(mechanics.reported(), utc=mechanics.believed_utc())
        return apparent_to_hour_angle(place, mechanics.believed_site)

    def horizontal(self) -> Horizontal:
        """Altitude and azimuth as it computes them."""
        angle = self._hour_angle()
        seen = hour_angle_to_observed(
            HourAngle(angle.ha_deg, angle.dec_deg, angle.utc), self._mechanics.believed_site
        )
        return Horizontal(seen.alt_deg, seen.az_deg)

    def over_the_ground(self, place: Horizontal) -> tuple[float, float]:
        """Hour angle and declination (deg) of an altitude and azimuth."""
        seen = Observed(place.az_deg, place.alt_deg, self._mechanics.believed_utc())
        angle = observed_to_hour_angle(seen, self._mechanics.believed_site)
        return angle.ha_deg, angle.dec_deg

    def clock(self) -> MountClock:
        """Its clock."""
        return MountClock(self._mechanics.believed_utc(), self._memory.offset_min, self._memory.summer_time)

    def postures(self) -> int:
        """In how many postures it reaches the target."""
        target = replace(
            self._mechanics.reported(), ra_deg=self._memory.target_ra_deg, dec_deg=self._memory.target_dec_deg
        )
        if self._mechanics.believed_altitude_deg(target) < self._memory.altitude_limit_deg:
            return 0
        sides = (devices.PierSide.EAST, devices.PierSide.WEST)
        return sum(self._mechanics.refusal(target, side) is None for side in sides)

    def _axes(self) -> bytes:
        """`:GEA#` as INDI takes it: pole distance, its sign the side; hour axis, 12 h at home, in ms."""
        angle, west = self._hour_angle(), self._mechanics.pier_side() is devices.PierSide.WEST
        pole_deg = 90.0 - math.copysign(1.0, self._mechanics.site.latitude_deg) * angle.dec_deg
        hours = (18.0 - angle.ha_deg / 15.0 if west else angle.ha_deg / 15.0 + 6.0) % 24.0
        return values.signed_angle(pole_deg if west else -pole_deg) + b"%08d" % int(hours * _HOURS_MS)


_LONGEST_COMMAND = 40
"""Bytes without a `#` that are kept for a command still to come; the longest command has less."""
# the last one is the greatest that the model has [IOPTRON310 :SRn]
_ARROW_RATES = (1.0, 2.0, 8.0, 16.0, 64.0, 128.0, 256.0, 512.0, math.inf)
_ARROWS: dict[str, dict[str, devices.Direction]] = {
    # `:mn#` Dec-, `:ms#` Dec+, `:me#` RA-, `:mw#` RA+ [IOPTRON310]; INDI has north for `:mn#`
    "v3": {
        "mn": devices.Direction.SOUTH,
        "ms": devices.Direction.NORTH,
        "me": devices.Direction.WEST,
        "mw": devices.Direction.EAST,
    },
    # [IOPTRON25], and east and west as INDI found them
    "v2": {
        "mn": devices.Direction.NORTH,
        "ms": devices.Direction.SOUTH,
        "me": devices.Direction.WEST,
        "mw": devices.Direction.EAST,
    },
}
_PULSES = {
    "ZE": devices.Direction.NORTH,
    "ZC": devices.Direction.SOUTH,
    "ZS": devices.Direction.EAST,
    "ZQ": devices.Direction.WEST,
    "Mn": devices.Direction.NORTH,
    "Ms": devices.Direction.SOUTH,
    "Me": devices.Direction.EAST,
    "Mw": devices.Direction.WEST,
}
_RATES = {wire: rate for rate, wire in RATES.items()}
_MODELS = {"v3": "0043", "v2": "0060"}
_AT_POLE_DEG = 0.01
"""A park position so near to the pole is the home position: the side of the pier means nothing there.
Chosen by hand."""


class FakeIoptron(WireFake):
    """An iOptron mount on the wire.

    Parameters
    ----------
    mechanics : Mechanics
        What moves, and what it believes of itself.
    dialect : {"v3", "v2"}
        Its command set.
    model : str, optional
        Four digits; a GEM45 with v3, a CEM60 with v2 if not given.
    altitude_limit_deg : int, optional
        Targets below are refused; the machine's lowest altitude if not given, or the horizon.
    faults : iterable of Fault
        What goes wrong; may be changed while it runs.
    clock : callable
        Aware UTC.
    monotonic : callable
        Seconds, for late answers.
    """

    IDENTITY = (b":MountInfo#", b":FW1#", b":FW2#", b":V#")

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        dialect: str = "v3",
        model: str | None = None,
        altitude_limit_deg: int | None = None,
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(mechanics, faults=faults, clock=clock, monotonic=monotonic)
        if altitude_limit_deg is None:
            altitude_limit_deg = round(mechanics.machine.lowest_altitude_deg or 0.0)
        latitude_deg = mechanics.site.latitude_deg
        self._dialect = dialect
        self._memory = Memory(
            model=model or _MODELS[dialect],
            altitude_limit_deg=altitude_limit_deg,
            park=Horizontal(abs(latitude_deg), 0.0 if latitude_deg >= 0.0 else 180.0),
            northern=latitude_deg >= 0.0,
        )
        self._teller = FakeReports(mechanics, self._memory, dialect)
        self._model = greeting.model(self._memory.model, dialect)

    def status(self) -> Status:
        """What it reports of itself now: site and state."""
        return self._teller.status()

    # -- the wire --------------------------------------------------------------------------------

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        """Cut off a command, from the last colon before a `#`; what comes before is nothing."""
        while (end := buffer.find(b"#")) >= 0:
            start = buffer.rfind(b":", 0, end)
            if start >= 0:
                return buffer[start : end + 1], buffer[end + 1 :]
            buffer = buffer[end + 1 :]
        return None, buffer[-_LONGEST_COMMAND:]

    def carry_out(self, command: bytes) -> bytes | None:
        """Do it and answer; None for what this set doesn't have."""
        order = order_from_text(command, self._dialect)
        if order is None or (order.name == "MSH" and not self._model.searches_home):
            return None
        told = self._teller.told(order.name)
        if told is not None:
            return told
        if order.name in _ARROWS[self._dialect]:
            self._hold(_ARROWS[self._dialect][order.name])
            return b""
        if order.name in _PULSES:
            self._pulse(_PULSES[order.name], int(order.text) / 1000.0)
            return b""
        try:
            done = self._set(order) if order.text else self._move(order.name)
        except (Unreadable, ValueError):
            done = False
        return b"1" if done else b"0"

    def deaf_reply(self, command: bytes) -> bytes:
        """Answer orders with yes, and questions truly."""
        order = order_from_text(command, self._dialect)
        if order is None or order.name in _PULSES or order.name in _ARROWS[self._dialect]:
            return b""
        return self._teller.told(order.name) or b"1"

    def denial(self, command: bytes) -> bytes | None:
        """Orders that it answers at all it denies by 0."""
        order = order_from_text(command, self._dialect)
        told = order is not None and self._teller.told(order.name) is not None
        return None if told or self.deaf_reply(command) != b"1" else b"0"

    def reboot(self) -> None:
        """Forget target and speeds; a parked mount is unparked by it [IOPTRON310 :MP1#]."""
        super().reboot()
        self._memory.switched_off()
        self.mechanics.unpark()

    # -- motion ----------------------------------------------------------------------------------

    def _hold(self, direction: devices.Direction) -> None:
        self._memory.arrows.add(direction)
        self._memory.by_hand = True
        rate_deg_s = min(
            _ARROW_RATES[self._memory.arrow_speed - 1] * SIDEREAL_DEG_S, self.mechanics.slew_rate_deg_s
        )
        self.mechanics.move(direction.value, rate_deg_s)

    def _release(self, directions: set[devices.Direction]) -> None:
        for direction in self._memory.arrows & directions:
            self.mechanics.stop_move(direction.value)
            self._memory.arrows.discard(direction)

    def _pulse(self, direction: devices.Direction, duration_s: float) -> None:
        ra, dec = values.guide_rates_from_text(self._memory.guide_rates)
        rate = dec if direction in (devices.Direction.NORTH, devices.Direction.SOUTH) else ra
        if not self._memory.arrows:
            self.mechanics.pulse(direction.value, rate * SIDEREAL_DEG_S, duration_s)

    def _move(self, name: str) -> bool:
        polar, other = (
            {devices.Direction.EAST, devices.Direction.WEST},
            {devices.Direction.NORTH, devices.Direction.SOUTH},
        )
        if name in ("MS", "MS1", "MS2"):
            return self._slew(counterweight_up=name == "MS2")
        if name == "CM":
            # ignored while it slews [IOPTRON310 :CM#]
            return self.mechanics.slewing() or self.mechanics.sync(self._target()) is None
        if name == "Q":
            self._stop()
        elif name in ("qR", "qD", "q"):
            self._release({"qR": polar, "qD": other}.get(name, polar | other))
        elif name == "MP1":
            self._set_out()
            self.mechanics.park()
        elif name == "MP0":
            self.mechanics.unpark()
        elif name in ("MH", "MSH"):
            self._set_out()
            return self.mechanics.home() is None
        return True

    def _slew(self, *, counterweight_up: bool) -> bool:
        target = self._target()
        if self.mechanics.believed_altitude_deg(target) < self._memory.altitude_limit_deg:
            return False
        side = self.mechanics.destination_side(target)
        if counterweight_up:
            side = side.other
        asked = None if side is devices.PierSide.UNKNOWN else side
        if self.mechanics.refusal(target, asked) is not None:
            return False
        self._set_out()
        return self.mechanics.slew(target, asked) is None

    def _set_out(self) -> None:
        self._memory.arrows.clear()
        self._memory.by_hand, self._memory.ordered = False, True

    def _stop(self) -> None:
        """End all slewing; with the v2 set what the arrow keys began goes on [IOPTRON310, IOPTRON25 :Q#]."""
        if self._dialect == "v3" or not self._memory.arrows:
            self._memory.arrows.clear()
            self.mechanics.stop()

    def _target(self) -> Apparent:
        return Apparent(self._memory.target_ra_deg, self._memory.target_dec_deg, self._clock())

    # -- settings --------------------------------------------------------------------------------

    def _set(self, order: Order) -> bool:
        """Take a value; raises `Unreadable` or `ValueError` where it makes no sense."""
        name, text, memory = order.name, order.text, self._memory
        match name:
            case "SRA":
                memory.target_ra_deg = values.angle_from_text(text, 0, 360, "right ascension")
            case "Sr":
                memory.target_ra_deg = v2.ra_from_text(text)
            case "Sd":
                memory.target_dec_deg = values.angle_from_text(text, -90, 90, "declination")
            case "SPA" | "SPH":
                self._set_park(name, text)
            case "SLO" | "SLA" | "Sg" | "St":
                self._set_site(name, text)
            case "SUT" | "SC" | "SL":
                self._set_clock(name, text)
            case "SG":
                memory.offset_min = values.offset_from_text(text)
            case "SDS":
                memory.summer_time = text == b"1"
            case "SHE":
                memory.northern = text == b"1"
            case "ST":
                return self._track(text == b"1")
            case "RT" | "RR":
                return self._set_rate(name, text)
            case "RG":
                memory.guide_rates = text
            case "SR":
                memory.arrow_speed = int(text)
            case "SMT":
                values.meridian_from_text(text)
                memory.meridian = text
            case "SAL":
                memory.altitude_limit_deg = values.altitude_limit_from_text(text)
        return True

    def _set_park(self, name: str, text: bytes) -> None:
        park, mechanics = self._memory.park, self.mechanics
        if name == "SPA":
            park = Horizontal(park.alt_deg, values.angle_from_text(text, 0, 360, "azimuth"))
        else:
            park = Horizontal(values.angle_from_text(text, 0, 90, "altitude"), park.az_deg)
        self._memory.park = park
        ha_deg, dec_deg = self._teller.over_the_ground(park)
        latitude_deg = mechanics.site.latitude_deg
        axes = mechanics.machine.home_at(latitude_deg)
        if abs(dec_deg) < 90.0 - _AT_POLE_DEG:
            side = devices.PierSide.EAST if ha_deg >= 0.0 else devices.PierSide.WEST
            axes = axes_at(ha_deg, dec_deg, mechanics.machine, side, latitude_deg)
        mechanics.set_park(axes)

    def _set_site(self, name: str, text: bytes) -> None:
        site = self.mechanics.believed_site
        if name in ("SLO", "Sg"):
            deg = (
                values.angle_from_text(text, -180, 180, "longitude")
                if name == "SLO"
                else v2.arcsec_from_text(text, 180, "longitude")
            )
            site = Site(site.latitude_deg, deg, site.height_m)
        else:
            deg = (
                values.angle_from_text(text, -90, 90, "latitude")
                if name == "SLA"
                else v2.arcsec_from_text(text, 90, "latitude")
            )
            site = Site(deg, site.longitude_deg, site.height_m)
        self.mechanics.set_believed_site(site)

    def _set_clock(self, name: str, text: bytes) -> None:
        if name == "SUT":
            utc = values.time_from_text(text)
        else:
            memory = self._memory
            ahead = timedelta(minutes=memory.offset_min + 60 * memory.summer_time)
            local = (self.mechanics.believed_utc() + ahead).replace(microsecond=0)
            words = local.strftime("%y%m%d%H%M%S").encode("ascii")
            words = text + words[6:] if name == "SC" else words[:6] + text
            told = datetime.strptime(words.decode("ascii"), "%y%m%d%H%M%S")
            utc = told.replace(tzinfo=local.tzinfo) - ahead
        self.mechanics.set_believed_utc(utc)
        self._memory.time_source = 1

    def _track(self, on: bool) -> bool:
        if on and self.mechanics.parked:
            return False
        self.mechanics.tracking = on
        return True

    def _set_rate(self, name: str, text: bytes) -> bool:
        if name == "RR":
            if not 1_000 <= int(text) <= 19_000:
                return False
            self._memory.custom_rate = text
        rate = _RATES[values.TrackingRate(int(text))] if name == "RT" else self.mechanics.rate
        if rate is devices.TrackingRate.CUSTOM:
            self.mechanics.track_at(int(self._memory.custom_rate) / 10_000.0 * SIDEREAL_DEG_S)
        elif name == "RT":
            self.mechanics.rate = rate
        return True


MACHINE = Machine(
    mounting="german",
    slew_rate_deg_s=4.0,
    acceleration_deg_s2=2.0,
    meridian_limits_deg=(10.0, 10.0),
    lowest_altitude_deg=0.0,
    home_sensor=True,
    starts_at="home",
    tracks_at_start=False,
)
"""A GEM45: after power-up it takes the place where it stands for its home, and doesn't track."""


def make_fake(
    dialect: str,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime] = utc_now,
    monotonic: Callable[[], float] = time.monotonic,
) -> FakeIoptron:
    """Make a fake of a command set of `FAKES`."""
    return FakeIoptron(mechanics, dialect=dialect, faults=faults, clock=clock, monotonic=monotonic)


FAKES = Fakes(
    dialects=("v3", "v2"),
    make=make_fake,
    moves=(b":MS", b":CM", b":MP1", b":MH", b":MSH"),
    stops=(b":Q#",),
    machine=MACHINE,
)
