"""On which side of the pier a German mount's tube hangs: reported, proven, followed, kept past transit."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import DeviceRefused, LimitKind, OutsideLimits
from mountnav.pointing.limits import Limits, SlewCheck
from mountnav.pointing.limits.postures import Standing, Way, from_the_meridian_deg, side_by_rule
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.slews import STAYS_ROOM_DEG
from mountnav.pointing.limits.ways import strays_deg
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Site
from mountnav.sky.german_axes import COUNTERWEIGHT_DOWN_DEG, first_axis_deg
from mountnav.sky.sphere import half_turn_deg

__all__ = ["LOOK_AT_IT", "SIDE_PROVEN", "SideProof", "SideUnproven", "mirrored"]


SIDE_PROVEN = "side-proven"
"""What the facts of such a journal entry say under `about`."""
BEYOND_DEG = 3.0
"""A tube that would stand so far, °, beyond the limit past the meridian if the side were wrong proves it:
more than a pointing error of a mount whose position counts. Doubled, more first slews would be refused."""
PLAIN_DEC_DEG = 85.0
"""Nearer to the pole than this, °, a place doesn't say how the hour angle axis stands. Chosen by hand.
Doubled distance (80°), more of the sky near the pole proves nothing."""
FAR_DEG = 75.0
"""Places so far from the meridian, °, are asked for: a mount that looks at them from the wrong side, its
counterweight so far up, has no limits at all. Chosen by hand. Halved, mounts with wide limits could truly
look at them from either side."""
_ASKED_DEC_DEG = 45.0
"""°, on the side of the visible pole: places that every mount reaches on both sides. Chosen by hand, far from
the horizon and from the pole."""
_DEEPER_DEG = 0.3
"""What stands beyond a limit may be led so much deeper, °: a pointing error and a minute of tracking.
Doubled, small slews in a row lead beyond it by twice as much."""
_OF_AXES = frozenset({LimitKind.MERIDIAN, LimitKind.UNREACHABLE})
_SIDES = (PierSide.EAST, PierSide.WEST)

LOOK_AT_IT = (
    "order home, or park and unpark: if that is at the pole, the first slew from there shows it; or look at "
    "the tube, and set swap_sides of the mount: false if it is where the mount says, true if on the other "
    "side, and start the service again"
)

Asked = Callable[[Icrs], Awaitable[PierSide | None]]


class SideUnproven(OutsideLimits):
    """A slew that may be made from the side that the mount reports, and not from the other one."""


class SideProof:
    """Of one mount.

    Parameters
    ----------
    stated : bool
        Whether somebody has looked, and has written so into the settings.
    tell : callable, optional
        Told once, in words, by what it was proven.

    Attributes
    ----------
    wrong : bool
        It foretells the sides the wrong way round.
    """

    def __init__(self, *, stated: bool = False, tell: Callable[[str], None] | None = None) -> None:
        self._tell = tell or (lambda _how: None)
        self.stated = self.proven = stated
        self.wrong = False
        self._asked = False

    def stood(self, scene: Scene, now: Standing) -> bool:
        """Take in how it stands, by what it reports; whether that has proven the side."""
        past = scene.limits.past_meridian_deg
        if self.proven or past is None or now.mounting != "german" or abs(_dec_deg(now)) > PLAIN_DEC_DEG:
            return False
        raised_deg = abs(half_turn_deg(now.first_deg - COUNTERWEIGHT_DOWN_DEG)) - 90.0
        if self.wrong or -raised_deg <= max(past) + BEYOND_DEG:
            return False
        self._prove(
            f"on the other side its counterweight would stand {-raised_deg:.0f}° above the horizontal"
        )
        return True

    def restore(self) -> None:
        """It was proven in an earlier run."""
        self.proven = True

    def _prove(self, how: str) -> None:
        self.proven = True
        self._tell(how)

    async def ask(self, foretold: Asked, site: Site, air: Air, utc: datetime) -> None:
        """Ask a mount that foretells its side on which it would look at two places; once is enough.

        Raises
        ------
        DeviceError
        """
        if self.proven or self._asked:
            return
        told = []
        for ha_deg in (-FAR_DEG, FAR_DEG):
            place = HourAngle(ha_deg, math.copysign(_ASKED_DEC_DEG, site.latitude_deg), utc)
            try:
                told.append(await foretold(hour_angle_to_icrs(place, site, air)))
            except DeviceRefused:
                return
        self._asked = True
        if told == [PierSide.WEST, PierSide.EAST]:
            self._prove("it foretells the right sides for places far in the east and in the west")
        self.wrong = told == [PierSide.EAST, PierSide.WEST]

    def ambiguous(self, scene: Scene, now: Standing) -> bool:
        """Whether nothing has shown the side, and the tube may hang on either as it stands now.

        Where it would be beyond the limit on the other one it isn't: no order of ours leads there.
        """
        if self.proven or scene.limits.past_meridian_deg is None or now.mounting != "german":
            return False
        return all(
            depth[0] <= BEYOND_DEG
            for limit, depth in scene.axis_depths(mirrored(now)).items()
            if limit in _OF_AXES
        )

    def require(self, scene: Scene, start: Standing, end: Standing, *, from_home: bool = False) -> None:
        """Refuse a way on one side that would lead beyond a limit if the tube hung on the other one.

        Raises
        ------
        SideUnproven
        """
        if self.proven or scene.limits.past_meridian_deg is None or start.side is not end.side:
            return  # on a change of sides it is seen at once that the axes turn the other way round
        before, after = (scene.axis_depths(mirrored(standing)) for standing in (start, end))
        for limit in _OF_AXES & set(after):
            depth_deg = float(after[limit][0])
            # by the pole an order from home leads to either posture, unseen
            came_in = not from_home or abs(_dec_deg(end)) < PLAIN_DEC_DEG
            stood_deg = float(before[limit][0]) + _DEEPER_DEG if came_in else 0.0
            if depth_deg > max(0.0, stood_deg):
                raise SideUnproven(
                    f"the slew isn't allowed: the mount says that its tube is on the {start.side} side of "
                    f"the pier, which nothing has confirmed yet; if it is on the other one, it would come "
                    f"{depth_deg:.1f}° too far past the meridian on its way",
                    advice=LOOK_AT_IT,
                    limit=LimitKind.MERIDIAN,
                )

    def require_to_track(self, scene: Scene, end: Standing, for_s: float) -> None:
        """Refuse a place at which tracking would be ended, since its limit counts for both sides there.

        Raises
        ------
        SideUnproven
        """
        other = mirrored(end)
        if not self.ambiguous(scene, end):
            return
        later = scene.axis_depths(other, np.array([other.first_deg + SIDEREAL_DEG_S * for_s]))
        if all(float(later[limit][0]) <= 0.0 for limit in _OF_AXES & set(later)):
            return
        raise SideUnproven(
            f"the slew isn't allowed: the mount would say that its tube is on the {end.side} side of the "
            "pier, which nothing has confirmed yet; if it is on the other one, tracking there leads too far "
            "past the meridian at once",
            advice=LOOK_AT_IT,
            limit=LimitKind.MERIDIAN,
        )


def mirrored(one: Standing) -> Standing:
    """How the axes would stand that look at the same place from the other side of the pier."""
    other = PierSide.WEST if one.side is PierSide.EAST else PierSide.EAST
    first_deg = first_axis_deg(one.first_deg + 180.0)
    return replace(one, side=other, first_deg=first_deg, second_deg=180.0 - one.second_deg)


def _dec_deg(one: Standing) -> float:
    """Declination of where the axes look."""
    return math.degrees(math.asin(math.sin(math.radians(one.second_deg))))


FASTEST_DEG_S = 30.0
"""No German mount turns an axis faster (the fastest have 15 to 20). Doubled, readings have to follow within
1.4 s to mean anything."""
_SLACK_DEG = 3.0
"""So much, °, the angles of two readings differ besides: by pointing errors that the pole makes large. Chosen
by hand."""
_RESTS_DEG = 1.0
"""One that has moved less, °, tracking besides, has not changed sides meanwhile. Doubled, a change for a
place so near might be overlooked if nobody looks for so long as it takes."""
_LONGEST_S = 60.0
"""Whatever happened in a longer pause, s, nobody has seen. Doubled, a change within it may be overlooked."""


_AT_POLE_DEG = 0.5
"""Nearer to the pole, °, a place says too little of the first axis: at 0.1° refraction alone turns it by 10°
and more. Doubled, a slow axis that crosses it is out of sight for half a second longer."""
_FROM_HOME_DEG = 60.0
"""No farther than this, °, its first axis is taken to have turned from home to the first reading beside the
pole. One that stood there otherwise, up to 30° past the meridian, would be as near by the wrong side from
60° on; doubled, its side would be wrong."""


class SideFollowed:
    """Of one mount.

    Attributes
    ----------
    home : bool
        Whether it is taken to stand at its home still.
    """

    def __init__(self) -> None:
        self._possible: dict[PierSide, Standing] = {}
        self._from: dict[PierSide, set[PierSide]] = {}
        self._utc: datetime | None = None
        self._either = False
        self._supposed: PierSide | None = None
        self.home = False

    @property
    def side(self) -> PierSide | None:
        """On which side it hangs; None if it may be either."""
        sides = [*self._possible]
        return sides[0] if len(sides) == 1 else None

    @property
    def either(self) -> bool:
        """Whether it isn't to be taken to hang on the usual side.

        What was seen leaves both, and on the one on which it was supposed to hang it would look the other
        way now.
        """
        return self._either and self.side is None

    def at_home(self, utc: datetime, stands: Standing) -> None:
        """It stands at home, as it was switched on: its axes stand there, on whichever side."""
        self._possible = {side: replace(stands, side=side) for side in _SIDES}
        self._utc, self._either, self.home = utc, False, True
        self._set_out()

    def seen(self, utc: datetime, stands: dict[PierSide, Standing], *, told_anew: bool = False) -> None:
        """Take in a reading.

        Parameters
        ----------
        stands : dict of PierSide to Standing
            How it would stand on each side.
        told_anew : bool
            Its place may have changed without a motion, by a sync.
        """
        before, then, home = self._possible, self._utc, self.home
        self._utc, self.home = utc, False
        seconds = _LONGEST_S if then is None else abs((utc - then).total_seconds())
        if not before or seconds >= _LONGEST_S:
            self._possible = stands
            self._set_out()
            return
        if told_anew:
            self._possible = {side: stands[side] for side in before}
            return
        moved = math.inf if home else max(_apart_deg(before[side], stands[side]) for side in before)
        if moved <= _RESTS_DEG + SIDEREAL_DEG_S * seconds:
            self._possible = {side: stands[side] for side in before}
            return
        if any(abs(90.0 - abs(standing.second_deg)) < _AT_POLE_DEG for standing in stands.values()):
            # what it has come to is shown by the next reading beside the pole
            self._utc, self.home = then, home
            return
        far_deg = FASTEST_DEG_S * seconds + _SLACK_DEG
        if home:
            far_deg = min(far_deg, _FROM_HOME_DEG)
        came = {
            side: [was for was, stood in before.items() if _apart_deg(stood, one) <= far_deg]
            for side, one in stands.items()
        }
        reached = {side: one for side, one in stands.items() if came[side]}
        self._possible = reached or stands
        self._from = {
            side: set().union(*(self._from.get(was, {*_SIDES}) for was in came[side])) or {*_SIDES}
            for side in self._possible
        }

    def _set_out(self) -> None:
        self._from = {side: {side} for side in self._possible}
        self._supposed = self._usual

    @property
    def _usual(self) -> PierSide | None:
        """The side on which German mounts usually look there; None while nothing was seen."""
        for standing in self._possible.values():
            return side_by_rule(standing.first_deg - (180.0 if standing.side is PierSide.WEST else 0.0))
        return None

    def arrived(self, sides: Iterable[PierSide], faces: PierSide | None = None) -> None:
        """A slew has ended: that shows the side where nothing else does.

        Parameters
        ----------
        sides : iterable of PierSide
            On which it should end.
        faces : PierSide or None
            The one that faces the place, if it stands well away from the meridian.
        """
        if self.home:
            # still by the pole, and its axes anywhere
            self._possible, self.home = {}, False
        changed = self._possible and all(side not in self._from[side] for side in self._possible)
        if changed and faces in self._possible:
            # none changes to the side that looks the other way
            self._possible = {faces: self._possible[faces]}
        left = {side: one for side, one in self._possible.items() if side in sides}
        if len(self._possible) != 1 and len(left) == 1:
            self._possible = left
        usual = self._usual
        kept = not self._either and usual is not None and self._from.get(usual) == {self._supposed}
        self._either = len(self._possible) > 1 and not kept
        self._set_out()

    def lost(self, *, astray: bool = False) -> None:
        """Nobody knows what it did meanwhile.

        `astray`: it didn't begin on the side on which it was supposed to hang.
        """
        self._possible, self._from, self._utc, self.home = {}, {}, None, False
        self._either = astray


def _apart_deg(one: Standing, other: Standing) -> float:
    """How far one of the axes has to turn at least."""
    first = abs(half_turn_deg(other.first_deg - one.first_deg))
    return max(first, abs(half_turn_deg(other.second_deg - one.second_deg)))


STRAYS_DEG = 3.0
"""So far from a way, °, the axes are on another one: more than readings and pointing errors differ. Doubled,
a mount that goes another way is stopped that much later."""


class SidesKept:
    """Of one mount.

    Attributes
    ----------
    to_deg : float
        So far past the meridian it was seen to stay; 0: never.
    """

    def __init__(self) -> None:
        self.to_deg = 0.0

    def reckoned(self, limits: Limits) -> Limits:
        """The limits, with ways for a mount that stays where it was seen to stay."""
        return replace(limits, stays_to_deg=self.to_deg) if self.to_deg else limits

    def strayed(self, check: SlewCheck, stands: Sequence[Standing], began: PierSide | None) -> bool:
        """It goes another way than expected: whether it stays on its side there, or changes after all.

        False: neither, from the side on which it should have begun.

        Parameters
        ----------
        stands : sequence of Standing
            How it may stand on its way.
        began : PierSide or None
            On which side, if that was known.
        """
        taken = [
            way
            for way in check.unasked
            if min(strays_deg([way], standing) for standing in stands) <= STRAYS_DEG and not _turns_away(way)
        ]
        if not taken and began is None:
            # nor did it begin on the side that faces the place: it stayed there before
            taken = [way for way in check.expected if way.start.side is not PierSide.UNKNOWN][:1]
            self._stays_for([from_the_meridian_deg(way.start.first_deg) for way in taken])
        elif taken and all(way.start.side is way.end.side for way in taken):
            self._stays_for([from_the_meridian_deg(way.end.first_deg) for way in taken])
        elif taken and not any(way.start.side is way.end.side for way in taken):
            past_deg = from_the_meridian_deg(taken[0].end.first_deg)
            self.to_deg = max(0.0, min(self.to_deg, past_deg - STAYS_ROOM_DEG))
        return bool(taken)

    def _stays_for(self, past_deg: Sequence[float]) -> None:
        self.to_deg = max([self.to_deg, *(angle_deg + STAYS_ROOM_DEG for angle_deg in past_deg)])

    def hangs(self, side: PierSide, ha_deg: float) -> None:
        """It has come to rest on a side: whether it faces the place, or it stayed where it was."""
        if side is not side_by_rule(ha_deg):
            self._stays_for([from_the_meridian_deg(ha_deg)])

    @property
    def advice(self) -> str:
        """What to do about a target that can't be reached on the side that it keeps."""
        return (
            f"it was seen to stay on its side of the pier {self.to_deg:.0f}° past the meridian, where it "
            "should have changed: order home or park (then it may choose its side again), or set its own "
            "limit past the meridian to what limits.past_meridian_east_deg and _west_deg allow, and start "
            "again"
        )

    def forget(self) -> None:
        """Somebody may have turned it, or set it otherwise."""
        self.to_deg = 0.0


def _turns_away(way: Way) -> bool:
    """Whether it would change to the side that looks the other way: no mount does that unasked."""
    return way.start.side is not way.end.side and not _faces(way.end)


def _faces(one: Standing) -> bool:
    ha_deg = one.first_deg - (180.0 if one.side is PierSide.WEST else 0.0)
    return one.side is side_by_rule(ha_deg)
