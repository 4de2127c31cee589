"""What a hand control is, and what it can do for its maker, version and mount: values and tables only."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

STARSENSE = 0x13
"""What a StarSense hand control answers to `v` [NexStar v]."""


class Tracking(IntEnum):
    """How a mount follows the sky [NexStar t]. A SynScan says 2 in both hemispheres, 3 for its PEC mode."""

    OFF = 0
    ALTAZ = 1
    EQUATORIAL_NORTH = 2
    EQUATORIAL_SOUTH = 3
    EQUATORIAL = 4
    """Only some Celestron ones know this [INDI CTM_RADEC]."""


@dataclass(frozen=True, slots=True, order=True)
class Version:
    """A firmware version, comparable: 4.21 is (4, 21). SynScan's third part is `build`."""

    major: int
    minor: int
    build: int = 0
    synscan: bool = field(default=False, compare=False)
    """Told in six hex digits, as SynScan does [NexStar V]."""

    def __str__(self) -> str:
        text = f"{self.major}.{self.minor:02d}"
        return f"{text}.{self.build:02d}" if self.synscan else text


# [INDI celestrondriver, get_model]
_CELESTRON = {
    1: "GPS",
    3: "i-Series",
    4: "i-Series SE",
    5: "CGE",
    6: "Advanced GT",
    7: "SLT",
    9: "CPC",
    10: "GT",
    11: "4/5 SE",
    12: "6/8 SE",
    13: "CGE Pro",
    14: "CGEM",
    15: "LCM",
    16: "Sky Prodigy",
    17: "CPC Deluxe",
    18: "GT 16",
    19: "StarSeeker",
    20: "Advanced VX",
    21: "Cosmos",
    22: "Evolution",
    23: "CGX",
    24: "CGX-L",
    25: "Astro Fi",
}
_CELESTRON_GERMAN = frozenset({5, 6, 13, 14, 20, 23, 24})
"""Celestron's model numbers of German mounts [NexStar m]."""
# [INDI synscandriver, readModel]
_SYNSCAN = {
    0: "EQ6",
    1: "HEQ5",
    2: "EQ5",
    3: "EQ3",
    4: "EQ8",
    5: "AZ-EQ6",
    6: "AZ-EQ5",
    160: "AllView",
    165: "AZ-GTi",
}
_SYNSCAN_ALTAZ_FROM = 128
"""SynScan's model numbers from here on are altazimuth mounts [NexStar m]."""


@dataclass(frozen=True, slots=True)
class Handset:
    """Who answered.

    Attributes
    ----------
    variant : int or None
        ``0x11`` NexStar, ``0x13`` StarSense; None where it was not asked.
    model : int or None
        The mount's number, None where it can't be asked.
    motors : Version or None
        The older firmware of the two motor boards, None where it was not asked.
    """

    version: Version
    variant: int | None = None
    model: int | None = None
    motors: Version | None = None

    @property
    def synscan(self) -> bool:
        """Made by Sky-Watcher."""
        return self.version.synscan

    @property
    def starsense(self) -> bool:
        """A StarSense: its versions begin again at 1.0, with all that a NexStar 5 has but for a few words."""
        return self.variant == STARSENSE

    @property
    def text(self) -> str:
        """In words."""
        kind = "SynScan" if self.synscan else "StarSense" if self.starsense else "NexStar"
        names = _SYNSCAN if self.synscan else _CELESTRON
        if self.model is None:
            return f"{kind} hand control {self.version}"
        return f"{kind} hand control {self.version}, {names.get(self.model, f'mount number {self.model}')}"

    @property
    def german(self) -> bool:
        """Whether the mount has two sides of a pier. AZ-EQ mounts count as such: they may be."""
        if self.model is None:
            return False
        if self.synscan:
            return self.model < _SYNSCAN_ALTAZ_FROM
        return self.model in _CELESTRON_GERMAN

    def _since(self, major: int, minor: int) -> bool:
        """Whether a Celestron is that new; a StarSense always is, a SynScan is older than none of these."""
        return self.synscan or self.starsense or self.version >= Version(major, minor)

    @property
    def knows_sync(self) -> bool:
        """4.10 [Celestron, communication protocol]; x.37 of SynScan [libnexstar]."""
        return self.version.minor >= 37 if self.synscan else self._since(4, 10)

    @property
    def short_places(self) -> bool:
        """Whether places come in four digits only: before 1.6 [Celestron's manuals]."""
        return not self._since(1, 6)

    @property
    def tells_model(self) -> bool:
        """2.2 [Celestron, communication protocol]."""
        return self._since(2, 2)

    @property
    def tells_tracking(self) -> bool:
        """2.3 [Celestron, communication protocol]."""
        return self._since(2, 3)

    @property
    def keeps_time(self) -> bool:
        """Clock and site: 2.3 [Celestron, communication protocol]."""
        return self._since(2, 3)

    @property
    def quarter_zones(self) -> bool:
        """The words `i` and `I`: 5.28, no StarSense [INDI celestrongps]."""
        return not self.synscan and not self.starsense and self.version >= Version(5, 28)

    @property
    def tells_pier_side(self) -> bool:
        """4.15 with a German mount [INDI celestrongps]; x.37 of SynScan [libnexstar]."""
        return self.german and (self.version.minor >= 37 if self.synscan else self._since(4, 15))

    @property
    def mirrors_pier_side(self) -> bool:
        """Whether it reports the wrong side in the south: up to 5.24, no StarSense [INDI celestrongps]."""
        return not self.synscan and not self.starsense and self.version <= Version(5, 24)

    @property
    def times_pulses(self) -> bool:
        """Whether its motors time guide pulses: their firmware from 6.12 on [INDI celestrongps]."""
        return not self.synscan and self.motors is not None and self.motors >= Version(6, 12)

    @property
    def has_rates(self) -> bool:
        """Whether its motors take solar and lunar rates by themselves; only Celestron's were seen to."""
        return not self.synscan and self.german

    @property
    def shifted_modes(self) -> bool:
        """CGE and Advanced GT 3.01 to 3.04: 1 is EQ north, 2 EQ south [Celestron, communication protocol]."""
        return self.model in (5, 6) and Version(3, 1) <= self.version <= Version(3, 4)

    def mode(self, number: int) -> Tracking:
        """What a number of `t` means here. Raises ValueError where it means nothing."""
        if self.synscan:
            return (Tracking.OFF, Tracking.ALTAZ, Tracking.EQUATORIAL, Tracking.EQUATORIAL)[number]
        if self.shifted_modes and number in (1, 2):
            return Tracking(number + 1)
        return Tracking(number)

    def number(self, mode: Tracking) -> int:
        """How to say a mode here, for `T`."""
        if self.synscan:
            return min(mode, Tracking.EQUATORIAL_NORTH)
        if self.shifted_modes and mode in (Tracking.EQUATORIAL_NORTH, Tracking.EQUATORIAL_SOUTH):
            return mode - 1
        return mode

    def usual_mode(self, latitude_deg: float) -> Tracking:
        """What to track with where no mode was seen: equatorial on its hemisphere, or alt-azimuth."""
        if not self.german:
            return Tracking.ALTAZ
        if self.synscan:
            return Tracking.EQUATORIAL
        return Tracking.EQUATORIAL_NORTH if latitude_deg >= 0.0 else Tracking.EQUATORIAL_SOUTH
