"""How many headers a request may have: each guard looks through them, 6,000 held the loop for up to 0.2 s."""

from __future__ import annotations

from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.limits_of_rate import is_stop
from api.http.faults import Problem, problem
from api.http.refusals import refusal_response

_MOST_HEADERS = 100
"""As common servers have it; a browser behind a proxy sends some 30. Each guard looks through all of them."""


class BoundedHeads:
    """Refuse heads that no client of ours sends; a stop is taken without what is too much. Plain ASGI.

    Parameters
    ----------
    app : ASGIApp
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        refusal = None if scope["type"] != "http" else _refusal(scope)
        if refusal is None:
            await self._app(scope, receive, send)
        elif is_stop(scope["method"], scope["path"]):
            taken = {**scope, "headers": scope["headers"][:_MOST_HEADERS]}
            await self._app(taken, receive, send)
        else:
            await refusal_response(scope, refusal)(scope, receive, send)


def _refusal(scope: Scope) -> Problem | None:
    if len(scope["headers"]) > _MOST_HEADERS:
        return problem("too-large", 431, f"there are more than {_MOST_HEADERS} headers")
    return None


__all__ = ["BoundedHeads"]
