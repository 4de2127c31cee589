"""On what occasion a sync is thought of, and what is decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from mountnav.errors import SyncDoubt
from mountnav.navigation.reports import Look
from mountnav.navigation.vetoes import AGAINST_THE_LOOK, in_order


class Occasion(StrEnum):
    """On what occasion a sync is thought of."""

    ORDERED = "ordered"
    """An operator or a program asks for it: the policy is not asked, the doubts are."""
    CENTERING = "centering"
    NIGHT = "night"
    RECOVERY = "recovery"
    """Two frames agree: the rule, the size and the expectation are not asked."""
    FIRST_LIGHT = "first light"
    """As a recovery; and the tube was seen moving as the mount says."""

    @property
    def by_rule(self) -> bool:
        """Whether the policy's rule and its caps on the number are asked."""
        return self in (Occasion.CENTERING, Occasion.NIGHT)

    @property
    def not_asked(self) -> frozenset[SyncDoubt]:
        """Doubts that don't count on this occasion."""
        lost = {SyncDoubt.TOO_FAR, SyncDoubt.NOT_EXPECTED}
        return frozenset(lost if self.lost else ())

    @property
    def lost(self) -> bool:
        """Whether what the mount believes says nothing."""
        return self in (Occasion.RECOVERY, Occasion.FIRST_LIGHT)


@dataclass(frozen=True, slots=True)
class SyncDecision:
    """Whether a look is synced on.

    Attributes
    ----------
    doubts : tuple of SyncDoubt
        What stands against it, the gravest first; empty when it may be sent.
    why : str
        In words, with the numbers.
    words : mapping of SyncDoubt to str
        The same for each.
    """

    doubts: tuple[SyncDoubt, ...]
    why: str
    words: Mapping[SyncDoubt, str] = field(default_factory=dict)

    @property
    def allowed(self) -> bool:
        """Whether nothing stands against it."""
        return not self.doubts

    @property
    def against_the_sky(self) -> tuple[SyncDoubt, ...]:
        """Those for which the look is no good for an offset either; the others only forbid the sync."""
        return tuple(one for one in self.doubts if one in AGAINST_THE_LOOK)


def decided(doubts: Mapping[SyncDoubt, str], found: Look) -> SyncDecision:
    """Make a decision of doubts and their words."""
    ordered = in_order(doubts)
    why = "; ".join(ordered.values()) or f"{found.offset.total_arcsec:.0f}″ off; nothing stands against it"
    return SyncDecision(tuple(ordered), why, ordered)


__all__ = ["Occasion", "SyncDecision", "decided"]
