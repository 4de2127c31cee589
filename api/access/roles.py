"""Which role each route needs: one table read before a route is entered; docs/how-to/security.md shows it."""

from __future__ import annotations

import re
from collections.abc import Mapping

from api.access.callers import Role

OPEN = None
"""For routes that everybody may ask: they tell nothing of the sky and change nothing."""

_TELESCOPE = "/v1/telescopes/{telescope_id}"

_SOLVE = ("POST /v1/solve",)
_VIEW = (
    "GET /metrics",
    "GET /v1/capabilities",
    "GET /v1/catalogs",
    "GET /v1/events",
    "GET /v1/jobs",
    "GET /v1/jobs/{job_id}",
    "GET /v1/jobs/{job_id}/events",
    "GET /v1/journal",
    "GET /v1/journal/runs",
    "GET /v1/objects",
    "GET /v1/telescopes",
    "GET /v1/virtual",
    f"GET {_TELESCOPE}",
    f"GET {_TELESCOPE}/doctor",
    f"GET {_TELESCOPE}/drift",
    f"GET {_TELESCOPE}/events",
    f"GET {_TELESCOPE}/forecast",
    f"GET {_TELESCOPE}/frames",
    f"GET {_TELESCOPE}/frames/{{frame_id}}",
    f"GET {_TELESCOPE}/jobs",
    f"GET {_TELESCOPE}/last-frame",
    f"GET {_TELESCOPE}/last-frame.webp",
    f"GET {_TELESCOPE}/lease",
    f"GET {_TELESCOPE}/limits",
    f"GET {_TELESCOPE}/looks",
    f"GET {_TELESCOPE}/night",
    f"GET {_TELESCOPE}/offsets",
    f"GET {_TELESCOPE}/pointing-doctor",
    f"GET {_TELESCOPE}/sky",
    f"GET {_TELESCOPE}/tonight",
    f"GET {_TELESCOPE}/wire",
    # orders nothing: its body is what it asks about
    f"POST {_TELESCOPE}/forecast",
)
_OPERATE = (
    "DELETE /v1/jobs/{job_id}",
    "POST /v1/jobs/{job_id}/cancel",
    "POST /v1/jobs/{job_id}/next",
    "POST /v1/stop",
    "POST /v1/virtual/skip",
    f"DELETE {_TELESCOPE}/lease",
    f"POST {_TELESCOPE}/center",
    f"POST {_TELESCOPE}/dither",
    f"POST {_TELESCOPE}/first-light",
    f"POST {_TELESCOPE}/flip",
    f"POST {_TELESCOPE}/follow",
    f"POST {_TELESCOPE}/frames",
    f"POST {_TELESCOPE}/hold",
    f"POST {_TELESCOPE}/home",
    f"POST {_TELESCOPE}/jobs",
    f"POST {_TELESCOPE}/lease",
    f"POST {_TELESCOPE}/look",
    f"POST {_TELESCOPE}/mosaic",
    f"POST {_TELESCOPE}/move-axis",
    f"POST {_TELESCOPE}/night/busy",
    f"POST {_TELESCOPE}/night/pause",
    f"POST {_TELESCOPE}/night/resume",
    f"POST {_TELESCOPE}/night/safety",
    f"POST {_TELESCOPE}/night/start",
    f"POST {_TELESCOPE}/night/stop",
    f"POST {_TELESCOPE}/offset",
    f"POST {_TELESCOPE}/offset-rates",
    f"POST {_TELESCOPE}/park",
    f"POST {_TELESCOPE}/recover",
    f"POST {_TELESCOPE}/rotate",
    f"POST {_TELESCOPE}/slew",
    f"POST {_TELESCOPE}/spiral-search",
    f"POST {_TELESCOPE}/stop",
    f"POST {_TELESCOPE}/sync",
    f"POST {_TELESCOPE}/tracking",
    f"POST {_TELESCOPE}/unpark",
    f"PUT {_TELESCOPE}/lease",
)
_CONFIGURE = (
    "GET /v1/audit",
    "POST /v1/reload",
    # these overrule what the guards know by themselves
    f"POST {_TELESCOPE}/acknowledge",
    f"POST {_TELESCOPE}/trust",
)
_OPEN = ("GET /v1/health", "GET /v1/health/live", "GET /v1/health/ready", "GET /v1/version")

ROLES: Mapping[str, Role | None] = {
    **dict.fromkeys(_OPEN, OPEN),
    **dict.fromkeys(_SOLVE, Role.SOLVE),
    **dict.fromkeys(_VIEW, Role.VIEW),
    **dict.fromkeys(_OPERATE, Role.OPERATE),
    **dict.fromkeys(_CONFIGURE, Role.CONFIGURE),
}
"""``METHOD /path/{template}``: the least role that may ask it. What isn't named needs `Role.CONFIGURE`."""

LEASED = frozenset({f"POST {_TELESCOPE}/night/start", f"POST {_TELESCOPE}/night/resume"})
"""Routes that let a telescope be moved without an order to the dispatcher: they ask for the lease as well."""

OF_ALL = frozenset({"GET /metrics", "GET /v1/journal/runs", "POST /v1/reload"})
"""Routes that tell of all telescopes at once: a key for some of them may not ask. All others show such a key
its own telescopes alone."""

_PARAMETER = re.compile(r"\\\{[a-z_]+\\\}")


def _pattern(template: str) -> re.Pattern[str]:
    return re.compile(_PARAMETER.sub("[^/]+", re.escape(template)))


_FIXED = {template: template for template in ROLES if "{" not in template}
_OTHERS = [(_pattern(template), template) for template in ROLES if "{" in template]


def route_of(method: str, path: str) -> str | None:
    """Which line of `ROLES` a request is of: its ``METHOD /path/{template}``; None if it is of none.

    Parameters
    ----------
    method : str
        HEAD counts as GET.
    path : str
        As it was asked for.
    """
    asked = f"{'GET' if method == 'HEAD' else method} {path}"
    if asked in _FIXED:
        return asked
    return next((template for pattern, template in _OTHERS if pattern.fullmatch(asked)), None)
