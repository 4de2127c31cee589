"""How far past the meridian a German mount was seen to stay on its side, where it was expected to change.

Where a mount doesn't foretell its side, it is expected to look from the one that faces the target; some stay
on theirs as long as they can. Such a slew is stopped, and planned as before it would be stopped again: what
was seen once is reckoned with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mountnav.devices import PierSide
from mountnav.pointing.limits import Limits, SlewCheck
from mountnav.pointing.limits.postures import Standing, Way, from_the_meridian_deg, side_by_rule
from mountnav.pointing.limits.slews import STAYS_ROOM_DEG
from mountnav.pointing.limits.ways import strays_deg

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
        check : SlewCheck
        stands : sequence of Standing
            How it may stand on its way.
        began : PierSide or None
            On which side, if that was known.
        """
        taken = [
            way
            for way in check.unasked
            if min(strays_deg([way], one) for one in stands) <= STRAYS_DEG and not _turns_away(way)
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
        self.to_deg = max([self.to_deg, *(one + STAYS_ROOM_DEG for one in past_deg)])

    def hangs(self, side: PierSide, ha_deg: float) -> None:
        """It has come to rest on a side: whether it faces the place, or it stayed where it was."""
        if side is not side_by_rule(ha_deg):
            self._stays_for([from_the_meridian_deg(ha_deg)])

    @property
    def advice(self) -> str:
        """What to do about a target that can't be reached on the side that it keeps."""
        return (
            f"it was seen to stay on its side of the pier {self.to_deg:.0f}° past the meridian, where it "
            "should have changed: order home or park (then it may choose its side anew), or set its own "
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
