"""The field of an alt-azimuth mount, which turns as it tracks: how fast is told, and a rotator turns with it.

::

    first look: how the image stands, at which count -> turned as the sky turns -> looks set it right

How the image stands only looks show. Between them the rotator goes by how the zenith turns round the target:
an angle that is known. It goes where its cables allow, by the short way alone: a turn the long way round in
the middle of a picture would be worse than a field that turns. So at a limit it ends, and that is said
beforehand.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from mountnav.errors import MountnavError
from mountnav.journal.records import EntryKind
from mountnav.navigation.aim_points import MountFrame
from mountnav.navigation.camera import apart_deg
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.reports import Look
from mountnav.navigation.rotating import heed_rotator
from mountnav.navigation.rotator import CheckedRotator
from mountnav.sky.coordinates import Icrs
from mountnav.tasks import begun, fault_words

__all__ = ["Derotation", "turning_deg_h"]

STEP_SHARE = 0.2
"""The rotator goes on when the image is off by this share of its tolerance: 0.1° of the usual 0.5°, 2 px at
the corner of a frame of 2,000. Halved, it turns, and is written down, twice as often."""
LONGEST_S, SHORTEST_S = 60.0, 1.0
"""Between two turns, s, at most and at least. Shortest doubled, a field near the zenith is 0.2° more off."""
RATE_OVER_S = 30.0
"""How fast a field turns is taken over so much time, s. Tenfold, it is smeared where it changes near the
zenith."""
AHEAD_S, SAMPLES = 6.0 * 3600.0, 120
"""So far ahead the cables are looked at, s, where no end is known, and at so many instants. Doubled, a cable
limit in the far end of the night is foretold."""
SETS_RIGHT_SHARE = 0.5
"""What a look shows to be off is made good by this share: solves know an angle to 0.02° or so. Doubled, the
rotator follows their noise."""


def turning_deg_h(
    place: Callable[[datetime], Icrs], utc: datetime, frame: Callable[[datetime], MountFrame]
) -> float:
    """How fast the position angle of a field grows that nothing turns back, °/h."""
    later = utc + timedelta(seconds=RATE_OVER_S)
    before, after = frame(utc).rotation_deg(place(utc), 0.0), frame(later).rotation_deg(place(later), 0.0)
    return apart_deg(after, before) * 3600.0 / RATE_OVER_S


@dataclass(frozen=True, slots=True)
class _Held:
    """An image as a look showed it, and at which count it stood."""

    position_angle_deg: float
    camera_deg: float
    count_deg: float


class Derotation:
    """Keeps the field of one target as the first look shows it, if the mount turns it and there is a rotator.

    Parameters
    ----------
    path : callable
        Where the target is.
    ends_utc : datetime or None
        Until when; None: not known.
    """

    def __init__(
        self, equipment: Equipment, path: Callable[[datetime], Icrs], ends_utc: datetime | None = None
    ) -> None:
        self._equipment, self._path, self._ends = equipment, path, ends_utc
        self._rotator: CheckedRotator | None = equipment.rotator
        self._held: _Held | None = None
        self._told: set[str] = set()
        self._begun, self._over = asyncio.Event(), False
        self._task: asyncio.Task[None] | None = None
        self.notes: list[str] = []

    @property
    def turns(self) -> bool:
        """Whether this mount turns its field."""
        return self._equipment.mount.mounting == "altaz"

    # -- its life ------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Turn from the first look on, in a task of its own."""
        if self._rotator is not None and not self._rotator.rules.derotates:
            self._over = True  # another program does
        elif self.turns and self._rotator is not None:
            self._task = begun(self._run(), "derotation", died=lambda fault: self._say(fault_words(fault)))

    def cease(self) -> None:
        """Order no turn any more, from this moment on: a stop came, or it is over."""
        self._over = True
        if self._task is not None:
            self._task.cancel()

    async def end(self) -> None:
        """Turn no more; a turn under way is stopped."""
        self.cease()
        task, self._task = self._task, None
        if task is not None:
            await asyncio.gather(task, return_exceptions=True)

    async def seen(self, look: Look) -> None:
        """Take in how the image stands."""
        if not self.turns or self._over:
            return
        utc = look.mid_exposure_utc
        rate_deg_h = turning_deg_h(self._path, utc, self._frame)
        rotator = self._rotator
        if rotator is None:
            corner_px = 0.5 * math.hypot(look.width_px, look.height_px)
            px_min = corner_px * math.radians(abs(rate_deg_h) / 60.0)
            self._say(
                f"the field turns by {rate_deg_h:+.1f}° an hour, {px_min:.1f} px a minute at a corner of the "
                "frame (alt-azimuth mount, no rotator)",
                once="rate",
            )
            return
        if rotator.turning:
            return  # how it stood in the middle of the exposure isn't known
        try:
            count_deg = await rotator.standing_deg()
            doubt = await heed_rotator(self._equipment, rotator, look)
        except MountnavError as error:
            self._give_up(error.what)
            return
        if doubt:
            self._give_up(doubt)
        elif rotator.sense is None:
            self._give_up("which way the image turns with its count isn't known yet: order rotate once")
        elif self._held is None:
            camera_deg = self._frame(utc).angle_deg(look.seen, look.solution.rotation_deg)
            self._held = _Held(look.solution.rotation_deg, camera_deg, count_deg)
            self._foretell(rate_deg_h, rotator)
            self._begun.set()
        else:
            off_deg = apart_deg(look.solution.rotation_deg, self._held.position_angle_deg)
            wanted_deg = self._held.count_deg - SETS_RIGHT_SHARE * rotator.sense * off_deg
            self._held = _Held(self._held.position_angle_deg, self._held.camera_deg, wanted_deg)

    # -- turning -------------------------------------------------------------------------------------

    async def _run(self) -> None:
        rotator, clock = self._rotator, self._equipment.clock
        assert rotator is not None
        await self._begun.wait()
        step_deg = max(STEP_SHARE * rotator.rules.tolerance_deg, rotator.rotator.step_deg)
        while not self._over:
            now = clock.utc()
            rate_deg_s = turning_deg_h(self._path, now, self._frame) / 3600.0
            step_s = min(LONGEST_S, max(SHORTEST_S, step_deg / max(abs(rate_deg_s), 1e-9)))
            # to the middle of the time until the next turn: it is off by half a step at most
            wanted_deg = self._count_at(now + timedelta(seconds=0.5 * step_s))
            try:
                stands_deg = await rotator.standing_deg()
                by_deg = apart_deg(wanted_deg, stands_deg)
                if abs(by_deg) >= 0.5 * step_deg:
                    if not rotator.rules.least_deg <= stands_deg + by_deg <= rotator.rules.most_deg:
                        self._give_up(
                            f"its cables allow no more than {rotator.rules.least_deg:g}° to "
                            f"{rotator.rules.most_deg:g}°: from here on the field turns by "
                            f"{rate_deg_s * 3600.0:+.1f}° an hour"
                        )
                        return
                    await self._turn(rotator, stands_deg + by_deg)
            except MountnavError as error:
                self._give_up(error.what)
                return
            await clock.sleep(step_s)

    async def _turn(self, rotator: CheckedRotator, to_deg: float) -> None:
        learned = self._equipment.guard.learned
        try:
            turn = await rotator.turn_to(to_deg)
        except BaseException:
            # how the camera stands now solves have to show anew
            learned.turned(None)
            raise
        learned.turned(None if rotator.sense is None else rotator.sense * turn.by_deg)

    def _count_at(self, utc: datetime) -> float:
        """At which count the image stands as it is held; not brought between the limits."""
        held, rotator = self._held, self._rotator
        assert held is not None
        assert rotator is not None
        camera_deg = self._frame(utc).angle_deg(self._path(utc), held.position_angle_deg)
        return held.count_deg + (rotator.sense or 1) * apart_deg(camera_deg, held.camera_deg)

    def _foretell(self, rate_deg_h: float, rotator: CheckedRotator) -> None:
        """Say how fast the field turns, and until when the cables allow to turn with it."""
        now, before = self._equipment.clock.utc(), 0.0
        ends = self._ends or now + timedelta(seconds=AHEAD_S)
        assert self._held is not None
        until = ""
        for number in range(1, SAMPLES + 1):
            utc = now + (ends - now) * number / SAMPLES
            turned = before + apart_deg(self._count_at(utc) - self._held.count_deg, before)
            before = turned
            count_deg = self._held.count_deg + turned
            if not rotator.rules.least_deg <= count_deg <= rotator.rules.most_deg:
                until = f"; its cables allow that until {utc:%H:%M} UTC"
                break
        self._say(
            f"the field turns by {rate_deg_h:+.1f}° an hour, and the rotator with it{until}", once="rate"
        )

    # -- small things --------------------------------------------------------------------------------

    def _frame(self, utc: datetime) -> MountFrame:
        return MountFrame(self._equipment.mount.mounting, utc, self._equipment.site)

    def _give_up(self, why: str) -> None:
        self._over = True
        self._say(f"the rotator doesn't turn with the field: {why}")

    def _say(self, words: str, once: str = "") -> None:
        if (once or words) in self._told:
            return
        self._told.add(once or words)
        self.notes.append(words)
        self._equipment.note_now(EntryKind.DECISION, words, {"about": "derotation"})
        self._equipment.listen("derotation", {"words": words})
