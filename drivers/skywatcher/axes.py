"""From the sky to the counts of a German mount's two axes and back, at our site by our clock; no I/O.

A motor makes one step every `period` ticks of the board's timer, in the high speed range as many more as its
ratio says [SKYWATCHER :I :g]: rate = timer · 360° / (counts per turn · period). Gotos don't obey the period;
the board ramps them by itself (measured by an owner of an HEQ5: 3.5°/s, 2.2°/s²).

The axes are counted as *turns*, in degrees, as EQMod counts them [INDI eqmod]: the first is 0 with the
counterweight down and grows towards forward counts, the second is 90 with the tube along the polar axis.
Below 90 the tube hangs on one side of the pier, above 90 on the other. In the north the first axis runs
forward with the sky, in the south backward. Home is (0, 90) everywhere.

The controller has no sync. The difference between where the counts say the axes stand and where the sky says
they do is kept here, per side, because the errors of a German mount change over with the side. A side without
a sync of its own takes that of the other one: most of it is where the counting began.

A board that was just switched on counts both axes from 0x800000 wherever they stand; they are taken to stand
at home, the tube along the polar axis and the counterweight down. When we energize the motors the second axis
is set a quarter of a turn on, as EQMod does: from then on 0x800000 is the declination axis on the equator for
every program that reads the counts, for us after a restart too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime

from drivers.skywatcher.codec import LARGEST, POSITION_ZERO, Axis, Board
from mountnav.devices import TRACKING_DEG_S, PierSide, TrackingRate
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
)
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Site
from mountnav.sky.sphere import half_turn_deg

RATES_DEG_S = {
    rate: TRACKING_DEG_S[rate] for rate in (TrackingRate.SIDEREAL, TrackingRate.LUNAR, TrackingRate.SOLAR)
}
"""How fast the first axis follows, by the rates that its hand control has."""
_HEQ5_SLOW_TIMER = (Board(1, 6, 1), 64935, 64640)
"""Board, the timer frequency that it reports, and the true one [INDI eqmod]."""


@dataclass(frozen=True, slots=True)
class Gearing:
    """What one motor's numbers are.

    Attributes
    ----------
    counts : int
        Per turn of the axis.
    timer_hz : int
        Ticks per second.
    ratio : int
        Steps at once in the high speed range.
    """

    counts: int
    timer_hz: int
    ratio: int

    @property
    def step_arcsec(self) -> float:
        """One count."""
        return 1_296_000.0 / self.counts

    def period(self, rate_deg_s: float) -> int:
        """Step period for a rate (deg/s, > 0) in the low speed range."""
        return min(max(1, round(self.timer_hz * 360.0 / (self.counts * rate_deg_s))), LARGEST)

    def rate_step_deg_s(self, rate_deg_s: float) -> float:
        """By how much a rate changes with one tick of its step period, in the low speed range.

        Between rest and the slowest rate there is none.
        """
        slowest_deg_s = self.rate_deg_s(LARGEST)
        if rate_deg_s <= slowest_deg_s:
            return slowest_deg_s
        return rate_deg_s / self.period(rate_deg_s)

    def rate_deg_s(self, period: int, *, fast: bool = False) -> float:
        """Rate that a step period gives."""
        return self.timer_hz * 360.0 / (self.counts * max(period, 1)) * (self.ratio if fast else 1)

    def turn_deg(self, counts: float) -> float:
        """Angle of some counts."""
        return counts * 360.0 / self.counts

    def counts_of(self, turn_deg: float) -> int:
        """Whole counts of an angle."""
        return round(turn_deg * self.counts / 360.0)


def true_timer_hz(board: Board, told_hz: int) -> int:
    """Put right what one firmware reports wrong: the HEQ5 of 1.06 drifts 4″ a minute by it [INDI eqmod]."""
    known, told, true = _HEQ5_SLOW_TIMER
    return true if board == known and told_hz == told else told_hz


def goto_s(turn_deg: float, rate_deg_s: float, acceleration_deg_s2: float) -> float:
    """How long a goto by an angle takes: a trapezoid."""
    size = abs(turn_deg)
    if size < rate_deg_s**2 / acceleration_deg_s2:
        return 2.0 * math.sqrt(size / acceleration_deg_s2)
    return size / rate_deg_s + rate_deg_s / acceleration_deg_s2


@dataclass(frozen=True, slots=True)
class SkywatcherSettings:
    """Limits and rates that the controller doesn't know.

    Attributes
    ----------
    past_meridian_deg : float
        So far the counterweight may be driven above the horizontal by a slew, to keep the side.
    tracking_past_deg : float
        So far it may rise by tracking; then tracking is stopped.
    lowest_altitude_deg : float
        No slew goes below.
    guide_rate : float
        Of guide pulses, in sidereal rates, below 1.
    near_arcsec : float
        A slew is refined until it is so near.
    goto_deg_s, goto_deg_s2 : float
        Rate and acceleration of the board's own gotos, as far as known: a target is met where it will be.
    settle_s : float
        So long after the last stop tracking is begun again; longer than the pause between two stops of one.
    """

    past_meridian_deg: float = 1.0
    tracking_past_deg: float = 10.0
    lowest_altitude_deg: float = 0.0
    guide_rate: float = 0.5
    near_arcsec: float = 0.7
    goto_deg_s: float = 3.4
    goto_deg_s2: float = 2.2
    settle_s: float = 1.2


# refraction is left to who solves frames: a mount's own belief has none
_NO_AIR = Air(pressure_hpa=0.0)


def hour_angle_of(place: Apparent, utc: datetime, site: Site) -> HourAngle:
    """Hour angle and declination, at an instant, of a place whose numbers are taken as of date then."""
    return icrs_to_hour_angle(apparent_to_icrs(replace(place, utc=utc)), utc, site, _NO_AIR)


def place_of(ha_deg: float, dec_deg: float, utc: datetime, site: Site) -> Apparent:
    """Apparent place at an hour angle and declination."""
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), site, _NO_AIR), utc)


def altitude_deg(angles: HourAngle, site: Site) -> float:
    """Altitude above the horizon."""
    return hour_angle_to_observed(angles, site).alt_deg


HOME_SECOND_DEG = 90.0
"""How the second axis stands at home, where the tube looks at the pole: a quarter turn from the equator."""


@dataclass(frozen=True, slots=True)
class Turns:
    """How far the two axes are turned, deg; the second may lie anywhere from -90 to 270."""

    first_deg: float
    second_deg: float

    def plus(self, other: Turns) -> Turns:
        """Add turn by turn."""
        return Turns(self.first_deg + other.first_deg, self.second_deg + other.second_deg)

    def minus(self, other: Turns) -> Turns:
        """Subtract turn by turn."""
        return Turns(self.first_deg - other.first_deg, self.second_deg - other.second_deg)


HOME = Turns(0.0, HOME_SECOND_DEG)
"""Counterweight down, tube at the pole: how a German mount is set up, and where the counts begin at
power-up."""


def raises_dec(turns: Turns, latitude_deg: float) -> int:
    """+1 where the second axis raises the declination when it runs forward, -1 where it lowers it."""
    little = Turns(turns.first_deg, turns.second_deg + 1e-4)
    return 1 if sight(little, latitude_deg).dec_deg > sight(turns, latitude_deg).dec_deg else -1


@dataclass(frozen=True, slots=True)
class Sight:
    """What a mount looks at: geometric hour angle (-180, 180] and declination, deg, and from which side."""

    ha_deg: float
    dec_deg: float
    side: PierSide


def sky_sign(latitude_deg: float) -> int:
    """+1 where the first axis runs forward with the sky, -1 in the south."""
    return 1 if latitude_deg >= 0.0 else -1


def side_of(turns: Turns, latitude_deg: float) -> PierSide:
    """Side of the pier on which the tube hangs; the west one looks east."""
    near = turns.second_deg <= HOME_SECOND_DEG
    return PierSide.WEST if near is (sky_sign(latitude_deg) > 0) else PierSide.EAST


def sight(turns: Turns, latitude_deg: float) -> Sight:
    """Tell what axes that stand so look at."""
    sign = sky_sign(latitude_deg)
    if turns.second_deg <= HOME_SECOND_DEG:
        ha_deg, dec_deg = sign * (turns.first_deg - 90.0), sign * turns.second_deg
    else:
        ha_deg, dec_deg = sign * (turns.first_deg + 90.0), sign * (180.0 - turns.second_deg)
    if abs(dec_deg) > 90.0:
        # below the other pole: no stand of a mount, but no place beyond a pole either
        ha_deg, dec_deg = ha_deg + 180.0, (180.0 if dec_deg > 0.0 else -180.0) - dec_deg
    return Sight(half_turn_deg(ha_deg), dec_deg, side_of(turns, latitude_deg))


def turns_at(ha_deg: float, dec_deg: float, side: PierSide, latitude_deg: float) -> Turns:
    """Tell how the axes stand that look at a place from a side; the first within half a turn."""
    sign = sky_sign(latitude_deg)
    near = (side is PierSide.WEST) is (sign > 0)
    if near:
        return Turns(half_turn_deg(sign * ha_deg + 90.0), sign * dec_deg)
    return Turns(half_turn_deg(sign * ha_deg - 90.0), 180.0 - sign * dec_deg)


def other_side(side: PierSide) -> PierSide:
    """The side after a flip."""
    return PierSide.EAST if side is PierSide.WEST else PierSide.WEST


def side_for(
    ha_deg: float, dec_deg: float, present: PierSide, latitude_deg: float, *, past_deg: float
) -> PierSide:
    """Choose the side from which a place is looked at: the one whose counterweight stays down.

    Parameters
    ----------
    present : PierSide
        It is kept when the counterweight would rise above the horizontal by no more than `past_deg`: a place
        just past the meridian needs no flip.
    """
    if rise_deg(turns_at(ha_deg, dec_deg, present, latitude_deg)) <= past_deg:
        return present
    return other_side(present)


def rise_deg(turns: Turns) -> float:
    """By how much the counterweight stands above the horizontal, deg; negative when it hangs below."""
    return abs(turns.first_deg) - 90.0


STALE_DEG = 1.0
"""A sync that changes more than that means that the axes were turned by hand: the other side's is void."""


class Offsets:
    """True turns minus counted ones.

    Parameters
    ----------
    latitude_deg : float
        Of the site.
    """

    def __init__(self, latitude_deg: float) -> None:
        self._latitude_deg = latitude_deg
        self._known: dict[PierSide, Turns] = {}

    @property
    def known(self) -> bool:
        """Whether there was a sync."""
        return bool(self._known)

    def forget(self) -> None:
        """After a power-up the counts begin elsewhere."""
        self._known.clear()

    def at(self, side: PierSide) -> Turns:
        """The offset on one side."""
        return self._known.get(side) or self._known.get(other_side(side)) or Turns(0.0, 0.0)

    def true_turns(self, counted: Turns) -> Turns:
        """Where the axes stand that are counted so."""
        side = side_of(counted, self._latitude_deg)
        # an offset may carry them past the pole, to the other side
        side = side_of(counted.plus(self.at(side)), self._latitude_deg)
        return counted.plus(self.at(side))

    def counted_turns(self, true: Turns) -> Turns:
        """How axes are counted that shall stand so."""
        return true.minus(self.at(side_of(true, self._latitude_deg)))

    def shift(self, counted: Turns, ha_deg: float, dec_deg: float) -> Turns:
        """By how much the axes would be believed elsewhere after a sync; of both stands the nearer one."""
        now = self.true_turns(counted)

        def moved(side: PierSide) -> Turns:
            there = turns_at(ha_deg, dec_deg, side, self._latitude_deg).minus(now)
            return Turns(half_turn_deg(there.first_deg), there.second_deg)

        here = side_of(now, self._latitude_deg)
        return min(
            (moved(here), moved(other_side(here))), key=lambda one: abs(one.first_deg) + abs(one.second_deg)
        )

    def learn(self, counted: Turns, ha_deg: float, dec_deg: float) -> None:
        """Take over a sync: the axes that are counted so look at this place."""
        shift = self.shift(counted, ha_deg, dec_deg)
        true = self.true_turns(counted).plus(shift)
        side = side_of(true, self._latitude_deg)
        if max(abs(shift.first_deg), abs(shift.second_deg)) > STALE_DEG:
            self._known.clear()
        self._known[side] = true.minus(counted)
        if side_of(self.true_turns(counted), self._latitude_deg) is not side:
            # so near the pole that the two sides' offsets would take turns
            self._known = {side: true.minus(counted)}

    def sight(self, counted: Turns) -> Sight:
        """What axes that are counted so look at."""
        return sight(self.true_turns(counted), self._latitude_deg)


class AxisCounts:
    """How the axes stand.

    Parameters
    ----------
    latitude_deg : float
        Of the site.
    """

    def __init__(self, latitude_deg: float) -> None:
        self.offsets = Offsets(latitude_deg)
        self._gears: dict[Axis, Gearing] = {}
        self._second_zero = POSITION_ZERO

    def geared(self, gears: dict[Axis, Gearing]) -> None:
        """Take over what the board says of its gears."""
        self._gears = dict(gears)

    @property
    def second_gear(self) -> Gearing:
        """The declination motor's."""
        return self._gears[Axis.DECLINATION]

    def begin_at_home(self) -> None:
        """Counts of a board that was just switched on; what syncs have taught is void."""
        self.offsets.forget()
        self._second_zero = POSITION_ZERO - self.quarter

    def begin_as_eqmod(self) -> None:
        """Counts of a board whose motors were energized before us."""
        self._second_zero = POSITION_ZERO

    def second_moved(self, before: int, after: int) -> None:
        """The count of the second axis was set: the axis stands where it stood."""
        self._second_zero += after - before

    @property
    def quarter(self) -> int:
        """Counts of a quarter of a turn of the second axis."""
        return self._gears[Axis.DECLINATION].counts // 4

    def counted(self, first: int, second: int) -> Turns:
        """Turns as counted, syncs left out."""
        return Turns(
            self._gears[Axis.HOUR_ANGLE].turn_deg(first - POSITION_ZERO),
            self._gears[Axis.DECLINATION].turn_deg(second - self._second_zero),
        )

    def turns(self, first: int, second: int) -> Turns:
        """How the axes stand, as far as we know."""
        return self.offsets.true_turns(self.counted(first, second))

    def counts(self, turns: Turns) -> tuple[int, int]:
        """Counts at which the axes stand so.

        Raises
        ------
        DeviceRefused
            If the board can't count that far.
        """
        counted = self.offsets.counted_turns(turns)
        first = POSITION_ZERO + self._gears[Axis.HOUR_ANGLE].counts_of(counted.first_deg)
        second = self._second_zero + self._gears[Axis.DECLINATION].counts_of(counted.second_deg)
        if not (0 <= first <= LARGEST and 0 <= second <= LARGEST):
            raise DeviceRefused("the axes can't be counted so far round", reason=Refusal.LIMIT)
        return first, second
