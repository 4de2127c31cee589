"""The tries of a centering: each look with its numbers, what was done about it, and what came of that."""

from __future__ import annotations

import math
from dataclasses import replace

from mountnav.devices import SyncOutcome
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.reports import Correction, Look, Try
from mountnav.navigation.steering import Followed
from mountnav.sky.sphere import Offset, separation_arcsec

STEP_SHARE = 0.75
"""A place rounded to steps in both coordinates is off by half a step's diagonal (0.71) at most."""


def tolerance_kept(asked_arcsec: float, resolution_arcsec: float) -> tuple[float, str | None]:
    """The tolerance that a mount of this resolution can keep, and what to say about it.

    A place is sent in steps; demanding less than they allow would hunt for ever [POINTING §3.8].
    """
    floor = STEP_SHARE * resolution_arcsec
    if asked_arcsec >= floor:
        return asked_arcsec, None
    return floor, (
        f"a tolerance of {asked_arcsec:g}″ was asked for; the mount's steps of {resolution_arcsec:g}″ allow "
        f"{floor:.1f}″, which was kept"
    )


class Tries:
    """The tries so far.

    Parameters
    ----------
    equipment : Equipment
    """

    def __init__(self, equipment: Equipment) -> None:
        self._equipment = equipment
        self._began_s = 0.0
        self.all: list[Try] = []

    def __len__(self) -> int:
        return len(self.all)

    @property
    def latest(self) -> Try:
        """The last one."""
        return self.all[-1]

    @property
    def since_best(self) -> int:
        """How many tries ago the error was smallest."""
        errors = [one.error_arcsec for one in self.all]
        return len(errors) - 1 - errors.index(min(errors))

    @property
    def best_arcsec(self) -> float:
        """The smallest error so far."""
        return min(one.error_arcsec for one in self.all)

    def begin(self) -> None:
        """Time runs from here for the next try."""
        self._began_s = self._equipment.clock.monotonic_s()

    def add(
        self, found: Look, error: Offset, followed: Followed, expected: float | None, *, approached: bool
    ) -> None:
        """Keep a look; it is also what came of the try before."""
        if self.all:
            self.all[-1] = replace(self.all[-1], after_arcsec=error.total_arcsec)
        solution = found.solution
        self.all.append(
            Try(
                number=len(self.all) + 1,
                seen=found.seen,
                error_arcsec=error.total_arcsec,
                east_arcsec=error.east_arcsec,
                north_arcsec=error.north_arcsec,
                pairs=solution.pairs,
                rms_arcsec=solution.rms_arcsec,
                false_probability=solution.false_probability,
                synced=False,
                sync_outcome=None,
                slewed=False,
                elapsed_s=0.0,
                expected_arcsec=expected,
                sigma_arcsec=self.sigma_arcsec(found),
                followed=str(followed),
                approached=approached,
                look_id=found.look_id,
            )
        )

    def seen_again(self, found: Look, error: Offset) -> None:
        """The latest look was taken anew at the same place, and is what counts."""
        self.all[-1] = replace(
            self.all[-1],
            seen=found.seen,
            error_arcsec=error.total_arcsec,
            east_arcsec=error.east_arcsec,
            north_arcsec=error.north_arcsec,
            pairs=found.solution.pairs,
            rms_arcsec=found.solution.rms_arcsec,
            false_probability=found.solution.false_probability,
            sigma_arcsec=self.sigma_arcsec(found),
            look_id=found.look_id,
        )
        if len(self.all) > 1:
            self.all[-2] = replace(self.all[-2], after_arcsec=error.total_arcsec)

    def close(
        self,
        correction: Correction,
        why: str,
        *,
        slewed: bool,
        sync_outcome: SyncOutcome | None = None,
    ) -> None:
        """The try is over: tell it."""
        self.all[-1] = replace(
            self.all[-1],
            synced=correction is Correction.SYNC,
            sync_outcome=sync_outcome,
            slewed=slewed,
            elapsed_s=self._equipment.clock.monotonic_s() - self._began_s,
            correction=correction,
            why=why,
        )
        self._equipment.listen("attempt", try_facts(self.all[-1]))

    def sigma_arcsec(self, found: Look) -> float:
        """Of the error seen: the solve's, and what the mount moved during the exposure beyond one step."""
        moved = separation_arcsec(from_mount(found.before.place), from_mount(found.after.place))
        beyond = max(0.0, moved - self._equipment.mount.resolution_arcsec)
        solved = found.solution.center_sigma_arcsec
        return math.hypot(solved if math.isfinite(solved) else 0.0, beyond)

    def noise_arcsec(self, found: Look) -> float:
        """How far off the next look may be, one sigma, if all goes well: the solve, and the mount's steps."""
        steps = math.sqrt(1.0 / 6.0) * self._equipment.mount.resolution_arcsec
        return math.hypot(math.sqrt(2.0) * self.sigma_arcsec(found), steps)


def try_facts(one: Try) -> dict[str, object]:
    """A try for those who listen, and for the journal."""
    return {
        "number": one.number,
        "ra_deg": one.seen.ra_deg,
        "dec_deg": one.seen.dec_deg,
        "error_arcsec": one.error_arcsec,
        "east_arcsec": one.east_arcsec,
        "north_arcsec": one.north_arcsec,
        "pairs": one.pairs,
        "rms_arcsec": one.rms_arcsec,
        "false_probability": one.false_probability,
        "synced": one.synced,
        "sync_outcome": None if one.sync_outcome is None else str(one.sync_outcome),
        "slewed": one.slewed,
        "elapsed_s": one.elapsed_s,
        "after_arcsec": one.after_arcsec,
        "expected_arcsec": one.expected_arcsec,
        "sigma_arcsec": one.sigma_arcsec,
        "correction": str(one.correction),
        "why": one.why,
        "followed": one.followed,
        "approached": one.approached,
        "look_id": one.look_id,
    }


__all__ = ["Tries", "tolerance_kept", "try_facts"]
