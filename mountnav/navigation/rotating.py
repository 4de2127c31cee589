"""A field brought to a position angle: by what solves show, turn by turn, until they show it there.

No angle of the rotator's is believed for where north is. A look shows how the image stands; the rotator turns
by what is missing; the next look shows what came of it, and teaches its sense.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from mountnav.devices import PierSide
from mountnav.errors import BadRequest, DeviceRefused, NotReached, Refusal, TargetNotReached
from mountnav.journal.records import EntryKind
from mountnav.navigation.aim_points import MountFrame
from mountnav.navigation.camera import apart_deg
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.reports import Look, Rotation, Turn
from mountnav.navigation.rotator import SENSE_FROM_DEG, CheckedRotator, nearest_within

__all__ = ["FieldAngle", "Rotating", "angle_off_deg", "heed_rotator", "require_angle"]

MOST_TURNS = 5
"""So many turns are made for one position angle: one to learn the sense, one to come there, the others for
play and steps. Doubled, a slipping camera is turned for twice as long before that is said."""
_FIRST_DEG = 20.0
"""No turn before the sense is known goes further, °: it may go the wrong way. Doubled, so do cables."""
_WORSE_DEG = 2.0
"""A turn that brings the image this much further from its angle than it was, °, with the sense known,
counts as a failure. Chosen by hand: above what polar errors turn a field between two looks. Doubled, a
slipping camera is turned on."""


@dataclass(frozen=True, slots=True)
class FieldAngle:
    """How an image is to stand.

    Attributes
    ----------
    position_angle_deg : float
        Of the image's +y, or of the direction of the point that the target is brought to.
    tolerance_deg : float or None
        None: the rotator's own.
    either_way : bool
        Whether it may stand on its head as well.
    """

    position_angle_deg: float
    tolerance_deg: float | None = None
    either_way: bool = False

    @property
    def modulo_deg(self) -> float:
        """What counts as the same angle."""
        return 180.0 if self.either_way else 360.0


def angle_off_deg(shown_deg: float, wanted: FieldAngle) -> float:
    """By how much the image must be turned yet, north through east."""
    return apart_deg(wanted.position_angle_deg, shown_deg, wanted.modulo_deg)


Shown = tuple[float, Look]
"""A position angle as a look showed it."""


@dataclass
class Rotating:
    """Turns one telescope's field.

    Parameters
    ----------
    rotator : CheckedRotator or None
        None where there is none: what stands rightly already is fine all the same.
    """

    equipment: Equipment
    rotator: CheckedRotator | None
    notes: list[str] = field(default_factory=list)

    async def bring(
        self, wanted: FieldAngle, first: Shown, again: Callable[[], Awaitable[Shown]]
    ) -> Rotation:
        """Turn until a look shows the angle.

        Parameters
        ----------
        first : Shown
            As it stands now.
        again : callable
            Looks again, after a turn.

        Raises
        ------
        DeviceRefused
            There is no rotator; its cable limits don't allow it; its count was disproved by a solve; it said
            no.
        TargetNotReached
            It didn't turn, or the image didn't; or the angle isn't reached after some turns.
        Cancelled, DeviceError, JournalFailed
            And what `again` raises.
        """
        shown_deg, found = first
        before_deg, turns = shown_deg, list[Turn]()
        tolerance_deg = self.tolerance_deg(wanted)
        if self.rotator is not None:
            await self._seen(self.rotator, found)
        while abs(off_deg := angle_off_deg(shown_deg, wanted)) > tolerance_deg:
            rotator = self._needed(wanted, off_deg, tolerance_deg)
            if len(turns) >= MOST_TURNS:
                raise self._given_up(wanted, off_deg, tolerance_deg, len(turns))
            known = rotator.sense_seen
            turn = await self._turn(rotator, off_deg, wanted)
            turns.append(turn)
            latest_deg, found = await again()
            image_deg = apart_deg(latest_deg, shown_deg)
            words = rotator.turned(turn.by_deg, image_deg)
            self._say(words)
            # a turn the long way round is one of some degrees to the image
            turned_deg = abs(apart_deg(turn.by_deg, 0.0))
            if turned_deg >= SENSE_FROM_DEG and abs(image_deg) < 0.1 * turned_deg:
                raise TargetNotReached(
                    words,
                    device=rotator.name,
                    advice="look at it before the next turn",
                    reason=NotReached.STUCK,
                )
            left_deg = angle_off_deg(latest_deg, wanted)
            worse = abs(left_deg) > abs(off_deg) + _WORSE_DEG
            if worse and known and rotator.sense is not None and not words:
                raise self._given_up(wanted, left_deg, tolerance_deg, len(turns))
            shown_deg = latest_deg
            await self._seen(rotator, found)
        rotation = Rotation(
            wanted.position_angle_deg,
            before_deg,
            shown_deg,
            off_deg,
            tolerance_deg,
            tuple(turns),
            None if self.rotator is None else self.rotator.sense,
            tuple(self.notes),
        )
        if turns:
            what = f"the field is at {shown_deg:.2f}° ({off_deg:+.2f}° off) after {len(turns)} turn(s)"
            await self.equipment.note(EntryKind.DECISION, what, _facts(rotation))
        return rotation

    def tolerance_deg(self, wanted: FieldAngle) -> float:
        """The tolerance that is kept: never less than what the rotator's steps allow."""
        rotator = self.rotator
        own_deg = 0.5 if rotator is None else rotator.rules.tolerance_deg
        asked_deg = own_deg if wanted.tolerance_deg is None else wanted.tolerance_deg
        floor_deg = 0.0 if rotator is None else 0.75 * rotator.rotator.step_deg
        if asked_deg < floor_deg:
            self._say(
                f"a tolerance of {asked_deg:g}° was asked for; the rotator's steps of "
                f"{2.0 * floor_deg / 1.5:g}° allow {floor_deg:.2f}°, which was kept"
            )
        return max(asked_deg, floor_deg)

    def _needed(self, wanted: FieldAngle, off_deg: float, tolerance_deg: float) -> CheckedRotator:
        if self.rotator is None:
            raise DeviceRefused(
                f"the image is {off_deg:+.1f}° from the position angle {wanted.position_angle_deg:.1f}° "
                f"(tolerance {tolerance_deg:g}°), and there is no rotator to turn it",
                device=self.equipment.name,
                advice="turn the camera by hand by that angle, north through east, or allow it "
                "(tolerance_deg, either_way); a rotator stands in [telescope.rotator]",
                reason=Refusal.UNSUPPORTED,
            )
        return self.rotator

    async def _turn(self, rotator: CheckedRotator, off_deg: float, wanted: FieldAngle) -> Turn:
        stands_deg = await rotator.standing_deg()
        rules, modulo_deg, by_deg = rotator.rules, wanted.modulo_deg, off_deg
        sense = rotator.sense or 1
        if rotator.sense is None and abs(off_deg) > _FIRST_DEG:
            by_deg, modulo_deg = (_FIRST_DEG if off_deg > 0.0 else -_FIRST_DEG), 720.0
        to_deg = nearest_within(stands_deg, sense * by_deg, rules, modulo_deg)
        if to_deg is None and rotator.sense is None:
            # a small turn either way teaches the sense
            ways = (nearest_within(stands_deg, step, rules, 720.0) for step in (_FIRST_DEG, -_FIRST_DEG))
            to_deg = next((way for way in ways if way is not None), None)
        if to_deg is None:
            raise DeviceRefused(
                f"the position angle {wanted.position_angle_deg:.1f}° would need its count to be at "
                f"{(stands_deg + sense * by_deg) % 360.0:.1f}°, outside of the cable limits "
                f"{rules.least_deg:g}° to {rules.most_deg:g}°"
                + (
                    ""
                    if rotator.sense_seen
                    else " (by the sense that is stated, and that no solve has shown)"
                ),
                device=rotator.name,
                advice="it was not turned; choose another angle"
                + ("" if wanted.either_way else ", or allow the image to stand on its head (either_way)"),
                reason=Refusal.LIMIT,
            )
        if abs(to_deg - stands_deg) > 180.0:
            self._say(f"turned the long way round, by {to_deg - stands_deg:+.0f}°: the cables allow no other")
        equipment = self.equipment
        try:
            turn = await rotator.turn_to(to_deg)
        except BaseException:
            # how the camera stands now solves have to show again
            equipment.guard.learned.turned(None)
            raise
        equipment.guard.learned.turned(None if rotator.sense is None else rotator.sense * turn.by_deg)
        return turn

    async def _seen(self, rotator: CheckedRotator, found: Look) -> None:
        self._say(await heed_rotator(self.equipment, rotator, found))

    def _given_up(
        self, wanted: FieldAngle, off_deg: float, tolerance_deg: float, turns: int
    ) -> TargetNotReached:
        assert self.rotator is not None
        why = f": {'; '.join(self.notes)}" if self.notes else ""
        return TargetNotReached(
            f"the image is {off_deg:+.2f}° from the position angle "
            f"{wanted.position_angle_deg:.1f}° after "
            f"{turns} turn(s) (tolerance {tolerance_deg:g}°){why}",
            device=self.rotator.name,
            advice="does the camera sit firmly on it? has it play, or are its steps per turn set wrongly? "
            "allow a larger tolerance_deg",
            reason=NotReached.SLIPPING,
        )

    def _say(self, words: str) -> None:
        if words and words not in self.notes:
            self.notes.append(words)


async def heed_rotator(equipment: Equipment, rotator: CheckedRotator, found: Look) -> str:
    """Hold what a look shows of the camera against the rotator's count; why it isn't believed, if so.

    Raises
    ------
    DeviceError
        It doesn't say how it stands.
    """
    learned, side = equipment.guard.learned, found.after.side
    frame = MountFrame(learned.rules.mounting, found.mid_exposure_utc, equipment.site)
    camera_deg = frame.angle_deg(found.seen, found.solution.rotation_deg)
    modulo_deg = 360.0
    if learned.rules.mounting not in ("fork", "altaz"):
        modulo_deg = 180.0 if side is PierSide.UNKNOWN else 360.0
        camera_deg -= 180.0 if side is PierSide.WEST else 0.0
    return rotator.shown(await rotator.standing_deg(), camera_deg, modulo_deg)


def _facts(rotation: Rotation) -> dict[str, object]:
    return {
        "about": "field rotation",
        "wanted_deg": rotation.wanted_deg,
        "before_deg": rotation.before_deg,
        "after_deg": rotation.after_deg,
        "off_deg": rotation.off_deg,
        "tolerance_deg": rotation.tolerance_deg,
        "turns": [
            {"from_deg": turn.from_deg, "to_deg": turn.to_deg, "came_deg": turn.came_deg}
            for turn in rotation.turns
        ],
        "sense": rotation.sense,
        "notes": list(rotation.notes),
    }


def require_angle(wanted: FieldAngle) -> None:
    """Refuse what is no angle. Raises `BadRequest`."""
    if not -360.0 <= wanted.position_angle_deg <= 360.0:
        raise BadRequest(f"a position angle of {wanted.position_angle_deg}°", advice="0 to 360")
    if wanted.tolerance_deg is not None and not 0.0 < wanted.tolerance_deg <= 90.0:
        raise BadRequest(f"tolerance_deg = {wanted.tolerance_deg}", advice="above 0, at most 90")
