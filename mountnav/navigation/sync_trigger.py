"""What makes navigation consider a sync, and what it decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from mountnav.errors import SyncDoubt
from mountnav.navigation.reports import Look
from mountnav.navigation.vetoes import AGAINST_THE_LOOK, SyncContext, in_order


class SyncTrigger(StrEnum):
    """What makes navigation consider a sync. The journal keeps it as `occasion`."""

    ORDERED = "ordered"
    """An operator or a program asks for it: the policy is not asked, the vetoes are."""
    CENTERING = "centering"
    NIGHT = "night"
    RECOVERY = "recovery"
    """Two frames agree: the rule, the size and the expectation are not asked, nor how well the offset is
    known: what is known to half a minute of arc brings back a mount that is lost."""
    FIRST_LIGHT = "first light"
    """As a recovery; and the tube was seen moving as the mount says."""

    @property
    def by_rule(self) -> bool:
        """Whether the policy's rule and its caps on the number are asked."""
        return self in (SyncTrigger.CENTERING, SyncTrigger.NIGHT)

    @property
    def not_asked(self) -> frozenset[SyncDoubt]:
        """Vetoes that don't count here."""
        lost = {SyncDoubt.TOO_FAR, SyncDoubt.NOT_EXPECTED, SyncDoubt.UNSURE}
        return frozenset(lost if self.lost else ())

    @property
    def lost(self) -> bool:
        """Whether what the mount believes says nothing."""
        return self in (SyncTrigger.RECOVERY, SyncTrigger.FIRST_LIGHT)


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
    context : SyncContext or None
        What it was judged by besides the look, so that a sync that follows at once needn't be judged again.
    """

    doubts: tuple[SyncDoubt, ...]
    why: str
    words: Mapping[SyncDoubt, str] = field(default_factory=dict)
    context: SyncContext | None = field(default=None, compare=False, repr=False)

    @property
    def allowed(self) -> bool:
        """Whether nothing stands against it."""
        return not self.doubts

    @property
    def against_the_sky(self) -> tuple[SyncDoubt, ...]:
        """Those for which the look is no good for an offset either; the others only forbid the sync."""
        return tuple(doubt for doubt in self.doubts if doubt in AGAINST_THE_LOOK)


def decided(doubts: Mapping[SyncDoubt, str], found: Look, context: SyncContext | None = None) -> SyncDecision:
    """Make a decision of vetoes and their words."""
    ordered = in_order(doubts)
    why = "; ".join(ordered.values()) or f"{found.offset.total_arcsec:.0f}″ off; nothing speaks against it"
    return SyncDecision(tuple(ordered), why, ordered, context)


__all__ = ["SyncDecision", "SyncTrigger", "decided"]
