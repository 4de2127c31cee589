"""Whether the side of the pier that a German mount tells is the one on which its tube hangs.

A mount that tells the other side, always, contradicts itself in no reading: a slew on which it stays on its
side looks the same from both sides of the meridian. Only the limits past the meridian hang on it. Until the
side is proven they count for both sides.

It is proven by the word of one who looked (``swap_sides`` is set, to yes or to no); by a tube that stands
where it would be far beyond those limits if it hung on the other side, for no order of ours leads there; or
by the sides that the mount foretells for places far to the east and to the west.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import datetime

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import DeviceRefused, LimitKind, OutsideLimits
from mountnav.pointing.limits.postures import COUNTERWEIGHT_DOWN_DEG, Standing
from mountnav.pointing.limits.scene import Scene
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg

SIDE_PROVEN = "side-proven"
"""What the facts of such a journal entry say under `about`."""
BEYOND_DEG = 3.0
"""A tube that would stand so far, °, beyond the limit past the meridian if the side were wrong proves it:
more than a pointing error of a mount whose position counts. Doubled, more first slews would be refused."""
PLAIN_DEC_DEG = 85.0
"""Nearer to the pole than this, °, a place doesn't tell how the hour angle axis stands."""
FAR_DEG = 75.0
"""Places so far from the meridian, °, are asked for: a mount that looks at them from the wrong side, its
counterweight so far up, has no limits at all."""
_ASKED_DEC_DEG = 45.0
"""°, on the side of the visible pole: places that every mount reaches on both sides."""
_DEEPER_DEG = 0.3
"""What stands beyond a limit may be led so much deeper, °: a pointing error and a minute of tracking.
Doubled, small slews in a row lead beyond it by twice as much."""
_OF_AXES = frozenset({LimitKind.MERIDIAN, LimitKind.UNREACHABLE})
_SIDES = (PierSide.EAST, PierSide.WEST)

LOOK_AT_IT = (
    "order home, or park and unpark: if that is at the pole, the first slew from there shows it; or look at "
    "the tube, and set swap_sides of the mount: false if it hangs where the mount says, true if on the other "
    "side, and start the service again"
)

Asked = Callable[[Icrs], Awaitable[PierSide | None]]


class SideUnproven(OutsideLimits):
    """A slew that may be made from the side that the mount tells, and not from the other one."""


class SideProof:
    """Of one mount.

    Parameters
    ----------
    stated : bool
        Whether somebody has looked, and said so in the settings.
    tell : callable, optional
        Told once, in words, by what it was proven.

    Attributes
    ----------
    stated : bool
    proven : bool
    wrong : bool
        It foretells the sides the wrong way round.
    """

    def __init__(self, *, stated: bool = False, tell: Callable[[str], None] | None = None) -> None:
        self._tell = tell or (lambda _how: None)
        self.stated = self.proven = stated
        self.wrong = False
        self._asked = False

    def stood(self, scene: Scene, now: Standing) -> bool:
        """Take in how it stands, by what it tells; whether that has proven the side."""
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
        before, after = (scene.axis_depths(mirrored(one)) for one in (start, end))
        for limit in _OF_AXES & set(after):
            depth_deg = float(after[limit][0])
            # by the pole an order from home leads to either posture, unseen
            came_in = not from_home or abs(_dec_deg(end)) < PLAIN_DEC_DEG
            stood_deg = float(before[limit][0]) + _DEEPER_DEG if came_in else 0.0
            if depth_deg > max(0.0, stood_deg):
                raise SideUnproven(
                    f"the slew isn't allowed: the mount says that its tube hangs on the {start.side} side of "
                    f"the pier, which nothing has shown yet; if it hangs on the other one, it would come "
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
            f"the slew isn't allowed: the mount would say that its tube hangs on the {end.side} side of the "
            "pier, which nothing has shown yet; if it hangs on the other one, tracking there leads too far "
            "past the meridian at once",
            advice=LOOK_AT_IT,
            limit=LimitKind.MERIDIAN,
        )


def mirrored(one: Standing) -> Standing:
    """How the axes would stand that look at the same place from the other side of the pier."""
    other = PierSide.WEST if one.side is PierSide.EAST else PierSide.EAST
    first_deg = COUNTERWEIGHT_DOWN_DEG + half_turn_deg(one.first_deg + 180.0 - COUNTERWEIGHT_DOWN_DEG)
    return replace(one, side=other, first_deg=first_deg, second_deg=180.0 - one.second_deg)


def _dec_deg(one: Standing) -> float:
    """Declination of where the axes look."""
    return math.degrees(math.asin(math.sin(math.radians(one.second_deg))))


__all__ = ["LOOK_AT_IT", "SIDE_PROVEN", "SideProof", "SideUnproven", "mirrored"]
