"""The tries of a centering: each look with its numbers, what was done about it, and when it gives up."""

from __future__ import annotations

import math
from dataclasses import replace

from mountnav.devices import SyncOutcome
from mountnav.errors import NotReached, SyncDoubt, SyncRefused, TargetNotReached
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.policy import Approach, CenteringPolicy
from mountnav.navigation.reports import Correction, Look, Try
from mountnav.navigation.steering import Followed, Hole
from mountnav.navigation.sync import SyncDecision
from mountnav.pointing.offset import TooFarToSync
from mountnav.sky.sphere import Offset

__all__ = ["StopRules", "Tries", "tolerance_kept", "tolerance_widened", "try_facts"]


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


WIDEST = 3.0
"""A tolerance is widened to so many times what was asked for at most. Chosen by hand. Doubled, a target with
poor elements is called centered twice as far from where they have it."""


def tolerance_widened(tolerance_arcsec: float, sigma_arcsec: float) -> tuple[float, str | None]:
    """The tolerance for a target whose own place is uncertain, and what to say about it.

    To come nearer than its place is known costs tries and gains nothing.
    """
    if not sigma_arcsec > 0.0:
        return tolerance_arcsec, None
    widened = min(math.hypot(tolerance_arcsec, sigma_arcsec), WIDEST * tolerance_arcsec)
    if widened < 1.05 * tolerance_arcsec:
        return tolerance_arcsec, None
    return widened, (
        f"the target's place is uncertain by {sigma_arcsec:.3g}″ (one sigma): a tolerance of {widened:.3g}″ "
        f"was kept instead of {tolerance_arcsec:.3g}″"
    )


class Tries:
    """The tries so far."""

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
        """The latest look was taken again at the same place, and is what counts."""
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
        """The try is over: report it."""
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
        """Of the error seen: the look's, and what the mount moved during the exposure beyond one step."""
        beyond = max(0.0, found.mount_moved_arcsec - self._equipment.mount.resolution_arcsec)
        solved = found.sigma_arcsec
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


DOUBTFUL_LOOKS = 2
"""So many looks in a row may be doubted, and taken again, before a centering ends. Chosen by hand. Doubled,
clouds or a wrong scale cost two more exposures before that is said."""
_ADVICE = (
    "it moved and synced nothing; look again; if the mount is really that far off, as after it was set "
    "up again, order first light"
)
STUCK_TRIES = 2
"""After so many corrections that the tube did not follow a centering ends; after one more where it may take
up play first. Chosen by hand. Doubled, a blocked axis is driven twice as often before somebody hears of
it."""
ELSEWHERE_TRIES = 3
"""After so many corrections that ended elsewhere it ends. Chosen by hand. Doubled, a mount that somebody else
moves is followed for as long again."""
NEARER = 0.7
"""A correction that leaves less than this share of what the target was off is no slip. Doubled, whatever
slips a little would be followed to the last try."""


class StopRules:
    """Counts what goes wrong in one centering.

    Parameters
    ----------
    name : str
        The telescope's.

    Attributes
    ----------
    too_far : TooFarToSync or None
        What stood against the last look, when it was solved further off than the cap on syncs.
    """

    def __init__(self, name: str, policy: CenteringPolicy, tries: Tries, tolerance_arcsec: float) -> None:
        self._name = name
        self._policy = policy
        self._tries = tries
        self._tolerance = tolerance_arcsec
        self._stuck = self._elsewhere = self._doubted = 0
        self.too_far: TooFarToSync | None = None

    @property
    def last(self) -> bool:
        """Whether no further look is allowed."""
        return len(self._tries) >= self._policy.max_tries

    def followed(self, followed: Followed) -> None:
        """Take in whether the tube did what the last correction asked."""
        match followed:
            case Followed.STUCK:
                self._stuck += 1
            case Followed.ELSEWHERE if not self._comes_nearer():
                self._elsewhere += 1
            case Followed.YES:
                self._stuck = 0

    def _comes_nearer(self) -> bool:
        """Whether the last correction led much nearer, though not where it was sent.

        So it goes near the pole with a zero point some degrees off: each step is turned, and still halves
        what is left.
        """
        tried = self._tries.all
        return len(tried) > 1 and tried[-1].error_arcsec <= NEARER * tried[-2].error_arcsec

    def believed(self) -> None:
        """A look that nothing stands against: doubts before it don't count any more."""
        self._doubted, self.too_far = 0, None

    def doubted(self, decision: SyncDecision) -> SyncRefused | None:
        """A look that may be wrong moves nothing: None when another one is taken, else how it ends."""
        self._doubted += 1
        against = set(decision.against_the_sky)
        # several looks that agree are a new segment to the guard: it accepts the next one
        self.too_far = None
        if SyncDoubt.TOO_FAR in against:
            self.too_far = TooFarToSync(
                decision.why, device=self._name, advice=_ADVICE, doubts=decision.doubts
            )
        patient = self._doubted <= DOUBTFUL_LOOKS or against == {SyncDoubt.NOT_EXPECTED}
        if patient and not self.last:
            return None
        return self.too_far or SyncRefused(
            decision.why, device=self._name, advice=_ADVICE, doubts=decision.doubts
        )

    def disagreed(self, apart_arcsec: float) -> SyncRefused | None:
        """Two frames of one place that disagree: one of them is wrong. None when others are taken."""
        self._doubted += 1
        if self._doubted <= DOUBTFUL_LOOKS and not self.last:
            return None
        return SyncRefused(
            f"frames of one field were solved {apart_arcsec:.0f}″ apart, {self._doubted} times",
            device=self._name,
            advice="they moved and synced nothing; does the mount track, and does the tube keep still "
            "(wind)? look again when it does",
            doubts=(SyncDoubt.ODDS,),
        )

    def why(self, followed: Followed, hole: Hole | None) -> TargetNotReached | None:
        """Why there is no use in going on; None while there is.

        Parameters
        ----------
        followed : Followed
            What came of the last correction.
        hole : Hole or None
            Round the mount's pole, with the target in it.
        """
        off, count = f"{self._tries.latest.error_arcsec:.0f}″", len(self._tries)
        approachable = self._policy.approach is not Approach.NEVER
        if hole is not None and hole.short_arcsec > self._tolerance:
            return self._end(
                f"{off} off: {hole.words}",
                hole.advice,
                NotReached.POLE,
            )
        if followed is Followed.STUCK and self._stuck >= STUCK_TRIES + approachable:
            return self._end(
                f"still {off} off: the mount says that it moved, and the tube did not follow "
                f"{self._stuck} corrections",
                "look at the mount: a clutch, a cable, an axis at its stop, much backlash",
                NotReached.STUCK,
            )
        if followed is Followed.ELSEWHERE and self._elsewhere >= ELSEWHERE_TRIES:
            worse = self._tries.latest.error_arcsec > self._tries.all[0].error_arcsec
            return self._end(
                f"{off} off: {self._elsewhere} corrections ended elsewhere than they were sent",
                "does a clutch slip, is something loose, is somebody else moving the mount?",
                NotReached.WORSE if worse else NotReached.SLIPPING,
            )
        if self.last:
            return self._end(
                f"still {off} off after {count} looks (tolerance {self._tolerance:.0f}″)",
                "does the mount's resolution allow this tolerance? is there backlash or slip?",
                NotReached.TRIES,
            )
        return None

    def _end(self, what: str, advice: str, reason: NotReached) -> TargetNotReached:
        return TargetNotReached(what, device=self._name, advice=advice, reason=reason)
