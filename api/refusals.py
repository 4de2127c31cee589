"""Refusals from before all routes: a problem for programs of REST, plain words for those of Alpaca."""

from __future__ import annotations

from starlette.responses import PlainTextResponse, Response
from starlette.types import Scope

from api.problems import Problem, problem_response
from mountnav.masking import masked

ALPACA_PATHS = ("/api/", "/management/", "/setup")
"""Where Alpaca is spoken: whatever is no 200 is plain text there [Alpaca §2]."""


def refusal_response(scope: Scope, found: Problem) -> Response:
    """Answer a request with why it is not let through, as its face has it."""
    answer = problem_response(found)
    if not scope["path"].startswith(ALPACA_PATHS):
        return answer
    words = found.detail if found.advice is None else f"{found.detail} ({found.advice})"
    again = {name: answer.headers[name] for name in ("retry-after",) if name in answer.headers}
    return PlainTextResponse(masked(words), found.status, again)


__all__ = ["ALPACA_PATHS", "refusal_response"]
