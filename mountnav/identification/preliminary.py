"""Preliminary identification: the shift between two lists that differ by nothing else [S23 §2.1, eq. 1-4]."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.odds import binomial_sf, strobe_chances
from mountnav.identification.settings import PreliminarySettings
from mountnav.identification.shift import Pairing, Sources, paired, rival_share, sources_of
from mountnav.measuring.measurements import Measurements

__all__ = ["Outcome", "Preliminary", "PreliminarySettings", "find_shift", "preliminary"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_STROBES = 4
"""Fewer strobes than this never prove a shift."""
STILL_PX = 1.0
"""A shift nearer to zero than this is also what hot pixels show. Chosen by hand."""
TESTED_BELOW = 0.1
"""Only hypotheses whose first odds, times all hypotheses so far, are below this are looked into."""
MOST_JUDGED = 20
"""After so many refused hypotheses the lists are taken for patterned, and the search ends. A limit of
time."""
FREE_SHARE = 0.15
"""Where strobes are crowded, one is advised that chance fills so seldom: as the measured profile has it."""
RIVAL_MOST = 0.6
"""Another shift that holds more than this share of the pairs makes both doubtful. Chosen by hand."""


class Outcome(StrEnum):
    """What came of a preliminary identification."""

    FOUND = "found"
    TOO_FEW = "too few measurements"
    NO_SHIFT = "no shift was acknowledged"
    CROWDED = "so crowded that strobes are filled by chance"
    CHANCE = "the best shift could be chance"
    AMBIGUOUS = "two shifts fit about equally well"


ADVICE = {
    Outcome.FOUND: "",
    Outcome.TOO_FEW: "expose longer, check focus and cloud",
    Outcome.NO_SHIFT: "the frame's assumed center is far off? solve it fully",
    Outcome.CROWDED: "take a narrower strobe (r_rej_px), or the measured profile",
    Outcome.CHANCE: "too few stars in common: solve the frame fully",
    Outcome.AMBIGUOUS: "hot pixels or a regular pattern? calibrate with a dark, solve the frame fully",
}
"""What the user can do about an outcome."""


@dataclass(frozen=True, slots=True)
class Preliminary:
    """A shift with its proof, or why there is none.

    Attributes
    ----------
    pairing : Pairing or None
        The pairs and their shift; x1 = x2 + shift [S23 eq. 1, 2]. None unless found.
    tries : int
        Selected measurements of the first list that were tried.
    hypotheses : int
        Conditional shifts that were weighed.
    strobes, acknowledged : int
        Of the best hypothesis: strobes, and how many of them held a measurement (N_ack).
    chance_share : float
        Share of the strobes that chance would fill.
    false_probability : float
        That some wrong shift would have been acknowledged so well.
    narrower_px : float
        Radius of a strobe that chance fills in 15 % here; 0 unless crowded.
    """

    outcome: Outcome
    pairing: Pairing | None
    tries: int = 0
    hypotheses: int = 0
    strobes: int = 0
    acknowledged: int = 0
    chance_share: float = 0.0
    false_probability: float = 1.0
    narrower_px: float = 0.0

    @property
    def found(self) -> bool:
        """Whether there is a shift."""
        return self.pairing is not None

    @property
    def share(self) -> float:
        """Share of the strobes that were acknowledged."""
        return self.acknowledged / self.strobes if self.strobes else 0.0

    @property
    def detail(self) -> str:
        """The numbers behind the outcome, and what can be done, for people."""
        if self.outcome is Outcome.TOO_FEW:
            return f"{self.outcome}: {self.strobes} usable, {LEAST_STROBES} needed ({ADVICE[self.outcome]})"
        numbers = (
            f"{self.acknowledged} of {self.strobes} strobes acknowledged, "
            f"{100 * self.chance_share:.0f} % would be by chance; {self.tries} tries, "
            f"{self.hypotheses} hypotheses, false-positive probability {self.false_probability:.0e}"
        )
        advice = ADVICE[self.outcome]
        if self.narrower_px > 0:
            advice += f"; r_rej_px = {self.narrower_px:.1f} leaves {100 * FREE_SHARE:.0f} % to chance here"
        return f"{self.outcome}: {numbers}" + (f" ({advice})" if advice else "")


def preliminary(
    first: Measurements, second: Measurements, settings: PreliminarySettings | None = None
) -> Preliminary:
    """Find the shift between two frames of one telescope, camera, rotation and scale.

    Parameters
    ----------
    settings : PreliminarySettings, optional
        The paper's values by default.

    Returns
    -------
    Preliminary
        With (1, 2): the second frame's positions plus the shift are the first's.
    """
    settings = settings or PreliminarySettings()
    return find_shift(sources_of(first, settings), sources_of(second, settings), settings)


def find_shift(
    first: Sources, second: Sources, settings: PreliminarySettings, *, same_chip: bool = True
) -> Preliminary:
    """Find the shift between two prepared lists.

    Parameters
    ----------
    first, second : Sources
        Prepared with the same settings; either may be catalog stars projected into pixels.
    same_chip : bool
        Both come from one camera, so that hot pixels may stand at the same positions.
    """
    if min(first.proposing.size, second.proposing.size) < LEAST_STROBES:
        return Preliminary(
            Outcome.TOO_FEW, None, strobes=int(min(first.proposing.size, second.proposing.size))
        )
    search = _Search(first, second, settings, same_chip)
    for number in range(min(settings.tries, first.proposing.size)):
        found = search.attempt(number)
        if found is not None:
            return found
    return search.refusal()


class _Search:
    """One search: the hypotheses that were tried, and the refusal that got farthest."""

    def __init__(
        self, first: Sources, second: Sources, settings: PreliminarySettings, same_chip: bool
    ) -> None:
        self._first, self._second, self._settings, self._same_chip = first, second, settings, same_chip
        self._radius_px = first.strobe_px(second, settings)
        self._strobes = np.column_stack((first.x_px[first.proposing], first.y_px[first.proposing]))
        self._partners = np.column_stack((second.x_px[second.proposing], second.y_px[second.proposing]))
        self._share = self._local_share(self._radius_px)
        self._chance = float(self._share.mean())
        self._tries = 0
        self._judged_so_far = 0
        self._hypotheses = 0
        self._best = Preliminary(Outcome.NO_SHIFT, None, chance_share=self._chance)

    def attempt(self, number: int) -> Preliminary | None:
        """Pair one selected measurement with each of the second list [S23 §2.1, steps 2-5]."""
        self._tries += 1
        shifts = self._strobes[number] - self._partners
        self._hypotheses += shifts.shape[0]
        places = (self._strobes[None, :, :] - shifts[:, None, :]).reshape(-1, 2)
        distance = np.asarray(
            self._second.confirming_tree.query(places, distance_upper_bound=self._radius_px)[0]
        )
        distance = distance.reshape(shifts.shape[0], -1)
        held = np.isfinite(distance)
        if self._settings.overlap_only:
            inside = self._second.holds(places[:, 0], places[:, 1]).reshape(held.shape)
            strobes, acknowledged = inside.sum(axis=1), (held & inside).sum(axis=1)
        else:
            strobes = np.full(shifts.shape[0], held.shape[1])
            acknowledged = held.sum(axis=1)
        share = acknowledged / np.maximum(strobes, 1)
        self._remember(int(np.argmax(np.where(strobes >= LEAST_STROBES, share, 0.0))), acknowledged, strobes)
        good = np.flatnonzero((share >= self._settings.n_min_ack) & (strobes >= LEAST_STROBES))
        if self._settings.first_wins:
            good = good[:1]
        else:
            # so low a share is often reached by chance: only what looks better than that is looked into
            odds = self._first_odds(distance[good], strobes[good])
            good = good[np.argsort(odds, kind="stable")][
                : int((odds * self._hypotheses < TESTED_BELOW).sum())
            ]
        for candidate in good:
            result = self._judged(shifts[candidate], int(acknowledged[candidate]), int(strobes[candidate]))
            if result.found or self._settings.first_wins:
                return result
            self._keep(result)
            self._judged_so_far += 1
            if self._judged_so_far >= MOST_JUDGED:
                return self.refusal()
        return None

    def _first_odds(self, distance: Array, strobes: Index) -> Array:
        """Least binomial tail over three strobes, the widest and narrower ones; shape (k,)."""
        least = np.ones(strobes.size)
        for part in (1.0, 0.5, 0.25):
            hits = (distance <= part * self._radius_px).sum(axis=1)
            chance = 1.0 - (1.0 - self._chance) ** (part * part)
            tail = binomial_sf(np.asarray(hits - 1.0), np.asarray(strobes - 1.0), chance)
            least = np.minimum(least, tail)
        return 3.0 * least

    def refusal(self) -> Preliminary:
        """Why nothing was found: the refusal of the hypothesis that got farthest, with the totals."""
        best = self._best
        outcome = best.outcome
        if outcome is Outcome.NO_SHIFT and self._chance >= self._settings.n_min_ack:
            outcome = Outcome.CROWDED
        return Preliminary(
            outcome,
            None,
            self._tries,
            self._hypotheses,
            best.strobes,
            best.acknowledged,
            self._chance,
            best.false_probability,
            self._narrower_px(outcome),
        )

    def _narrower_px(self, outcome: Outcome) -> float:
        """The strobe to advise, where it is the strobes that are to blame."""
        if outcome is not Outcome.CROWDED:
            return 0.0
        return self._first.strobe_px(self._second, replace(self._settings, chance_most=FREE_SHARE))

    def _remember(self, best: int, acknowledged: Index, strobes: Index) -> None:
        if self._best.outcome is Outcome.NO_SHIFT and acknowledged[best] > self._best.acknowledged:
            self._keep(
                Preliminary(
                    Outcome.NO_SHIFT, None, strobes=int(strobes[best]), acknowledged=int(acknowledged[best])
                )
            )

    def _keep(self, refused: Preliminary) -> None:
        """Order of refusals: one that came late says more than one that was never acknowledged."""
        weaker = self._best.outcome is Outcome.NO_SHIFT
        if weaker or refused.false_probability < self._best.false_probability:
            self._best = refused

    def _judged(self, shift: Array, acknowledged: int, strobes: int) -> Preliminary:
        """The shift over the hypothesis' pairs, and whether chance or a rival could have given it."""
        settings = self._settings
        pairing = paired(self._first, self._second, shift, self._radius_px, settings)
        if pairing is None:
            outcome, false_probability = Outcome.CHANCE, 1.0
        else:
            false_probability, acknowledged, strobes = self._odds(pairing, acknowledged, strobes)
            outcome = Outcome.FOUND
            least = settings.n_min_ack
            if self._same_chip and max(abs(pairing.dx_px), abs(pairing.dy_px)) < STILL_PX:
                least = max(least, settings.still_share)
            if acknowledged < least * strobes:
                outcome = (
                    Outcome.AMBIGUOUS if acknowledged >= settings.n_min_ack * strobes else Outcome.CHANCE
                )
            if false_probability > settings.false_probability_max:
                crowded = self._chance >= 0.5 * settings.n_min_ack
                outcome = Outcome.CROWDED if crowded else Outcome.CHANCE
            elif settings.narrowing and outcome is Outcome.FOUND:
                rival = rival_share(self._first, self._second, pairing)
                if rival > RIVAL_MOST:
                    outcome = Outcome.AMBIGUOUS
        return Preliminary(
            outcome,
            pairing if outcome is Outcome.FOUND else None,
            self._tries,
            self._hypotheses,
            strobes,
            acknowledged,
            self._chance,
            false_probability,
            self._narrower_px(outcome),
        )

    def _odds(self, pairing: Pairing, acknowledged: int, strobes: int) -> tuple[float, int, int]:
        """Chance that some wrong shift is acknowledged so well; hits and strobes at the final strobe.

        The pair that proposed the hypothesis is a hit by construction and not counted. Within the wide strobe
        the shift was free to move to where most pairs lie: each place it can be told apart in is one more
        look, and so is each hypothesis.
        """
        trials = float(self._hypotheses)
        share = self._share
        if self._settings.narrowing:
            places = self._strobes - (pairing.dx_px, pairing.dy_px)
            if self._settings.overlap_only:
                places = places[self._second.holds(places[:, 0], places[:, 1])]
            strobe = max(pairing.strobe_px, 1.0)
            distance, nearest = self._second.confirming_tree.query(places, distance_upper_bound=strobe)
            hit = np.isfinite(np.asarray(distance))
            acknowledged, strobes = int(np.unique(np.asarray(nearest)[hit]).size), int(places.shape[0])
            trials *= 4.0 * max(1.0, (self._radius_px / strobe) ** 2)
            share = self._local_share(strobe)
        chance = float(share.mean())
        if strobes < LEAST_STROBES:
            return 1.0, acknowledged, strobes
        tail = float(binomial_sf(np.array([acknowledged - 1]), np.array([strobes - 1]), chance)[0])
        return float(np.clip(tail * trials, 1e-300, 1.0)), acknowledged, strobes

    def _local_share(self, radius_px: float) -> Array:
        """Chance that a strobe is filled: at the second list's density where it crowds, part by part."""
        second = self._second
        left, low, right, high = second.box
        return strobe_chances(
            second.x_px[second.confirming] - left - 0.5,
            second.y_px[second.confirming] - low - 0.5,
            radius_px,
            width_px=math.ceil(right - left),
            height_px=math.ceil(high - low),
        )
