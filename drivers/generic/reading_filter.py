"""Which readings of a mount are believed: those of one that rests, or that a second and a third confirm.

A single odd answer is never published. At rest a reading counts when it is where the last one was. Any other
is taken again at once, and counts when the two agree: no further apart than the mount goes in the moment
between them, at the speed it was seen to have; or when three in a row lie on one steady motion (somebody at
the hand control). What no mount can do at all - a jump faster than any motor - is believed only in that way,
and reported.

A mount that tracks at rates beside the sidereal one goes on by itself: it is where the last reading was if it
lies on the way that these rates lead (`drift`).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.drift import Drift
from drivers.generic.language import Readout
from drivers.generic.options import Timing
from mountnav.errors import DeviceGarbled

MOST_READINGS = 10
"""How many readings may contradict each other before the line counts as garbled. Chosen: with one bad answer
in five two good ones in a row come long before. Doubled, an order waits twice as long for a line that is
hopeless; halved, a bad line fails that would have got through."""
_LONGEST_SPAN_S = 1.0
"""s. The questions for one place are taken to span no more: one that had to be asked again took longer, but
the mount went no further for that. Chosen by hand: at 9600 baud the two questions take 0.1 s. Doubled, a
garbled place twice as far off passes for motion."""
_LONGEST_GAIN_S = 3.0
"""s. A mount gains speed for no longer than this. Chosen by hand: at `acceleration_deg_s2` it is then faster
than all but direct drives. Doubled, a place that no mount can have reached passes more easily."""
_SHORTEST_PACE_S = 0.02
"""s. No speed is derived from two readings closer in time than this: the rounding of their places divided by
such a time is no speed. Chosen by hand. Doubled, fast wires give no speed; halved, noise makes one."""
_LEAP_DEG = 10.0
"""A mount may be found so far beyond what its speed explains: fast ones reach full speed between two
readings. Doubled, one that is switched off and on for a second and wakes up 20° away is not noticed."""
HAND_DEG, HAND_DEG_S = 0.5, 6.0
"""How far (°) at once, and how fast (°/s), somebody at the hand control may move it between two readings.
Doubled, a mount that wakes up 10° from where it was passes for one that was moved."""
_PACE_GROWTH = 1.5
"""A mount may be so many times as fast as it was seen to be, besides what it gains by acceleration: speeds
are measured over uneven times. Chosen by hand. Doubled, a wrong digit passes at twice the distance."""
_MOST_BEND = 0.05
"""Three readings lie on one line if the way over the second is longer by no more than this share. Chosen by
hand: an arc of 60° is longer than its chord by 5 %. Doubled, a garbled second reading passes more easily."""
_SPEEDS_ALIKE = 0.5
"""Two speeds are alike if they differ by no more than this share of the faster one: a motion by hand is
uneven. Chosen by hand. Doubled, any two speeds are alike."""


@dataclass(frozen=True, slots=True)
class Believed:
    """A reading that is believed.

    Attributes
    ----------
    jump_arcsec : float
        By how much it lies further from the last one than any mount can move; 0 as a rule.
    leap_arcsec : float
        By how much it lies further than this mount can have gone at the speed it had; 0 as a rule.
    """

    readout: Readout
    jump_arcsec: float = 0.0
    leap_arcsec: float = 0.0


class ReadingFilter:
    """Decides which of one mount's readings are believed.

    Parameters
    ----------
    device : str
        For messages.

    Attributes
    ----------
    last : Readout or None
        The last one that was believed.
    resolution_arcsec : float
        The mount's step; 15 (a second of right ascension) until it is known.
    moving : bool
        Whether an order to move is being carried out; counts where the mount doesn't report that it slews.
    drift : Drift
        The rates at which it moves by itself.
    """

    def __init__(self, timing: Timing, device: str) -> None:
        self._timing = timing
        self._device = device
        self.last: Readout | None = None
        self.resolution_arcsec = 15.0
        self.moving = False
        self.drift = Drift()
        self._pace_arcsec_s = 0.0

    def forget(self) -> None:
        """Accept any place next: after a sync or on a new link."""
        self.last = None
        self._pace_arcsec_s = 0.0

    async def read(self, read_once: Callable[[], Awaitable[Readout]]) -> Believed:
        """Read until a reading is believed.

        Raises
        ------
        DeviceGarbled
            If they go on contradicting each other.
        """
        last = self.last
        readout = await read_once()
        if not readout.doubtful and last is not None and self._rests(last, readout):
            return self._believed(readout)
        earlier: Readout | None = None
        for _ in range(MOST_READINGS):
            again = await read_once()
            # a doubtful reading confirms nothing: it may itself be wrong
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
        # another task may have read meanwhile: jumps count from the last reading that was believed
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
        free_arcsec = self._timing.resting_free_arcsec(self.resolution_arcsec)
        drift_arcsec = self._timing.drift_arcsec_s * _elapsed_s(before, after)
        return self.beyond_drift_arcsec(before, after) <= free_arcsec + drift_arcsec

    def beyond_drift_arcsec(self, before: Readout, after: Readout) -> float:
        """How far a reading is from the way that the mount's offset rates lead from the last one."""
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        spans_s = _elapsed_s(before, after) - elapsed_s
        return self.drift.beyond_arcsec(before.place, after.place, elapsed_s, spans_s)

    def reachable(self, before: Readout, after: Readout) -> bool:
        """Whether a mount read at `before` can be, a moment later, at `after`."""
        # where the mount doesn't report its motion, our order counts: at rest a wrong digit must not pass as
        # motion
        if before.slewing is None or after.slewing is None:
            moving = self.moving
        else:
            moving = before.slewing or after.slewing
        if not moving:
            return self._rests(before, after)
        since_s = _elapsed_s(self.last, after) if self.last is not None else _LONGEST_SPAN_S
        fastest_arcsec_s = min(self._speed_after_arcsec_s(since_s), self._timing.fastest_deg_s * 3600.0)
        free_arcsec = self._timing.resting_free_arcsec(self.resolution_arcsec)
        reach_arcsec = free_arcsec + fastest_arcsec_s * _elapsed_s(before, after)
        return apart_arcsec(before.place, after.place) <= reach_arcsec

    def _speed_after_arcsec_s(self, seconds: float) -> float:
        """How fast this mount can be some seconds after its speed was measured."""
        gained_arcsec_s = self._timing.acceleration_deg_s2 * 3600.0 * min(seconds, _LONGEST_GAIN_S)
        return _PACE_GROWTH * self._pace_arcsec_s + gained_arcsec_s

    def still(self, before: Readout, after: Readout) -> bool:
        """Whether the mount rested between two readings."""
        return not after.slewing and not self.changed(before, after)

    def changed(self, before: Readout, after: Readout) -> bool:
        """Whether it moved by more than a step of the wire, the turn of the sky and its own rates."""
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        # an arcsecond and a tenth of a step: two readings of one place may be rounded to neighboring steps
        free_arcsec = 1.0 + 1.1 * self.resolution_arcsec + self._timing.drift_arcsec_s * elapsed_s
        return self.beyond_drift_arcsec(before, after) > free_arcsec

    def _beyond_any_motor(self, before: Readout, after: Readout) -> float:
        free_arcsec = self._timing.resting_free_arcsec(self.resolution_arcsec)
        reach_arcsec = self._timing.fastest_deg_s * 3600.0 * _elapsed_s(before, after) + free_arcsec
        return max(0.0, apart_arcsec(before.place, after.place) - reach_arcsec)

    def _beyond_its_pace(self, before: Readout, after: Readout) -> float:
        elapsed_s = _elapsed_s(before, after)
        rate = max(self._speed_after_arcsec_s(elapsed_s), HAND_DEG_S * 3600.0)
        free_arcsec = _LEAP_DEG * 3600.0 + 2.0 * self.resolution_arcsec
        return max(0.0, apart_arcsec(before.place, after.place) - free_arcsec - rate * elapsed_s)

    def _steady_motion(self, first: Readout, second: Readout, third: Readout) -> bool:
        """Whether three readings lie on one motion of constant speed in one direction."""
        one, two = _elapsed_s(first, second), _elapsed_s(second, third)
        if one <= 0.0 or two <= 0.0 or second.doubtful:
            return False
        ab, bc = apart_arcsec(first.place, second.place), apart_arcsec(second.place, third.place)
        free_arcsec = 2.0 * self.resolution_arcsec
        straight = ab + bc - apart_arcsec(first.place, third.place) <= free_arcsec + _MOST_BEND * (ab + bc)
        faster = max(ab / one, bc / two)
        alike = abs(ab / one - bc / two) <= _SPEEDS_ALIKE * faster + free_arcsec / min(one, two)
        return straight and alike and faster <= self._timing.fastest_deg_s * 3600.0


def _elapsed_s(before: Readout, after: Readout) -> float:
    # the two coordinates are asked one after the other, and a moving mount goes on between them
    # (a question that was asked again took longer, but the mount moved no further for that)
    spans_s = min(before.span_s, _LONGEST_SPAN_S) + min(after.span_s, _LONGEST_SPAN_S)
    return max(0.0, (after.utc - before.utc).total_seconds()) + spans_s
