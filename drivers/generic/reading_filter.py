"""Which readings of a mount are believed: those of one that rests, or that a second and a third confirm.

A single odd answer is never published. At rest a reading counts when it is where the last one was. Any other
is taken again at once, and counts when the two agree: no further apart than the mount goes in the moment
between them, at the speed it was seen to have; or when three in a row lie on one steady motion (somebody at
the hand control). What no mount can do at all - a jump faster than any motor - is believed only so, and told.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.language import Readout
from drivers.generic.options import Timing
from mountnav.errors import DeviceGarbled

MOST_LOOKS = 10
_LONGEST_SPAN_S = 1.0
_LONGEST_GAIN_S = 3.0
_SHORTEST_PACE_S = 0.02
_LEAP_DEG = 10.0
"""So far beyond its pace a mount may be found on its way: fast ones reach full speed within a look. Doubled,
one that is switched off and on for a second and wakes up 20° away is not noticed."""
HAND_DEG, HAND_DEG_S = 0.5, 6.0
"""So far and so fast somebody at the hand control may move it between two looks. Doubled, a mount that wakes
up 10° from where it was passes for one that was moved."""


@dataclass(frozen=True, slots=True)
class Believed:
    """A reading that counts.

    Attributes
    ----------
    readout : Readout
    jump_arcsec : float
        By how much it lies further from the last one than any mount can move; 0 as a rule.
    leap_arcsec : float
        By how much it lies further than this mount can have gone by the pace it had; 0 as a rule.
    """

    readout: Readout
    jump_arcsec: float = 0.0
    leap_arcsec: float = 0.0


class ReadingFilter:
    """Judges one mount's readings.

    Parameters
    ----------
    timing : Timing
    device : str
        For messages.
    """

    def __init__(self, timing: Timing, device: str) -> None:
        self._timing = timing
        self._device = device
        self.last: Readout | None = None
        self.resolution_arcsec = 15.0
        self.moving = False
        """Whether an order to move is being carried out."""
        self._pace_arcsec_s = 0.0

    def forget(self) -> None:
        """The next reading may be anywhere: after a sync or a new link."""
        self.last = None
        self._pace_arcsec_s = 0.0

    async def read(self, look: Callable[[], Awaitable[Readout]]) -> Believed:
        """Read until a reading can be believed.

        Raises
        ------
        DeviceGarbled
            If they go on contradicting each other.
        """
        last = self.last
        readout = await look()
        if not readout.doubtful and last is not None and self._rests(last, readout):
            return self._believed(readout)
        earlier: Readout | None = None
        for _ in range(MOST_LOOKS):
            again = await look()
            # a doubtful one confirms nothing: it may be what went wrong
            if not (again.doubtful or readout.doubtful) and (
                self.reachable(readout, again)
                or (earlier is not None and self._steady_motion(earlier, readout, again))
            ):
                return self._believed(again)
            earlier, readout = readout, again
        raise DeviceGarbled(
            f"readings contradict each other, the last is {readout.place}",
            device=self._device,
            advice="check cable, speed (baud) and that nothing else talks to the mount",
        )

    def _believed(self, readout: Readout) -> Believed:
        # somebody else may have read meanwhile: the jump counts from the last that was believed
        last, self.last = self.last, readout
        if last is None:
            return Believed(readout)
        leap_arcsec = self._beyond_its_pace(last, readout)
        elapsed_s = (readout.utc - last.utc).total_seconds()
        if elapsed_s > _SHORTEST_PACE_S:
            self._pace_arcsec_s = apart_arcsec(last.place, readout.place) / elapsed_s
        return Believed(readout, self._beyond_any_motor(last, readout), leap_arcsec)

    def _rests(self, before: Readout, after: Readout) -> bool:
        """Whether a reading is where the last one was, but for the turn of the sky."""
        free_arcsec = self._timing.resting_arcsec + 2.0 * self.resolution_arcsec
        drift_arcsec = self._timing.drift_arcsec_s * _elapsed_s(before, after)
        return apart_arcsec(before.place, after.place) <= free_arcsec + drift_arcsec

    def reachable(self, before: Readout, after: Readout) -> bool:
        """Whether a mount read as `before` can be, a moment later, where `after` says."""
        # an order counts where the mount can't tell: at rest a wrong digit must not pass as its motion
        if before.slewing is None or after.slewing is None:
            moving = self.moving
        else:
            moving = before.slewing or after.slewing
        if not moving:
            return self._rests(before, after)
        since_s = _elapsed_s(self.last, after) if self.last is not None else _LONGEST_SPAN_S
        gained_arcsec_s = self._timing.acceleration_deg_s2 * 3600.0 * min(since_s, _LONGEST_GAIN_S)
        pace_arcsec_s = 1.5 * self._pace_arcsec_s + gained_arcsec_s
        rate = min(pace_arcsec_s, self._timing.fastest_deg_s * 3600.0)
        free_arcsec = self._timing.resting_arcsec + 2.0 * self.resolution_arcsec
        return apart_arcsec(before.place, after.place) <= free_arcsec + rate * _elapsed_s(before, after)

    def still(self, before: Readout, after: Readout) -> bool:
        """Whether the mount rested between two readings."""
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        free_arcsec = 1.0 + 1.1 * self.resolution_arcsec + self._timing.drift_arcsec_s * elapsed_s
        return not after.slewing and apart_arcsec(before.place, after.place) <= free_arcsec

    def _beyond_any_motor(self, before: Readout, after: Readout) -> float:
        free_arcsec = self._timing.resting_arcsec + 2.0 * self.resolution_arcsec
        reach_arcsec = self._timing.fastest_deg_s * 3600.0 * _elapsed_s(before, after) + free_arcsec
        return max(0.0, apart_arcsec(before.place, after.place) - reach_arcsec)

    def _beyond_its_pace(self, before: Readout, after: Readout) -> float:
        elapsed_s = _elapsed_s(before, after)
        gained_arcsec_s = self._timing.acceleration_deg_s2 * 3600.0 * min(elapsed_s, _LONGEST_GAIN_S)
        rate = max(1.5 * self._pace_arcsec_s + gained_arcsec_s, HAND_DEG_S * 3600.0)
        free_arcsec = _LEAP_DEG * 3600.0 + 2.0 * self.resolution_arcsec
        return max(0.0, apart_arcsec(before.place, after.place) - free_arcsec - rate * elapsed_s)

    def _steady_motion(self, first: Readout, second: Readout, third: Readout) -> bool:
        """Whether three readings lie on one motion of constant speed in one direction."""
        one, two = _elapsed_s(first, second), _elapsed_s(second, third)
        if one <= 0.0 or two <= 0.0 or second.doubtful:
            return False
        ab, bc = apart_arcsec(first.place, second.place), apart_arcsec(second.place, third.place)
        free_arcsec = 2.0 * self.resolution_arcsec
        straight = ab + bc - apart_arcsec(first.place, third.place) <= free_arcsec + 0.05 * (ab + bc)
        alike = abs(ab / one - bc / two) <= 0.5 * max(ab / one, bc / two) + free_arcsec / min(one, two)
        return straight and alike and max(ab / one, bc / two) <= self._timing.fastest_deg_s * 3600.0


def _elapsed_s(before: Readout, after: Readout) -> float:
    # coordinates asked one after the other: a moving mount goes on between them
    # (what was asked again took longer, but moved no further meanwhile)
    spans_s = min(before.span_s, _LONGEST_SPAN_S) + min(after.span_s, _LONGEST_SPAN_S)
    return max(0.0, (after.utc - before.utc).total_seconds()) + spans_s
