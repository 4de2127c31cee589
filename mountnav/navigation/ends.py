"""When there is no use in going on with a centering, and what that end is called."""

from __future__ import annotations

from mountnav.errors import NotReached, SyncDoubt, SyncRefused, TargetNotReached
from mountnav.navigation.polar_steering import Hole
from mountnav.navigation.policy import Approach, CenteringPolicy
from mountnav.navigation.steering import Followed
from mountnav.navigation.syncing import SyncDecision
from mountnav.navigation.tries import Tries
from mountnav.pointing.offset import TooFarToSync

DOUBTFUL_LOOKS = 2
"""So many looks in a row may be doubted, and taken anew, before a centering ends."""
_ADVICE = (
    "nothing was moved or synced by it; look again; if the mount is really that far off, as after it was set "
    "up anew, order first light"
)
STUCK_TRIES = 2
ELSEWHERE_TRIES = 3
NEARER = 0.7
"""A correction that leaves less than this share of what the target was off is no slip. Doubled, whatever
slips a little would be followed to the last try."""


class Ends:
    """Counts what goes wrong in one centering.

    Parameters
    ----------
    name : str
        The telescope's.
    policy : CenteringPolicy
    tries : Tries
    tolerance_arcsec : float

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
            f"frames of one place were solved {apart_arcsec:.0f}″ apart, {self._doubted} times",
            device=self._name,
            advice="nothing was moved or synced by them; does the mount track, and does the tube hold still "
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


__all__ = ["Ends"]
