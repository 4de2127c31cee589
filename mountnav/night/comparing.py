"""What was decided then and in a replay, side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from mountnav.night.events import Act, CorrectionEnded, Decision, Why

SAME_ARCSEC = 0.01
"""Errors that differ by less are the same: the numbers go through a file, and are added up once more."""
SAME_ANEW_ARCSEC = 1.0
"""The same where the frame was identified anew, perhaps by another version."""


@dataclass(frozen=True, slots=True)
class Row:
    """One thing that was decided, then and now.

    Attributes
    ----------
    utc : datetime
    what : str
        The frame's source, or "night".
    recorded, replayed : str
        "-" where nothing was.
    same : bool
    """

    utc: datetime
    what: str
    recorded: str
    replayed: str
    same: bool


@dataclass(slots=True)
class Judgement:
    """One decision of each, with what came of it if it was a correction.

    Attributes
    ----------
    utc : datetime
    source : str
        Of the frame; empty for decisions about the night itself.
    then, now : Decision or None
    ended_then, ended_now : CorrectionEnded or None
    anew : bool
        Whether the frame was identified anew.
    """

    utc: datetime
    source: str
    then: Decision | None
    now: Decision | None
    ended_then: CorrectionEnded | None = None
    ended_now: CorrectionEnded | None = None
    anew: bool = False

    @property
    def row(self) -> Row:
        """For people and programs."""
        return Row(
            self.utc,
            Path(self.source).name or "night",
            _told(self.then, self.ended_then),
            _told(self.now, self.ended_now),
            self._same(),
        )

    def _same(self) -> bool:
        then, now = self.then, self.now
        if then is None or now is None or (then.act, then.why) != (now.act, now.why):
            return False
        if (then.error is None) != (now.error is None):
            return False
        if then.error is not None and now.error is not None:
            east = abs(then.error.east_arcsec - now.error.east_arcsec)
            north = abs(then.error.north_arcsec - now.error.north_arcsec)
            if max(east, north) > (SAME_ANEW_ARCSEC if self.anew else SAME_ARCSEC):
                return False
        if self.ended_then is None or self.ended_now is None:
            # a recording that ends before the correction did can't tell
            return self.ended_then is None
        return (self.ended_then.outcome, self.ended_then.doubts) == (
            self.ended_now.outcome,
            self.ended_now.doubts,
        )


def paired(
    then: Sequence[Decision], now: Sequence[Decision]
) -> Iterator[tuple[Decision | None, Decision | None]]:
    """The decisions of one event, like with like: an event has one of each kind at most, in their order."""
    before, after = ({_kind(one): one for one in some} for some in (then, now))
    for kind in {**before, **after}:
        yield before.get(kind), after.get(kind)


def _kind(decision: Decision) -> str:
    return "frame" if decision.act in (Act.CORRECT, Act.LEAVE) else str(decision.act)


def _told(decision: Decision | None, end: CorrectionEnded | None) -> str:
    if decision is None:
        return "-"
    told = f"{decision.act}: {decision.why}"
    if decision.why is Why.DOUBTED:
        told += f": {decision.text}"
    if decision.error is not None:
        told += f" ({decision.error.east_arcsec:+.1f}″, {decision.error.north_arcsec:+.1f}″)"
    if end is not None:
        told += f"; {end.outcome}"
        if end.doubts:
            told += f" ({', '.join(end.doubts)})"
    return told


__all__ = ["Judgement", "Row", "paired"]
