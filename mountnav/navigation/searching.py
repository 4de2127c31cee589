"""A spiral search: looks round a place, one step after the other, until one of them is solved.

For a target that must be seen, where frames don't solve: a field too poor for the catalogs, a gap in the
clouds, a narrow field that the mount misses by more than its width. Nobody begins one but by an order.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from itertools import islice

from mountnav.errors import (
    BadFrame,
    BadRequest,
    DeviceRefused,
    MountMoved,
    OutsideLimits,
    SolveFailed,
    SyncRefused,
)
from mountnav.journal.records import EntryKind
from mountnav.navigation.aim_points import frame_size_of
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.look_retries import PersistentLook, cheap
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import CenterReport, Look
from mountnav.navigation.slewing import Slewing
from mountnav.sky.coordinates import Icrs
from mountnav.sky.patterns import spiral
from mountnav.sky.sphere import separation_arcsec

__all__ = ["SearchBounds", "SearchReport", "field_deg", "search"]

_FRAMES = 1
"""Frames of each step: where stars are, one is enough. Doubled, a search takes twice as long."""
_STEPS_A_LOOK = 10
"""So many steps there are at most for each look that is allowed: what lies beyond the limits is passed over,
and each such step is a line of the journal. Halved, a search in a corner between two limits may end with
looks to spare."""


@dataclass(frozen=True, slots=True)
class SearchBounds:
    """How far a search goes.

    Attributes
    ----------
    radius_deg : float
        Round the target.
    step_share : float
        Of the field's shorter side: between two neighboring looks.
    field_deg : float or None
        That side; None: by what was learned of the camera.
    """

    radius_deg: float = 1.0
    step_share: float = 0.7
    field_deg: float | None = None
    most_looks: int = 50
    most_s: float = 1800.0

    def __post_init__(self) -> None:
        if not 0.0 < self.radius_deg <= 10.0:
            raise BadRequest(f"a search of {self.radius_deg}°", advice="above 0, at most 10")
        if not 0.1 <= self.step_share <= 1.0:
            raise BadRequest(f"steps of {self.step_share} of a field", advice="0.1 to 1")
        if self.field_deg is not None and not 0.001 <= self.field_deg <= 60.0:
            raise BadRequest(f"a field of {self.field_deg}°", advice="0.001 to 60")
        if not 1 <= self.most_looks <= 1000 or not 0.0 < self.most_s <= 14_400.0:
            raise BadRequest(
                f"{self.most_looks} looks, {self.most_s} s", advice="at most 1000 looks and four hours"
            )


@dataclass(frozen=True, slots=True)
class SearchReport:
    """A search that found something.

    Attributes
    ----------
    looks : int
        Taken, the solved one included.
    passed_over : int
        Steps that the limits don't allow.
    found_arcsec : float
        How far from the target the solved frame was.
    centered : CenterReport
        What came of the centering after it.
    """

    looks: int
    passed_over: int
    found_arcsec: float
    found: Look
    centered: CenterReport
    elapsed_s: float


def field_deg(equipment: Equipment, policy: CenteringPolicy) -> tuple[float, float] | None:
    """Width and height of the look camera's field, °, by what was learned; None if that isn't enough."""
    size = frame_size_of(equipment.guard.camera)
    normal = equipment.guard.learned.normal
    scale = policy.scale_arcsec_px if normal is None else normal.scale_arcsec_px
    if size is None or scale is None:
        return None
    return size.width_px * scale / 3600.0, size.height_px * scale / 3600.0


async def search(
    equipment: Equipment,
    slewing: Slewing,
    policy: CenteringPolicy,
    target: Icrs,
    bounds: SearchBounds,
    center: Callable[[], Awaitable[CenterReport]],
    exposure_s: float | None = None,
) -> SearchReport:
    """Search, and center what was found.

    Parameters
    ----------
    center : callable
        Centers the target, once a frame was solved.

    Raises
    ------
    SolveFailed
        Nothing was solved within the bounds; the mount was sent back to the target.
    BadRequest
        How large the field is isn't known.
    OutsideLimits
        The target itself isn't allowed; nothing moved.
    Cancelled, TargetNotReached, DeviceError, JournalFailed
    """
    clock = equipment.clock
    began_s = clock.monotonic_s()
    known = field_deg(equipment, policy)
    side_deg = bounds.field_deg if bounds.field_deg is not None else None if known is None else min(known)
    looks = passed_over = 0
    places = iter([target]) if side_deg is None else _places(target, bounds, side_deg)
    last = "no look was taken"
    while (place := next(places, None)) is not None:
        if looks >= bounds.most_looks or clock.monotonic_s() - began_s >= bounds.most_s:
            break
        if (refused := await _refused(slewing, place)) is not None:
            if looks + passed_over == 0:
                raise refused
            passed_over += 1
            continue
        looks += 1
        off_arcsec = separation_arcsec(place, target)
        found, why = await _looked(equipment, policy, exposure_s)
        facts: dict[str, object] = {
            "number": looks,
            "ra_deg": place.ra_deg,
            "dec_deg": place.dec_deg,
            "from_target_arcsec": off_arcsec,
            "solved": found is not None,
            "why": why,
        }
        equipment.listen("search-step", dict(facts))
        if found is not None:
            words = f"spiral search: solved at look {looks}, {off_arcsec:.0f}″ from the target"
            await equipment.note(EntryKind.DECISION, words, facts)
            seen_arcsec = separation_arcsec(found.seen, target)
            centered = await center()
            elapsed_s = clock.monotonic_s() - began_s
            return SearchReport(looks, passed_over, seen_arcsec, found, centered, elapsed_s)
        last = why
        if side_deg is None:
            # the first frame has told how large it is
            known = field_deg(equipment, policy)
            if known is None:
                raise BadRequest(
                    "how large the field is isn't known: no frame was solved with this camera yet, and no "
                    "scale is set",
                    device=equipment.name,
                    advice="give field_deg, or set the telescope's scale_arcsec_px",
                )
            side_deg = min(known)
            places = islice(_places(target, bounds, side_deg), 1, None)
    stays = await _refused(slewing, target)
    over = f"; {passed_over} step(s) beyond the limits were passed over" if passed_over else ""
    words = (
        f"nothing was solved in {looks} looks within {bounds.radius_deg:g}° round the target{over}; "
        f"at last: {last}"
    )
    await equipment.note(EntryKind.DECISION, f"spiral search: {words}", {"looks": looks})
    raise SolveFailed(
        words,
        device=equipment.name,
        advice=(
            "the mount was sent back to the target"
            if stays is None
            else f"the mount was not sent back to the target ({stays.what})"
        )
        + "; check for clouds, dew, focus and the lens cap, or "
        "search further (radius_deg, most_looks, most_s, exposure_s)",
        reason="not found",
    )


def _places(target: Icrs, bounds: SearchBounds, side_deg: float) -> Iterator[Icrs]:
    """The steps, the target first: a wide search by small fields has millions, and few are ever come to."""
    steps = spiral(target, bounds.step_share * side_deg, bounds.radius_deg)
    return islice(steps, _STEPS_A_LOOK * bounds.most_looks)


async def _refused(slewing: Slewing, place: Icrs) -> OutsideLimits | DeviceRefused | None:
    """Slew there; or why it isn't allowed, by our limits or by the mount's own."""
    try:
        await slewing.slew(place, slewing.aimed(place, await slewing.side_at(place)))
    except OutsideLimits as error:
        return error
    except DeviceRefused as error:
        if not error.of_place:
            raise
        return error
    return None


async def _looked(
    equipment: Equipment, policy: CenteringPolicy, exposure_s: float | None
) -> tuple[Look | None, str]:
    """A look that is solved, or why it wasn't."""
    persistence = cheap(policy.persistence, _FRAMES)
    looking = PersistentLook(equipment, policy, persistence, used="spiral search")
    try:
        return (await looking.look(exposure_s)).look, ""
    except (SolveFailed, SyncRefused, MountMoved, BadFrame) as error:
        return None, error.what
