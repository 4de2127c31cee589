"""Identified: what came of a search."""

from __future__ import annotations

from dataclasses import dataclass, field

from mountnav.catalog.stars import Stars
from mountnav.identification.reference import Reference
from mountnav.solution import Contradiction, Reason


@dataclass(frozen=True, slots=True)
class Identified:
    """What came of a search.

    Attributes
    ----------
    reference : Reference or None
    stars : Stars or None
        The list that `reference.pairs.star` points into.
    reason : Reason or None
    detail : str
        For people.
    false_probability : float
        Chance that a wrong place would have looked as good: that of one hypothesis times all that were tried.
    numbers : dict of str to float
        The numbers behind it.
    contradictions : tuple of Contradiction
        Hints that disprove each other. Who has the solution compares it with the hints
        (`mountnav.solving.contradictions`).
    blind : bool
        Found over the whole sky, not where the hint said.
    """

    reference: Reference | None
    stars: Stars | None
    reason: Reason | None
    detail: str
    false_probability: float = 1.0
    numbers: dict[str, float] = field(default_factory=dict)
    contradictions: tuple[Contradiction, ...] = ()
    blind: bool = False
