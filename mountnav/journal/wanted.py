"""What somebody wants to read of the journal: filters, and a place to go on from."""

from __future__ import annotations

import base64
import binascii
import json
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from mountnav.errors import BadRequest
from mountnav.journal.records import EntryKind, Outcome
from mountnav.parsing import json_of

LOOK, COMMAND = "look", "command"
KINDS = (LOOK, COMMAND, *(str(kind) for kind in EntryKind))
"""Kinds of lines that there are."""
_AGO = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|m|h|d|w)")
_EARLIEST, _LATEST = datetime(1000, 1, 1), datetime(9000, 1, 1)
_UNIT_S = {"s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}


@dataclass(frozen=True, slots=True)
class Wanted:
    """Filters; what is None or empty filters nothing. A line must pass all of them.

    Attributes
    ----------
    telescope : str or None
        Rows of the whole service (``""``) don't pass a telescope's name.
    kinds : frozenset of str
        Of `KINDS`: ``look``, ``command``, or an entry's kind.
    since, until : datetime or None
        From (included) and to (not included).
    job_id, night_id : str or None
        Of its cause.
    outcome : str or None
        A command's; ``open`` for one that has none yet, ``solved`` and ``unsolved`` for looks.
    text : str or None
        Somewhere in its words, without regard to case.
    segment_id : str or None
    run_id : str or None
        Of one run of the service.
    """

    telescope: str | None = None
    kinds: frozenset[str] = frozenset()
    since: datetime | None = None
    until: datetime | None = None
    job_id: str | None = None
    night_id: str | None = None
    outcome: str | None = None
    text: str | None = None
    segment_id: str | None = None
    run_id: str | None = None

    def __post_init__(self) -> None:
        if unknown := sorted(self.kinds - set(KINDS)):
            raise BadRequest(
                f"there is no kind {unknown[0]!r} of journal lines", advice=f"one of {', '.join(KINDS)}"
            )
        for utc in (self.since, self.until):
            if utc is not None and not _EARLIEST <= utc.replace(tzinfo=None) <= _LATEST:
                raise BadRequest(f"{utc.isoformat()} is no time of a journal's", advice="from 1000 to 9000")
        outcomes = ("open", "solved", "unsolved", *(str(one) for one in Outcome))
        if self.outcome is not None and self.outcome not in outcomes:
            raise BadRequest(f"there is no outcome {self.outcome!r}", advice=f"one of {', '.join(outcomes)}")


@dataclass(frozen=True, slots=True, order=True)
class Mark:
    """A line's place in the story: in order of instants, then of the tables and their rows."""

    utc: datetime
    table: int
    row: int

    def encoded(self) -> str:
        """As text that a client hands back."""
        raw = json.dumps([self.utc.isoformat(), self.table, self.row])
        return base64.urlsafe_b64encode(raw.encode()).decode().rstrip("=")

    @classmethod
    def decoded(cls, text: str) -> Mark:
        """From that text. Raises `BadRequest`."""
        try:
            padded = text + "=" * (-len(text) % 4)
            utc, table, row = json_of(base64.urlsafe_b64decode(padded.encode("ascii")))
            found = cls(datetime.fromisoformat(utc), int(table), int(row))
            dated = _EARLIEST <= found.utc.replace(tzinfo=None) <= _LATEST
            if found.utc.tzinfo is None or not dated or not 0 <= found.row < 2**62:
                raise ValueError(text)
        except (ValueError, TypeError, OverflowError, UnicodeError, binascii.Error) as error:
            raise BadRequest("this is no cursor", advice="take the one that the last answer gave") from error
        return found


def instant(text: str, now: datetime) -> datetime:
    """The instant that a user means: ``2h``, ``3 d`` (ago), an ISO date or time, UTC unless it tells a zone.

    Raises
    ------
    BadRequest
        It is none.
    """
    if found := _AGO.fullmatch(text.strip()):
        try:
            return now - timedelta(seconds=float(found.group(1)) * _UNIT_S[found.group(2)])
        except OverflowError:
            return _EARLIEST.replace(tzinfo=UTC)
    try:
        at = datetime.fromisoformat(text.strip())
        return at.replace(tzinfo=UTC) if at.tzinfo is None else at.astimezone(UTC)
    except (ValueError, OverflowError):
        raise BadRequest(
            f"{text!r} is no time", advice="write 2h, 3d (ago), 2026-11-22, or 2026-11-22T03:00 (UTC)"
        ) from None
