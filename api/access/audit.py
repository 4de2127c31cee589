"""Who ordered what, by which face, and what became of it: a row of the journal for each, refused ones too."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextvars import ContextVar
from typing import Protocol

from pydantic import BaseModel

from api.access.callers import Caller, Face
from api.access.noted_seldom import Seldom, Unnoted
from api.http.faults import Problem, Refused, internal_problem, problem_of
from mountnav.errors import MountnavError
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.masking import masked
from mountnav.sky.coordinates import utc_now

_log = logging.getLogger(__name__)

TAKEN = "taken"
_SECRETS = ("secret", "token", "password", "authorization", "api_key", "apikey", "lease_id")
_LONGEST_TEXT = 500
_MOST_VALUES = 50
_DEEPEST = 4
_KEYLESS = frozenset({Face.INDI, Face.LX200, Face.STELLARIUM, Face.ALPACA})
"""Whoever reaches these may order, and no rate is set to him."""
_MOST_REPEATED = 20
"""So often a minute one address is noted for one refusal, or for stops, by such a face, and ten times that
all of them. Doubled, clients that order what is refused without end fill 200 MB a day."""

_noted: ContextVar[list[str] | None] = ContextVar("mountnav_audit_noted", default=None)
"""What the request that is being answered has noted so far; see `watching_notes`."""


class AuditKeeper(Protocol):
    """Where audits are kept."""

    def audit_now(self, row: AuditRow) -> None:
        """Keep it, without waiting. Never raises."""
        ...


class Audit:
    """Notes orders. An order waits for no note; none is lost as long as the journal can be written.

    While it can't, notes are kept in memory (ten thousand of them) and written later.

    Parameters
    ----------
    keeper : AuditKeeper
    """

    def __init__(self, keeper: AuditKeeper) -> None:
        self._keeper = keeper
        self._repeated = Seldom(_MOST_REPEATED, 10 * _MOST_REPEATED)

    def note(
        self,
        caller: Caller,
        what: str,
        *,
        telescope: str | None = None,
        request: Mapping[str, object] | BaseModel | None = None,
        outcome: str = TAKEN,
        detail: str = "",
        status: int | None = None,
        job_id: str | None = None,
    ) -> None:
        """Note an order. Never raises, waits for nothing.

        Where no keys are asked for, one address's refused orders and stops are noted so often a minute, with
        how many there were between.

        Parameters
        ----------
        caller : Caller
        what : str
            The order's kind, such as ``slew``.
        telescope : str, optional
            None for the whole service.
        request : mapping or model, optional
            What was asked for. Values whose names tell of secrets are left out, long ones cut.
        outcome : str
            ``taken``, or the slug of the problem.
        detail : str
            In words.
        status : int, optional
            Of HTTP.
        job_id : str, optional
            Which job it became.
        """
        try:
            if (noted := _noted.get()) is not None:
                noted.append(what)
            unnoted: Unnoted | None = None
            if caller.face in _KEYLESS and (outcome != TAKEN or what == "stop"):
                unnoted = self._repeated.due((caller.address, caller.face, what, outcome))
                if unnoted is None:
                    return
            self._keeper.audit_now(
                AuditRow(
                    utc=utc_now(),
                    telescope=telescope or "",
                    caller=caller.name,
                    role=str(caller.role),
                    face=str(caller.face),
                    address=caller.address,
                    what=masked(what),
                    request=_shown(request) | _told_of(unnoted),
                    outcome=outcome,
                    detail=masked(detail[:_LONGEST_TEXT]),
                    status=status,
                    job_id=job_id,
                )
            )
        except Exception:
            # an order must not fail for its note
            _log.exception("the audit of %s by %s was not noted", what, caller.name)

    def stranger(
        self, address: str, what: str, *, status: int, outcome: str, unnoted: Unnoted | None = None
    ) -> None:
        """Note that somebody unknown tried something. Never raises.

        Parameters
        ----------
        address : str
        what : str
        status : int
        outcome : str
        unnoted : Unnoted, optional
            What he and others did since their last notes.
        """
        request = _told_of(unnoted)
        row = AuditRow(
            utc_now(), "", "(unknown)", "", "", address, masked(what), request, outcome, status=status
        )
        try:
            self._keeper.audit_now(row)
        except Exception:
            _log.exception("the audit of %s from %s was not noted", what, address)

    def refused(
        self,
        caller: Caller,
        what: str,
        error: BaseException,
        *,
        telescope: str | None = None,
        request: Mapping[str, object] | BaseModel | None = None,
    ) -> None:
        """Note an order that was refused with `error`. Never raises."""
        found = _problem(error)
        self.note(
            caller,
            what,
            telescope=telescope,
            request=request,
            outcome=found.type.rpartition(":")[2],
            detail=found.detail,
            status=found.status,
            job_id=found.job_id,
        )


def _told_of(unnoted: Unnoted | None) -> dict[str, object]:
    if unnoted is None:
        return {}
    told = {"more_since_the_last_note": unnoted.same, "others_not_noted": unnoted.others}
    return {name: count for name, count in told.items() if count}


def watching_notes() -> list[str]:
    """Begin a list of what is noted from now on in this task, and in what it awaits."""
    noted: list[str] = []
    _noted.set(noted)
    return noted


def _problem(error: BaseException) -> Problem:
    if isinstance(error, Refused):
        return error.problem
    return problem_of(error) if isinstance(error, MountnavError) else internal_problem()


def _shown(request: Mapping[str, object] | BaseModel | None) -> dict[str, object]:
    if request is None:
        return {}
    plain = request.model_dump(mode="json", exclude_none=True) if isinstance(request, BaseModel) else request
    return {str(name): _cut(value) for name, value in _kept(plain)}


def _kept(mapping: Mapping[str, object]) -> list[tuple[str, object]]:
    named = [(str(name), value) for name, value in mapping.items()]
    return [one for one in named if not any(word in one[0].lower() for word in _SECRETS)][:_MOST_VALUES]


def _cut(value: object, depth: int = 1) -> object:
    if isinstance(value, str):
        value = masked(value)
        return (
            value if len(value) <= _LONGEST_TEXT else f"{value[:_LONGEST_TEXT]}... ({len(value)} characters)"
        )
    if isinstance(value, Mapping):
        if depth >= _DEEPEST:
            return f"({len(value)} values)"
        return {name: _cut(one, depth + 1) for name, one in _kept(value)}
    if isinstance(value, list | tuple):
        if depth >= _DEEPEST:
            return f"({len(value)} values)"
        return [_cut(one, depth + 1) for one in value[:_MOST_VALUES]]
    return value


__all__ = ["TAKEN", "Audit", "AuditKeeper", "watching_notes"]
