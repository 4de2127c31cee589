"""The other end of an iOptron cable: bytes in, bytes out, over mechanics that point wrong.

It speaks the v3 or the v2 set, as recorded between real INDI drivers and a mount [IOPTRON] and as the
documents have it [IOPTRON310, IOPTRON25]; what that doesn't know it answers with silence. Places are of date
(JNow). It does no I/O: `drivers.fakes.bench` puts it on a wire.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.ioptron import models, values, values_v2
from drivers.ioptron.fake_told import RATES, Memory, Teller
from drivers.ioptron.orders import Order, order_from_text
from drivers.ioptron.values import Horizontal, Status
from drivers.wire.command import Unreadable
from mountnav.devices import Direction, PierSide, TrackingRate
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.posture import axes_at, other_side
from mountnav.sky.coordinates import Apparent, Site, utc_now
from mountnav.sky.turning import SIDEREAL_DEG_S

_LONGEST_COMMAND = 40
# the last one is the greatest that the model has [IOPTRON310 :SRn]
_ARROW_RATES = (1.0, 2.0, 8.0, 16.0, 64.0, 128.0, 256.0, 512.0, math.inf)
_ARROWS: dict[str, dict[str, Direction]] = {
    # `:mn#` Dec-, `:ms#` Dec+, `:me#` RA-, `:mw#` RA+ [IOPTRON310]; INDI has north for `:mn#`
    "v3": {"mn": Direction.SOUTH, "ms": Direction.NORTH, "me": Direction.WEST, "mw": Direction.EAST},
    # [IOPTRON25], and east and west as INDI found them
    "v2": {"mn": Direction.NORTH, "ms": Direction.SOUTH, "me": Direction.WEST, "mw": Direction.EAST},
}
_PULSES = {
    "ZE": Direction.NORTH,
    "ZC": Direction.SOUTH,
    "ZS": Direction.EAST,
    "ZQ": Direction.WEST,
    "Mn": Direction.NORTH,
    "Ms": Direction.SOUTH,
    "Me": Direction.EAST,
    "Mw": Direction.WEST,
}
_RATES = {wire: rate for rate, wire in RATES.items()}
_MODELS = {"v3": "0043", "v2": "0060"}
_AT_POLE_DEG = 0.01


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
        self._teller = Teller(mechanics, self._memory, dialect)
        self._model = models.model(self._memory.model, dialect)

    def status(self) -> Status:
        """What it tells of itself now: site and state."""
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

    def _hold(self, direction: Direction) -> None:
        self._memory.arrows.add(direction)
        self._memory.by_hand = True
        rate_deg_s = min(
            _ARROW_RATES[self._memory.arrow_speed - 1] * SIDEREAL_DEG_S, self.mechanics.slew_rate_deg_s
        )
        self.mechanics.move(direction.value, rate_deg_s)

    def _release(self, directions: set[Direction]) -> None:
        for direction in self._memory.arrows & directions:
            self.mechanics.stop_move(direction.value)
            self._memory.arrows.discard(direction)

    def _pulse(self, direction: Direction, duration_s: float) -> None:
        ra, dec = values.guide_rates_from_text(self._memory.guide_rates)
        rate = dec if direction in (Direction.NORTH, Direction.SOUTH) else ra
        if not self._memory.arrows:
            self.mechanics.pulse(direction.value, rate * SIDEREAL_DEG_S, duration_s)

    def _move(self, name: str) -> bool:
        polar, other = {Direction.EAST, Direction.WEST}, {Direction.NORTH, Direction.SOUTH}
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
            side = other_side(side)
        asked = None if side is PierSide.UNKNOWN else side
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
                memory.target_ra_deg = values_v2.ra_from_text(text)
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
            side = PierSide.EAST if ha_deg >= 0.0 else PierSide.WEST
            axes = axes_at(ha_deg, dec_deg, mechanics.machine, side, latitude_deg)
        mechanics.set_park(axes)

    def _set_site(self, name: str, text: bytes) -> None:
        site = self.mechanics.believed_site
        if name in ("SLO", "Sg"):
            deg = (
                values.angle_from_text(text, -180, 180, "longitude")
                if name == "SLO"
                else values_v2.arcsec_from_text(text, 180, "longitude")
            )
            site = Site(site.latitude_deg, deg, site.height_m)
        else:
            deg = (
                values.angle_from_text(text, -90, 90, "latitude")
                if name == "SLA"
                else values_v2.arcsec_from_text(text, 90, "latitude")
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
        if rate is TrackingRate.CUSTOM:
            self.mechanics.track_at(int(self._memory.custom_rate) / 10_000.0 * SIDEREAL_DEG_S)
        elif name == "RT":
            self.mechanics.rate = rate
        return True
