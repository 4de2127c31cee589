"""What a fake iOptron mount tells of itself: site, state, place and clock, in the words of either set."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from drivers.ioptron import values, values_v2
from drivers.ioptron.values import (
    Horizontal,
    MountClock,
    MountState,
    PierSide,
    Pointing,
    Status,
    TrackingRate,
)
from mountnav import devices
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import apparent_to_hour_angle, hour_angle_to_observed, observed_to_hour_angle
from mountnav.sky.coordinates import GeometricHourAngle, HourAngle, Observed
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


@dataclass(slots=True)
class Memory:
    """What the mount keeps beside its mechanics.

    Attributes
    ----------
    model : str
        Four digits.
    altitude_limit_deg : int
    target_ra_deg, target_dec_deg : float
    park : Horizontal
    arrow_speed : int
    guide_rates, meridian, custom_rate : bytes
        As they stand on the wire.
    offset_min : int
    summer_time : bool
    northern : bool
    time_source : int
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


class Teller:
    """Answers questions.

    Parameters
    ----------
    mechanics : Mechanics
    memory : Memory
    dialect : {"v3", "v2"}
    """

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
                "GTR": lambda: memory.custom_rate + b"#",
                "QAP": lambda: b"%d#" % self.postures(),
            }
        else:
            own = {
                "V": lambda: b"V1.00#",
                "GLS": lambda: values_v2.status_to_text(self.status()) + b"#",
                "GAS": lambda: values_v2.flags_to_text(self.status()) + b"#",
                "Gg": lambda: values_v2.signed_arcsec(self.status().longitude_deg) + b"#",
                "Gt": lambda: values_v2.signed_arcsec(self.status().latitude_deg) + b"#",
                "GEC": lambda: values_v2.pointing_to_text(self.pointing()) + b"#",
                "GEA": lambda: self._axes() + b"#",
                "GLT": lambda: values_v2.clock_to_text(self.clock()) + b"#",
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
        """Altitude and azimuth as it reckons them."""
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
