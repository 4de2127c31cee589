"""What the doctor finds: illnesses with odds, numbers, words and advice; values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

Mounting = Literal["german", "fork", "altaz"]


class Illness(StrEnum):
    """What may be wrong with a mount, its site, its clock, its camera, or one look."""

    EPOCH = "epoch mix-up"
    """Readings are JNow where J2000 is believed, or the reverse."""
    CLOCK = "clock wrong"
    LONGITUDE_SIGN = "longitude sign wrong"
    LONGITUDE = "longitude wrong"
    HEMISPHERE = "hemisphere wrong"
    """Sign of the latitude: both axes count the other way."""
    MIRRORED = "mirrored image"
    PIER_SIDE = "pier side misreported"
    SLIPPED = "slipped"
    """An axis' zero point jumped without a sync: clutch, belt, lost steps."""
    WRONG_LOOK = "one look contradicts the others"
    CAMERA_TURNED = "camera turned"
    NOT_ALIGNED = "not aligned"
    """Zero points are far off in both axes: the mount was never synced, or lost its place."""
    UNKNOWN = "unknown"
    """Something is wrong that fits none of these."""


HARMLESS = frozenset({Illness.CAMERA_TURNED, Illness.NOT_ALIGNED})
"""Told, but no illness: a mount that has just been switched on isn't ill."""


CERTAIN = 1e300
"""Odds that are written instead of infinite ones."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A number with its one-sigma error; None where it can't be told."""

    value: float
    sigma: float | None
    unit: str

    def __str__(self) -> str:
        digits = 1 if self.sigma is None or self.sigma >= 0.05 else 3
        error = "" if self.sigma is None else f" ± {self.sigma:.{digits}f}"
        return f"{self.value:.{digits}f}{error} {self.unit}"

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {"value": self.value, "sigma": self.sigma, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Finding:
    """One illness that the looks speak for.

    Attributes
    ----------
    probability : float
        Posterior, given that something on the doctor's list is the case, with the priors of `priors`.
    odds_against_healthy : float
        How many times more probable than that nothing is wrong; infinite is written as 1e300.
    numbers : mapping of str to Measured
        What was measured, by name with its unit last.
    words : str
        In one sentence, with the numbers.
    advice : str
        What to do.
    alternatives : tuple of Illness
        What these looks can't tell from it.
    look_ids : tuple of str
        Looks it rests on, where it is not all of them.
    """

    what: Illness
    probability: float
    odds_against_healthy: float
    numbers: Mapping[str, Measured]
    words: str
    advice: str
    alternatives: tuple[Illness, ...] = ()
    look_ids: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return {
            "what": self.what.value,
            "probability": self.probability,
            "odds_against_healthy": self.odds_against_healthy,
            "numbers": {name: one.as_dict() for name, one in self.numbers.items()},
            "words": self.words,
            "advice": self.advice,
            "alternatives": [one.value for one in self.alternatives],
            "look_ids": list(self.look_ids),
        }


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What the looks of a mount tell about it.

    Attributes
    ----------
    findings : tuple of Finding
        What is wrong, beyond reasonable doubt (healthy less probable than `priors.ALARM`); most probable
        first.
    suspicions : tuple of Finding
        What may be wrong and can't be told yet.
    healthy : bool or None
        None: can't be told (too few looks, or a suspicion).
    enough : bool
        Whether the looks sufficed to find each illness on the list, had it been there.
    observations : int
        Looks that counted.
    words : str
        The whole in a few sentences.
    """

    findings: tuple[Finding, ...]
    suspicions: tuple[Finding, ...]
    healthy: bool | None
    enough: bool
    observations: int
    words: str

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return {
            "healthy": self.healthy,
            "enough": self.enough,
            "observations": self.observations,
            "words": self.words,
            "findings": [one.as_dict() for one in self.findings],
            "suspicions": [one.as_dict() for one in self.suspicions],
        }
