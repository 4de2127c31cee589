"""Placing the frames of a night: the first of a field fully, the rest by their shift, in a thread.

What the rules are given of a placed frame is made here as well.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.ephemeris import Ephemeris
from mountnav.frames import Frame, Hint
from mountnav.navigation.equipment import Solve
from mountnav.navigation.reports import Look
from mountnav.night.events import FrameSeen, PlateSeen
from mountnav.night.frames_in import Arrived
from mountnav.night.parking import FrameLooked
from mountnav.night.rules import begun_utc
from mountnav.series.results import FrameResult, Mode, SeriesSettings, Shift
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, offset_arcsec, separation_arcsec
from mountnav.solution import Reason, Solution, Times, Verdict
from mountnav.solving.settings import SolveSettings

if TYPE_CHECKING:
    from mountnav.series.follow import SeriesFollower


FIELDS_KEPT = 4
"""So many fields are remembered, each with the follower of its stars. Chosen by hand: a night goes to and fro
between a few. Halved, a scheduler with three targets in turn has each frame identified fully."""
FRAMES_PER_FOLLOWER = 100
"""Then the field is identified fully again, and what was remembered of it is let go: memory doesn't grow.
Chosen by hand: a hundred minutes of a frame a minute. Doubled, so is that memory."""
UNKNOWN_FIELD_DEG = 0.5
"""Radius that a field is taken to have before a frame of it was identified, °. Chosen by hand. Doubled,
neighbor targets up to 1° apart are taken for one field until then."""
OTHER_PLACE_DEG = 0.5
"""A header that names a place further from the mount's belief is asked too, when the belief leads nowhere, °.
Chosen by hand. Doubled, a header that is right and 0.8° away isn't tried."""


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a frame of a night lies.

    Attributes
    ----------
    fully : bool
        Identified fully, not only by its shift.
    field : str
        Name of the field; frames of one field lie within half a frame of its first.
    shift : Shift or None
        Against the frame it was followed from.
    """

    verdict: Verdict
    fully: bool
    field: str
    shift: Shift | None = None


class Placing(Protocol):
    """Who says where frames lie."""

    async def place(self, frame: Frame, near: Icrs | None, *, fully: bool) -> Placed:
        """Identify a frame.

        Parameters
        ----------
        near : Icrs or None
            Where the mount believed to be.
        fully : bool
            Fully, whatever is known of the field.
        """
        ...


async def placed_by(placing: Placing, frame: Frame, near: Icrs | None, *, fully: bool) -> Placed:
    """Identify a frame; its header's place is asked where the mount's belief led nowhere.

    Parameters
    ----------
    near : Icrs or None
        Where the mount believed to be.
    """
    placed = await placing.place(frame, near, fully=fully)
    told = frame.hint.center
    elsewhere = near and told and separation_arcsec(near, told) > 3600.0 * OTHER_PLACE_DEG
    if placed.verdict.solution is None and elsewhere:
        again = await placing.place(frame, told, fully=True)
        placed = again if again.verdict.solution is not None else placed
    return placed


@dataclass(slots=True)
class _Field:
    name: str
    center: Icrs | None
    radius_deg: float
    follower: SeriesFollower
    fully: bool
    frames: int = 0


class BySeries:
    """Follows each field of a night by a `SeriesFollower`.

    Parameters
    ----------
    hint : callable
        Makes the hint for a full solution from where the mount believed to be.
    """

    def __init__(
        self,
        catalog: Catalog,
        hint: Callable[[Icrs | None], Hint | None],
        settings: SeriesSettings | None = None,
    ) -> None:
        self._catalog = catalog
        self._hint = hint
        self._settings = settings or SeriesSettings()
        self._fields: OrderedDict[str, _Field] = OrderedDict()
        self._turn = asyncio.Lock()

    async def place(self, frame: Frame, near: Icrs | None, *, fully: bool) -> Placed:
        """Identify a frame in a thread; the next one waits for it."""
        async with self._turn:
            return await asyncio.to_thread(self._place, frame, near, fully)

    def _place(self, frame: Frame, near: Icrs | None, fully: bool) -> Placed:
        field = self._field(near, fully)
        result = field.follower.add(frame)
        field.frames += 1
        verdict = _verdict(result)
        solution = verdict.solution
        if solution is None:
            return Placed(verdict, False, field.name)
        if field.center is None or _apart_deg(field.center, solution.center) > field.radius_deg:
            self._fields.pop(field.name, None)
            field.name, field.center = field_name(solution.center), solution.center
            field.radius_deg = _half_a_frame_deg(frame, solution)
        self._fields[field.name] = field
        self._fields.move_to_end(field.name)
        while len(self._fields) > FIELDS_KEPT:
            self._fields.popitem(last=False)
        return Placed(verdict, result.mode is Mode.FULL, field.name, result.shift)

    def _field(self, near: Icrs | None, fully: bool) -> _Field:
        """The field that a frame is believed to be of."""
        # brings scipy and all that measures and identifies: a service starts without
        from mountnav.series.follow import SeriesFollower

        known = None
        for field in reversed(self._fields.values()):
            if near is None or (
                field.center is not None and _apart_deg(field.center, near) <= field.radius_deg
            ):
                known = field
                break
        if known is not None and known.fully == fully and known.frames < FRAMES_PER_FOLLOWER:
            return known
        settings = replace(self._settings, audit_every=1) if fully else self._settings
        hint = self._hint(near if near is not None or known is None else known.center)
        follower = SeriesFollower(self._catalog, hint=hint, settings=settings)
        if known is None:
            return _Field("", None, UNKNOWN_FIELD_DEG, follower, fully)
        known.follower, known.fully, known.frames = follower, fully, 0
        return known


class BySolve:
    """Identifies each frame fully, by a solver; for worlds without pixels and for solutions known before.

    Parameters
    ----------
    hint : callable
        As of `BySeries`.
    """

    def __init__(
        self, solve: Solve, hint: Callable[[Icrs | None], Hint | None], settings: SolveSettings | None = None
    ) -> None:
        self._solve = solve
        self._hint = hint
        self._settings = settings or SolveSettings()
        self._center: Icrs | None = None
        self._radius_deg = UNKNOWN_FIELD_DEG

    async def place(self, frame: Frame, near: Icrs | None, *, fully: bool) -> Placed:
        """Solve it."""
        verdict = await self._solve(frame, self._hint(near) or frame.hint, self._settings)
        solution = verdict.solution
        if solution is None:
            return Placed(verdict, False, "" if self._center is None else field_name(self._center))
        if self._center is None or _apart_deg(self._center, solution.center) > self._radius_deg:
            self._center, self._radius_deg = solution.center, _half_a_frame_deg(frame, solution)
        return Placed(verdict, True, field_name(self._center))


def field_name(center: Icrs) -> str:
    """Name of a field, by the place of its first frame."""
    return f"{center.ra_deg:07.3f}{center.dec_deg:+07.3f}"


def _verdict(result: FrameResult) -> Verdict:
    """What the follower says, as a solver would."""
    times = result.times
    spent = Times(
        measure_s=times.measure_s,
        identify_s=times.preliminary_s + times.full_s,
        total_s=times.measure_s + times.preliminary_s + times.full_s,
    )
    told = "; ".join(result.notes)
    if result.solution is not None:
        return Verdict(result.solution, None, told, result.measured, spent)
    reason = next(
        (known for known in Reason if any(known.value in note for note in result.notes)), Reason.NO_MATCH
    )
    return Verdict(None, reason, told, result.measured, spent)


def _apart_deg(one: Icrs, other: Icrs) -> float:
    return separation_arcsec(one, other) / 3600.0


def _half_a_frame_deg(frame: Frame, solution: Solution) -> float:
    return 0.5 * float(np.hypot(frame.width_px, frame.height_px)) * solution.scale_arcsec_px / 3600.0


@dataclass(frozen=True, slots=True)
class Seen:
    """A frame that was read, placed and compared."""

    frame: Frame
    placed: Placed
    looked: FrameLooked

    def event(self, arrived: Arrived, utc: datetime, *, moving: bool, segment: str) -> FrameSeen:
        """What the rules are given at `utc`.

        Parameters
        ----------
        moving : bool
            Whether the telescope is at work.
        segment : str
            Of the mount.
        """
        solution = self.placed.verdict.solution
        look = self.looked.look
        error, sigma = _error(look, solution, arrived.target)
        return FrameSeen(
            utc=utc,
            frame_id=arrived.frame_id,
            arrived_utc=arrived.arrived_utc,
            mid_utc=self.frame.mid_exposure_utc,
            begun_utc=begun_utc(self.frame.mid_exposure_utc, self.frame.exposure_s),
            held=arrived.held,
            placed=solution is not None,
            fully=self.placed.fully,
            plate=None if solution is None else _plate(solution, self.frame),
            error=error,
            of_target=arrived.target is not None,
            sigma_arcsec=sigma,
            doubts=tuple(str(doubt) for doubt in self.looked.doubts),
            moving=moving,
            field=self.placed.field,
            segment=segment,
            detail=self.looked.why if solution is not None else _why_not(self.placed),
        )


def _error(
    look: Look | None, solution: Solution | None, target: Icrs | Ephemeris | None
) -> tuple[Offset | None, float]:
    """What the telescope is off, and how well that is known."""
    if look is None or solution is None:
        return None, 0.0
    if target is not None and not isinstance(target, Icrs):
        raise TypeError("a target that moves has no place without an instant: resolve it first")
    error = look.offset if target is None else offset_arcsec(look.seen, target)
    return error, solution.center_sigma_arcsec


def _plate(solution: Solution, frame: Frame) -> PlateSeen:
    size = frame.width_px, frame.height_px
    return PlateSeen(solution.scale_arcsec_px, solution.rotation_deg, solution.parity, size)


def _why_not(placed: Placed) -> str:
    verdict = placed.verdict
    reason = str(verdict.reason) if verdict.reason is not None else "not identified"
    return f"{reason} ({verdict.detail})" if verdict.detail and verdict.detail != reason else reason
