"""How many requests a caller may send: a bucket of tokens for each; a stop costs none and always passes."""

from __future__ import annotations

import asyncio
import math
import re
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from starlette.types import ASGIApp, Receive, Scope, Send

from api.problems import problem, refusal_response

WAITS_S = 0.25
"""A request that is only so much too early is held back instead of refused."""
_BUCKETS_MOST = 10_000
"""Callers whose rates are counted; chosen by hand. One that is forgotten begins with a full bucket: halved,
5,000 addresses in turn pass unlimited."""
_STOPS = re.compile(
    r"(POST /v1/stop|POST /v1/telescopes/[^/]+/(night/)?stop|DELETE /v1/jobs/[^/]+|POST /v1/jobs/[^/]+/cancel"
    r"|PUT /api/v1/telescope/\d+/abortslew)/?"
)


def is_stop(method: str, path: str) -> bool:
    """Whether a request stops something."""
    return _STOPS.fullmatch(f"{method} {path}") is not None


@dataclass(slots=True)
class _Bucket:
    tokens: float
    at_s: float


class TokenBuckets:
    """One bucket for each name: `rate_per_s` tokens flow in, `burst` at the most are in it."""

    def __init__(
        self, rate_per_s: float, burst: int, *, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate_per_s = rate_per_s
        self._burst = float(burst)
        self._clock_s = clock_s
        self._buckets: OrderedDict[str, _Bucket] = OrderedDict()

    def wait_s(self, name: str, *, most_s: float) -> tuple[bool, float]:
        """Take a token, one of the near future if need be.

        Returns
        -------
        bool
            Whether there was one within `most_s`; if not, none was taken.
        float
            Seconds until it is there.
        """
        now_s = self._clock_s()
        bucket = self._buckets.setdefault(name, _Bucket(self._burst, now_s))
        self._buckets.move_to_end(name)
        bucket.tokens = min(self._burst, bucket.tokens + (now_s - bucket.at_s) * self._rate_per_s)
        bucket.at_s = now_s
        while len(self._buckets) > _BUCKETS_MOST:
            self._buckets.popitem(last=False)
        wait_s = max(0.0, (1.0 - bucket.tokens) / self._rate_per_s)
        if wait_s > most_s:
            return False, wait_s
        bucket.tokens -= 1.0
        return True, wait_s


class RateLimit:
    """Hold back, or answer 429 to, callers that ask too much. Plain ASGI.

    Parameters
    ----------
    name_of : callable
        Whose bucket a request takes from; None: it is not counted.
    """

    def __init__(self, app: ASGIApp, buckets: TokenBuckets, name_of: Callable[[Scope], str | None]) -> None:
        self._app = app
        self._buckets = buckets
        self._name_of = name_of

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, a little later if need be, or refuse it."""
        if scope["type"] != "http" or is_stop(scope["method"], scope["path"]):
            await self._app(scope, receive, send)
            return
        name = self._name_of(scope)
        passes, wait_s = (True, 0.0) if name is None else self._buckets.wait_s(name, most_s=WAITS_S)
        if passes:
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)
            await self._app(scope, receive, send)
            return
        seconds = max(1, math.ceil(wait_s))
        found = problem(
            "too-many-requests",
            429,
            "more requests came from this caller than are allowed",
            retryable=True,
            retry_after_s=seconds,
            advice="follow /v1/events instead of asking often; [service] rate_limit_per_s is the limit",
        )
        await refusal_response(scope, found)(scope, receive, send)
