"""The rotator of a telescope: within its cable limits, written down, and stopped as the mount is.

Its count is an angle of its mechanism, brought to where its cables allow: between `least_deg` and `most_deg`,
at most a turn apart. A turn goes by legs, each shorter than half a turn, so that no rotator goes the other
way round; one that does so all the same is stopped. What its count is worth is seen by solves alone: after
power-up it may be anything, and so may be how the cables lie.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mountnav.clock import Clock
from mountnav.devices import Rotator, RotatorReading
from mountnav.errors import (
    BadSettings,
    Cancelled,
    DeviceError,
    DeviceRefused,
    NotReached,
    Refusal,
    TargetNotReached,
)
from mountnav.journal.records import Entry, EntryKind, Journal, Outcome
from mountnav.navigation.camera import apart_deg
from mountnav.navigation.reports import Listener, Turn

__all__ = ["CheckedRotator", "RotatorRules", "legs", "nearest_within", "within_limits"]

ABOUT, TURN = "rotator", "rotator-turn"
"""What the facts of such entries say under `about`."""
LEG_DEG = 120.0
"""A turn goes by legs of no more than this, °: the shortest way to their ends is the way that is meant.
Doubled, a rotator that takes the shortest way goes the other way round."""
_SLACK_DEG = 0.5
"""A count this far outside of the cable limits is still at them, °: rotators rest a step beside. Doubled,
limits are 1° wide."""
_WRONG_WAY_DEG = 5.0
"""After so much on the wrong way a turn is stopped, °: readings jitter by less. Doubled, cables are wound
up by twice as much before that."""
SENSE_FROM_DEG = 3.0
"""From turns of so much the sense is learned, °. Doubled, small corrections teach nothing of it."""
_LOST_DEG = 3.0
"""A solve that shows the camera this far from where the count says means that the count was lost, °: rotators
repeat to 0.1°, and polar errors turn the field by less. Doubled, a count lost by 5° is believed."""


@dataclass(frozen=True, slots=True)
class RotatorRules:
    """What an operator says of a rotator.

    Attributes
    ----------
    least_deg, most_deg : float
        Cable limits of its count; at most a turn apart. Its readings are brought between them.
    sense : {1, -1} or None
        Whether the position angle grows with the count; None: learned by solves.
    tolerance_deg : float
        A position angle so near counts as reached.
    derotates : bool
        Whether it turns with the field where the mount turns that.
    """

    least_deg: float = 0.0
    most_deg: float = 360.0
    sense: int | None = None
    tolerance_deg: float = 0.5
    derotates: bool = True

    def __post_init__(self) -> None:
        numbers = (self.least_deg, self.most_deg, self.tolerance_deg)
        if not all(math.isfinite(value) for value in numbers):
            raise BadSettings(f"rotator: {numbers} are not angles")
        if not 0.0 < self.most_deg - self.least_deg <= 360.0:
            raise BadSettings(
                f"rotator: cable limits {self.least_deg:g}° to {self.most_deg:g}°",
                advice="the lower one first, and at most a turn apart: its count doesn't tell more",
            )
        if self.sense not in (None, 1, -1):
            raise BadSettings(f"rotator: sense = {self.sense}", advice="1 or -1; left out, it is learned")
        if not 0.0 < self.tolerance_deg <= 45.0:
            raise BadSettings(f"rotator: tolerance_deg = {self.tolerance_deg:g}", advice="0 to 45")


def within_limits(mechanical_deg: float, rules: RotatorRules, near_deg: float | None = None) -> float | None:
    """A reading brought between the cable limits; None if it lies in the gap between them.

    Parameters
    ----------
    near_deg : float, optional
        Where it stood before: at the seam of a whole turn it may be either end.
    """
    low, high = rules.least_deg - _SLACK_DEG, rules.most_deg + _SLACK_DEG
    lowest = mechanical_deg + 360.0 * math.ceil((low - mechanical_deg) / 360.0)
    found = [angle for angle in (lowest, lowest + 360.0) if angle <= high]
    if not found:
        return None
    middle = (rules.least_deg + rules.most_deg) / 2.0
    about = middle if near_deg is None else near_deg
    return min(found, key=lambda angle: abs(angle - about))


def nearest_within(
    stands_deg: float, by_deg: float, rules: RotatorRules, modulo_deg: float = 360.0
) -> float | None:
    """Where to turn for the camera to be turned by an angle; None if nowhere is allowed.

    The nearest of all places within the cable limits that differ by the modulo: the shortest way, or if that
    leads over a limit, the safe way round.

    Parameters
    ----------
    by_deg : float
        By its count.
    modulo_deg : float
        180 if it doesn't matter which side of the image is up.
    """
    first = stands_deg + by_deg
    first += modulo_deg * math.ceil((rules.least_deg - first) / modulo_deg)
    count = int((rules.most_deg - first) // modulo_deg) + 1
    found = [first + modulo_deg * number for number in range(max(0, count))]
    return min(found, key=lambda angle: abs(angle - stands_deg), default=None)


def legs(from_deg: float, to_deg: float) -> list[float]:
    """The ends of a turn's legs, each `LEG_DEG` long at most."""
    count = max(1, math.ceil(abs(to_deg - from_deg) / LEG_DEG - 1e-9))
    return [from_deg + (to_deg - from_deg) * number / count for number in range(1, count + 1)]


@dataclass
class CheckedRotator:
    """The one way to a telescope's rotator.

    Parameters
    ----------
    rotator : Rotator
        The driver; from now on nobody else may use it.

    Attributes
    ----------
    sense : int or None
        As solves have shown it, else as it was stated.
    sense_seen : bool
        Whether a solve has shown it.
    zero_deg : float or None
        Angle of the image's +y from the mount's north, in the posture that looks west, at the count 0.
    zero_modulo_deg : float
        What that is known modulo.
    seen : bool
        Whether a solve has shown its count to be right since it was switched on, or connected.
    turning : bool
        Whether it turns by our order.
    lost : str
        Why its count, and so how its cables lie, isn't believed; empty if nothing speaks against it.
    """

    rotator: Rotator
    rules: RotatorRules
    telescope: str
    clock: Clock
    journal: Journal
    listen: Listener
    sense: int | None = None
    sense_seen: bool = False
    zero_deg: float | None = None
    zero_modulo_deg: float = 360.0
    seen: bool = False
    lost: str = ""
    _stood_deg: float | None = field(default=None, repr=False)
    _reversed: bool | None = field(default=None, repr=False)
    _links: int | None = field(default=None, repr=False)
    _stops: int = field(default=0, repr=False)
    turning: bool = field(default=False, repr=False)
    _open: bool = field(default=False, repr=False)

    def __post_init__(self) -> None:
        self.sense = self.rules.sense

    @property
    def name(self) -> str:
        """Name and address, for messages."""
        return self.rotator.name

    async def open(self) -> None:
        """Connect. Never turns it. Raises `DeviceError`."""
        self._open = False
        await self.rotator.open()
        # it may have been switched off meanwhile
        self._open, self.seen, self._stood_deg = True, False, None

    async def close(self) -> None:
        """Release it."""
        self._open = False
        await self.rotator.close()

    async def standing_deg(self) -> float:
        """Its count, between the cable limits.

        Raises
        ------
        DeviceRefused
            It stands outside of them, or is still turning.
        DeviceError
        """
        if not self._open:
            # it was missing when the telescope was opened
            await self.open()
        reading = await self.rotator.reading()
        self._heed(reading)
        if reading.moving:
            raise DeviceRefused(
                f"it is turning, at {reading.mechanical_deg:.1f}°, and mountnav has not ordered it",
                device=self.name,
                advice="wait for it, or stop it",
                reason=Refusal.BUSY,
            )
        stands_deg = within_limits(reading.mechanical_deg, self.rules, self._stood_deg)
        if stands_deg is None:
            raise DeviceRefused(
                f"it stands at {reading.mechanical_deg:.1f}°, outside of its cable limits "
                f"{self.rules.least_deg:g}° to {self.rules.most_deg:g}°: how its cables lie is not known",
                device=self.name,
                advice="look at the cables, turn it back by its own program, or correct the limits",
                reason=Refusal.LIMIT,
            )
        self._stood_deg = stands_deg
        return stands_deg

    def _heed(self, reading: RotatorReading) -> None:
        """Take note of a connection that was opened again, and of a driver that counts otherwise."""
        links: int | None = getattr(self.rotator, "links", None)
        if links != self._links:
            # it may have been switched off meanwhile, and count from anywhere
            self._links, self.seen, self._stood_deg = links, False, None
        now: bool | None = getattr(self.rotator, "reversed", None)
        before, self._reversed = self._reversed, now
        if before is None or now is None or before is now:
            return
        words = (
            f"{self.name}: its driver counts {'reversed' if now else 'straight'} from now on: what was "
            "learned of it counts no more"
        )
        self.sense, self.sense_seen, self.zero_deg, self.seen = None, False, None, False
        self._note(EntryKind.FAULT, words, {"mechanical_deg": reading.mechanical_deg, "reversed": now})
        self.listen("rotator-reversed", {"words": words, "reversed": now})

    # -- turning -----------------------------------------------------------------------------------

    def require_counted(self) -> None:
        """Refuse to turn one whose count a solve has disproved. Raises `DeviceRefused`."""
        if self.lost:
            raise DeviceRefused(
                f"{self.lost}: how its cables lie is not known",
                device=self.name,
                advice="look at the cables and set its count right in its own program; or order rotate with "
                "trust_count, if they lie as its count says now",
                reason=Refusal.UNTRUSTED,
            )

    async def turn_to(self, to_deg: float) -> Turn:
        """Turn to a count between the cable limits, by legs.

        Raises
        ------
        DeviceRefused
            The limits don't allow it, its count was disproved, or it said no.
        TargetNotReached
            It did not move, or came to rest elsewhere; or it went the other way round, and was stopped.
        Cancelled
            A stop came.
        DeviceError, JournalFailed
        """
        self.require_counted()
        rules, began_s, stops = self.rules, self.clock.monotonic_s(), self._stops
        if not rules.least_deg - _SLACK_DEG <= to_deg <= rules.most_deg + _SLACK_DEG:
            raise DeviceRefused(
                f"{to_deg:.1f}° is outside of its cable limits {rules.least_deg:g}° to {rules.most_deg:g}°",
                device=self.name,
                advice="it was not turned",
                reason=Refusal.LIMIT,
            )
        from_deg = await self.standing_deg()
        facts: dict[str, object] = {"from_deg": from_deg, "to_deg": to_deg, "rotator": self.name}
        self.listen("turning", dict(facts))
        self.turning = True
        try:
            here_deg = await self._along(legs(from_deg, to_deg), from_deg, stops)
        finally:
            self.turning = False
        turn = Turn(from_deg, to_deg, here_deg, self.clock.monotonic_s() - began_s)
        self.listen("turned", {**facts, "came_deg": here_deg, "elapsed_s": turn.elapsed_s})
        return turn

    async def _along(self, ends: list[float], here_deg: float, stops: int) -> float:
        for leg_deg in ends:
            if stops != self._stops:
                raise Cancelled(
                    "the turn was stopped", device=self.name, advice="order it again when it is safe"
                )
            here_deg = await self._leg(here_deg, leg_deg)
        return here_deg

    async def _leg(self, from_deg: float, to_deg: float) -> float:
        words = f"{self.name}: turning from {from_deg:.2f}° to {to_deg:.2f}°"
        facts: dict[str, object] = {"about": TURN, "from_deg": from_deg, "to_deg": to_deg}
        # first on the disk, then on the wire
        await self._write(EntryKind.NOTE, words, facts)

        def watch(now: RotatorReading) -> None:
            moved_deg = apart_deg(now.mechanical_deg, from_deg)
            self._stood_deg = from_deg + moved_deg
            if moved_deg * (to_deg - from_deg) < 0.0 and abs(moved_deg) > _WRONG_WAY_DEG:
                raise TargetNotReached(
                    f"it was to turn from {from_deg:.1f}° to {to_deg:.1f}° and went the other way round, to "
                    f"{now.mechanical_deg:.1f}°: it was stopped",
                    device=self.name,
                    advice="it doesn't take the shortest way: set cable limits that it never has to turn "
                    "through 0° for, as least_deg = 0 and most_deg = 360",
                    reason=NotReached.OTHER,
                )

        try:
            came = await self.rotator.turn(to_deg % 360.0, seen=watch)
        except BaseException as error:
            outcome = str(_outcome_of(error))
            self._note(EntryKind.FAULT, f"{words}: {error or outcome}", facts | {"outcome": outcome})
            raise
        came_deg = from_deg + apart_deg(came.mechanical_deg, from_deg)
        self._stood_deg = came_deg
        done: dict[str, object] = {"outcome": str(Outcome.DONE), "came_deg": came_deg}
        await self._write(EntryKind.NOTE, f"{self.name}: turned to {came_deg:.2f}°", facts | done)
        return came_deg

    async def stop(self) -> None:
        """Stop it now. Raises `DeviceError` if that couldn't be sent, or wasn't seen."""
        self._stops += 1
        self._note(EntryKind.NOTE, f"{self.name}: stop", {"about": TURN, "stop": True})
        await self.rotator.stop()

    # -- what solves show of it --------------------------------------------------------------------

    def shown(self, stands_deg: float, camera_deg: float, modulo_deg: float) -> str:
        """Take in how a solve shows the camera at a count; why the count isn't believed, if so.

        Parameters
        ----------
        stands_deg : float
            Its count.
        camera_deg : float
            Angle of the image's +y from the mount's north, in the posture that looks west.
        modulo_deg : float
            What that is known modulo.
        """
        if self.sense is None:
            return ""
        zero_deg = (camera_deg - self.sense * stands_deg) % modulo_deg
        if self.zero_deg is not None and not self.lost:
            common = min(modulo_deg, self.zero_modulo_deg)
            off_deg = apart_deg(zero_deg, self.zero_deg, common)
            if abs(off_deg) > _LOST_DEG and not self.seen:
                self.lost = (
                    f"its count was lost since it was seen last: it says {stands_deg:.1f}°, and the image "
                    f"stands {off_deg:+.1f}° from where it stood at that count (or the camera was "
                    "turned in its "
                    "holder, or the mount tells the wrong side of the pier)"
                )
                self._note(EntryKind.FAULT, f"{self.name}: {self.lost}", {"off_deg": off_deg})
                self.listen("rotator-untrusted", {"words": self.lost})
                return self.lost
        if self.lost:
            return self.lost
        known = self.zero_deg is not None and self.seen
        self.zero_deg, self.zero_modulo_deg, self.seen = zero_deg, modulo_deg, True
        if not known:
            self._note(EntryKind.SETTINGS, f"{self.name}: its count is seen to be right", self.as_dict())
        return ""

    def turned(self, by_deg: float, image_deg: float) -> str:
        """Take in a turn and what a solve shows of it: what is wrong with it in words, or nothing.

        Parameters
        ----------
        by_deg : float
            By its count.
        image_deg : float
            By how much the image turned, its position angle; within half a turn.
        """
        # a turn the long way round is one of some degrees to the image; a whole one is none
        turned_deg = abs(apart_deg(by_deg, 0.0))
        if turned_deg < SENSE_FROM_DEG:
            return ""
        if abs(image_deg) < 0.1 * turned_deg:
            return (
                f"it says that it turned by {by_deg:+.1f}°, and the image turned by "
                f"{image_deg:+.2f}°: does the "
                "camera sit on it, is a clutch open?"
            )
        shown = 1 if abs(apart_deg(image_deg, by_deg)) < abs(apart_deg(image_deg, -by_deg)) else -1
        if abs(apart_deg(2.0 * by_deg, 0.0)) < 2.0 * SENSE_FROM_DEG:
            # half a turn looks alike in both senses
            if self.sense is None:
                return ""
            shown = self.sense
        words = ""
        if self.rules.sense is not None and self.rules.sense != shown and self.sense != shown:
            words = (
                f"the settings say that position angles "
                f"{'grow' if self.rules.sense > 0 else 'shrink'} with its "
                f"count, and the sky shows the other sense: set sense = {shown}"
            )
        elif not self.sense_seen and self.sense == shown:
            self.sense_seen = True
            self._note(EntryKind.SETTINGS, f"{self.name}: sense {shown:+d} by a solve", self.as_dict())
        if self.sense != shown:
            self.sense, self.sense_seen, self.zero_deg = shown, True, None
            self._note(EntryKind.SETTINGS, f"{self.name}: sense {shown:+d} by a solve", self.as_dict())
        off_deg = apart_deg(image_deg, shown * by_deg)
        if abs(off_deg) > max(1.0, 0.05 * turned_deg):
            slipped = (
                f"it turned by {by_deg:+.1f}° by its count, and the image by {image_deg:+.1f}°: a "
                "slip, or its "
                "steps per turn are set wrongly"
            )
            words = f"{words}; {slipped}" if words else slipped
            self.zero_deg = None
        return words

    def trust(self) -> None:
        """An operator's word that its cables lie as its count says."""
        self.lost, self.zero_deg, self.seen = "", None, False
        words = f"{self.name}: its count is trusted on an operator's word"
        self._note(EntryKind.SETTINGS, words, self.as_dict())

    def as_dict(self) -> dict[str, object]:
        """What is known of it, as JSON values."""
        return {
            "about": ABOUT,
            "sense": self.sense if self.sense_seen else None,
            "zero_deg": self.zero_deg,
            "zero_modulo_deg": self.zero_modulo_deg,
        }

    def restore(self, entries: Iterable[Entry]) -> None:
        """Take over from the journal what was known of it.

        Parameters
        ----------
        entries : iterable of Entry
            The oldest first.
        """
        for entry in entries:
            facts: Mapping[str, object] = entry.facts
            if entry.telescope != self.telescope or facts.get("about") != ABOUT:
                continue
            sense, zero, modulo = (facts.get(name) for name in ("sense", "zero_deg", "zero_modulo_deg"))
            if sense in (1, -1):
                self.sense, self.sense_seen = (1 if sense == 1 else -1), True
            self.zero_deg = float(zero) if isinstance(zero, int | float) else None
            self.zero_modulo_deg = 180.0 if modulo == 180.0 else 360.0

    async def _write(self, kind: EntryKind, words: str, facts: Mapping[str, object]) -> None:
        await self.journal.note(Entry(self.clock.utc(), self.telescope, kind, words, dict(facts)))

    def _note(self, kind: EntryKind, words: str, facts: Mapping[str, object]) -> None:
        self.journal.note_now(Entry(self.clock.utc(), self.telescope, kind, words, dict(facts)))


def _outcome_of(error: BaseException) -> Outcome:
    if isinstance(error, Cancelled):
        return Outcome.STOPPED
    if isinstance(error, DeviceRefused):
        return Outcome.REFUSED
    if isinstance(error, TargetNotReached):
        return Outcome.IGNORED if error.reason is NotReached.STUCK else Outcome.STALLED
    return Outcome.UNKNOWN if isinstance(error, DeviceError) else Outcome.STOPPED
