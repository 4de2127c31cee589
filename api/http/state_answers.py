"""The state of telescopes as it goes over HTTP: made once for each reading, whoever asks and however often.

Nobody who asks makes a device be asked. The entity tag names the reading, so that a client that has it
already is told so (304) without a body.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from fastapi import Request, Response

from api.http.telescope_view import telescope_view
from api.observatory import Telescope
from api.service import Service

_JSON = "application/json"


@dataclass(frozen=True, slots=True)
class Answer:
    """A body and its tag."""

    tag: str
    body: bytes


class StateAnswers:
    """Keeps the latest answer of each telescope.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self._service = service
        self._kept: dict[str, Answer] = {}

    def of(self, telescope: Telescope) -> Answer:
        """The answer of one telescope."""
        snapshot = self._service.desk.watch(telescope.id).latest
        job = "" if snapshot.job is None else snapshot.job.id[:12]
        # the service's id: after a restart the counting begins anew
        tag = f'"{self._service.events.run}-{snapshot.revision}-{job}"'
        kept = self._kept.get(telescope.id)
        if kept is None or kept.tag != tag:
            problem = self._service.remembering.problem
            view = telescope_view(telescope, snapshot, () if problem is None else (problem,))
            kept = self._kept[telescope.id] = Answer(tag, view.model_dump_json().encode())
        return kept

    def all(self) -> Answer:
        """The answer of all telescopes, as a list."""
        each = [self.of(telescope) for telescope in self._service.desk.telescopes]
        tag = hashlib.sha256("".join(one.tag for one in each).encode()).hexdigest()[:24]
        return Answer(f'"{tag}"', b"[" + b",".join(one.body for one in each) + b"]")


def answered(request: Request, answer: Answer) -> Response:
    """200 with the body and its tag; 304 to a client that has it."""
    headers = {"ETag": answer.tag, "Cache-Control": "no-cache"}
    if knows(request.headers.get("if-none-match"), answer.tag):
        return Response(status_code=304, headers=headers)
    return Response(answer.body, media_type=_JSON, headers=headers)


def knows(if_none_match: str | None, tag: str) -> bool:
    """Whether a client that sent `If-None-Match` has the answer of that tag [RFC 9110 §13.1.2]."""
    if if_none_match is None:
        return False
    told = [one.strip().removeprefix("W/") for one in if_none_match.split(",")]
    return "*" in told or tag in told


async def state_answers(request: Request) -> StateAnswers:
    """Those of the service that a request came to."""
    state = request.app.state
    found: StateAnswers | None = getattr(state, "state_answers", None)
    if found is None or found._service is not state.service:
        found = state.state_answers = StateAnswers(state.service)
    return found


__all__ = ["Answer", "StateAnswers", "answered", "knows", "state_answers"]
