"""Looks until one is solved, or nothing is left that may be tried: the verdict chooses, the table bounds.

A neighbor field is the only tactic that moves anything; it goes through the checked mount like every slew,
and back again unless it was solved there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import Literal

from mountnav.errors import BadFrame, MountMoved, OutsideLimits, SolveFailed, SyncDoubt, SyncRefused
from mountnav.journal.records import EntryKind
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.look import (
    LookOptions,
    LookResult,
    RepeatedFrame,
    camera_stale,
    expose_and_solve,
    report_stale,
)
from mountnav.navigation.policy import (
    CHEAP,
    CenteringPolicy,
    Persistence,
    Tactic,
    Trouble,
    next_tactic,
    trouble_of,
    wait_s,
)
from mountnav.navigation.reports import Look
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced

MOST_UNPROVEN = 6
"""Solved frames of one place that may be taken until one is believed: a lag of the camera, a false solution
and a gust of wind in one look. Twice as many only delay the refusal."""

Go = Callable[[Icrs], Awaitable[object]]
"""Slews to a place, as the mount believes it, through all checks."""


@dataclass(frozen=True, slots=True)
class Seen:
    """A solved look, and where the mount was sent for it if that was a neighbor field."""

    look: Look
    neighbor: Icrs | None = None


def cheap(persistence: Persistence, frames: int) -> Persistence:
    """What a plain look may try: so many frames, longer or once more; nothing moves."""
    return replace(persistence, tactics=persistence.tactics & CHEAP, max_frames=frames)


_POOR = (Trouble.FEW_STARS, Trouble.POOR_FIELD, Trouble.WRONG_PLACE)
"""Troubles that a look beside the place may not have."""
_SEARCH = "; if it must be seen, order spiral-search: it looks round the place until a frame is solved"


class PersistentLook:
    """One look, with all that is tried to get it solved.

    Parameters
    ----------
    used : str
        What the look is for.
    go : callable, optional
        Slews, for neighbor fields; without it nothing moves.
    anywhere : bool
        Search the whole sky from the first frame on.
    teaches : bool
        Whether camera and pointing are learned from it.
    """

    def __init__(
        self,
        equipment: Equipment,
        policy: CenteringPolicy,
        persistence: Persistence,
        *,
        used: str,
        go: Go | None = None,
        anywhere: bool = False,
        teaches: bool = True,
    ) -> None:
        self._equipment = equipment
        self._policy = policy
        self._persistence = persistence
        self._go = go
        moving = frozenset() if go is not None else frozenset({Tactic.NEIGHBOR})
        self._allowed = persistence.tactics - moving
        self._used = Counter[Tactic]()
        blind: Literal["after"] | None = "after" if anywhere and equipment.solving.blind == "never" else None
        self._shot = LookOptions(
            policy.exposure_s, policy.search_radius_deg, blind, used=used, teaches=teaches
        )
        self._home: Icrs | None = None
        self._away: Icrs | None = None
        self._moved = 0

    async def look(self, exposure_s: float | None = None) -> Seen:
        """Look until it is solved.

        Parameters
        ----------
        exposure_s : float, optional
            Of the first frame, instead of the policy's.

        Raises
        ------
        SolveFailed
            Nothing is left to try; with the last verdict's reason and all that was tried.
        SyncRefused
            Its solved frames of one place don't agree: none is proven to show the present sky.
        CameraStale
            The camera hands out old frames.
        MountMoved, BadFrame
            It moved during each of some frames in a row, or they were of another time.
        DeviceError, OutsideLimits, JournalFailed
        """
        clock, policy = self._equipment.clock, self._policy
        if exposure_s is not None:
            self._shot = replace(self._shot, exposure_s=exposure_s)
        deadline = clock.monotonic_s() + self._persistence.max_s
        frames = unproven = 0
        while True:
            if policy.settle_s > 0:
                await clock.sleep(policy.settle_s)
                kill_point("look settled")
            frames += 1
            try:
                taken = await expose_and_solve(self._equipment, policy, self._shot, attempt=frames)
            except (MountMoved, BadFrame) as error:
                self._moved += 1
                repeated = isinstance(error, RepeatedFrame)
                if repeated:
                    await report_stale(self._equipment, error.what, times=self._moved)
                if self._moved > policy.moved_retries:
                    raise camera_stale(self._equipment, error.what) if repeated else error from None
                # it may still be settling, or the camera gave an old frame: not used, and another one taken
                await self._tell(Tactic.ANOTHER_FRAME, error.what, frames)
                continue
            self._moved = 0
            if taken.look is not None and not taken.doubt:
                return Seen(taken.look, self._away)
            if taken.look is not None:
                unproven += 1
                if unproven >= MOST_UNPROVEN:
                    raise self._unproven(taken, unproven)
                await self._tell(Tactic.ANOTHER_FRAME, taken.doubt, frames, solved=True)
                continue
            trouble = trouble_of(taken.verdict)
            tactic = next_tactic(trouble, self._used, self._allowed)
            if tactic is None or frames >= self._persistence.max_frames or clock.monotonic_s() >= deadline:
                await self._back()
                raise self._given_up(taken, frames)
            self._used[tactic] += 1
            await self._prepare(tactic, trouble, taken, deadline, frames)

    async def _prepare(
        self, tactic: Tactic, trouble: Trouble, taken: LookResult, deadline: float, frames: int
    ) -> None:
        """Do what the tactic asks before the next frame."""
        persistence, shot = self._persistence, self._shot
        await self._tell(tactic, str(trouble), frames)
        if tactic is not Tactic.NEIGHBOR:
            await self._back()
        match tactic:
            case Tactic.ANOTHER_FRAME:
                pass
            case Tactic.LONGER:
                longest = max(persistence.longest_exposure_s, shot.exposure_s)
                longer = min(shot.exposure_s * persistence.longer_by, longest)
                self._shot = replace(shot, exposure_s=longer)
            case Tactic.SHORTER:
                self._shot = replace(shot, exposure_s=shot.exposure_s / persistence.longer_by)
            case Tactic.WIDER:
                radius = min(180.0, shot.radius_deg * persistence.wider_by)
                self._shot = replace(shot, radius_deg=radius, scale="settings")
            case Tactic.BLIND:
                self._shot = replace(shot, blind="after", scale="any")
            case Tactic.WAIT:
                clock = self._equipment.clock
                wait = wait_s(persistence, self._used[Tactic.WAIT] - 1)
                await clock.sleep(max(0.0, min(wait, deadline - clock.monotonic_s())))
                kill_point("look waited")
            case Tactic.NEIGHBOR:
                await self._to_neighbor(taken)

    async def _to_neighbor(self, taken: LookResult) -> None:
        """Slew to the first neighbor field that is allowed; stay where no one is."""
        assert self._go is not None
        equipment = self._equipment
        if self._home is None:
            self._home = taken.believed
        width_deg = self._persistence.neighbor_deg
        scale = self._policy.scale_arcsec_px
        normal = equipment.guard.learned.normal
        if normal is not None:
            scale = normal.scale_arcsec_px
        if scale is not None:
            width_deg = self._persistence.neighbor_fields * scale * taken.width_px / 3600.0
        for place in self._neighbors(self._home, 3600.0 * width_deg):
            try:
                await self._go(place)
            except OutsideLimits:
                continue
            self._away = place
            kill_point("look at a neighbor field")
            return

    def _neighbors(self, home: Icrs, arcsec: float) -> list[Icrs]:
        """Places round one, along the declination first, so as not to cross a meridian; high ones first.

        The second time the sides of the first are passed over.
        """
        equipment, utc = self._equipment, self._equipment.clock.utc()

        def altitude_deg(place: Icrs) -> float:
            return icrs_to_observed(place, utc, equipment.site, equipment.air).alt_deg

        along = sorted((displaced(home, 0.0, sign * arcsec) for sign in (1, -1)), key=altitude_deg)
        across = sorted((displaced(home, sign * arcsec, 0.0) for sign in (1, -1)), key=altitude_deg)
        ways = [*reversed(along), *reversed(across)]
        return ways[self._used[Tactic.NEIGHBOR] - 1 :]

    async def _back(self) -> None:
        """Return from a neighbor field that didn't help either."""
        if self._away is None or self._home is None or self._go is None:
            return
        self._away = None
        await self._go(self._home)

    async def _tell(self, tactic: Tactic, why: str, frames: int, *, solved: bool = False) -> None:
        facts: dict[str, object] = {
            "tactic": str(tactic),
            "why": why,
            "frames": frames,
            "exposure_s": self._shot.exposure_s,
        }
        self._equipment.listen("tactic", facts)
        what = "solved, and not believed yet" if solved else "not solved"
        await self._equipment.note(EntryKind.DECISION, f"{what} ({why}): {tactic}", facts)
        kill_point("look tactic")

    def _unproven(self, taken: LookResult, frames: int) -> SyncRefused:
        return SyncRefused(
            f"{frames} frames of one field don't agree: {taken.doubt}",
            device=self._equipment.camera.name,
            advice="they moved and synced nothing; does the tube keep still (wind, tracking)? look "
            "again when it does; does the camera hand out old frames?",
            doubts=(SyncDoubt.NOT_FRESH,),
        )

    def _given_up(self, taken: LookResult, frames: int) -> SolveFailed:
        verdict = taken.verdict
        tried = ", ".join(f"{tactic} × {count}" for tactic, count in self._used.items())
        return SolveFailed(
            f"{frames} frame(s) could not be identified: {verdict.reason} ({verdict.detail})"
            + (f"; tried: {tried}" if tried else ""),
            device=self._equipment.camera.name,
            advice="nothing was synced; check focus, cloud, exposure and the configured scale"
            + (_SEARCH if trouble_of(verdict) in _POOR and self._equipment.trusted else ""),
            reason=str(verdict.reason),
        )


__all__ = ["Go", "PersistentLook", "Seen", "cheap"]
