"""How long a client waits for a job's end before its answer: `?wait=30`, or `Prefer: wait=30` [RFC 7240]."""

from __future__ import annotations

import asyncio
import contextlib
import re
from typing import Annotated

from fastapi import Depends, Header, Query, Request, Response

from api.orders.jobs import Job

LONGEST_S = 3600.0
_PREFERENCE = re.compile(r'(?:^|[,;])\s*wait\s*=\s*"?(\d{1,9})"?\s*(?=$|[,;])', re.IGNORECASE)


class Patience:
    """A client's patience.

    Parameters
    ----------
    response : Response
        Told if the header was heeded.
    wait_s : float
    preferred : bool
        Whether it stood in the header.
    """

    def __init__(self, response: Response, wait_s: float, preferred: bool) -> None:
        self._response = response
        self.wait_s = wait_s
        self._preferred = preferred

    async def wait(self, job: Job) -> bool:
        """Wait for a job's end as long as the client does; whether it has ended."""
        if self._preferred:
            self._response.headers["Preference-Applied"] = f"wait={self.wait_s:.0f}"
        if self.wait_s > 0 and not job.is_over:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self.wait_s):
                    await job.ended.wait()
        return job.is_over


async def patience_of(
    request: Request,
    response: Response,
    wait: Annotated[
        float,
        Query(
            ge=0,
            le=LONGEST_S,
            allow_inf_nan=False,
            description="Seconds to wait for the job's end before answering",
        ),
    ] = 0.0,
    _: Annotated[
        str | None,
        Header(
            alias="Prefer",
            description="`wait=30`: the same; what was taken stands in Preference-Applied",
        ),
    ] = None,
) -> Patience:
    """As it stands in the request; the query goes before the header.

    The unused parameter is there for the API's description: the header may come in several lines, which are
    one list [RFC 7240 §2], and no preference is ever an error.
    """
    asked = _PREFERENCE.search(", ".join(request.headers.getlist("prefer")))
    if asked is not None and "wait" not in request.query_params:
        return Patience(response, min(float(asked.group(1)), LONGEST_S), True)
    return Patience(response, wait, False)


ThePatience = Annotated[Patience, Depends(patience_of)]

PREFERENCE_APPLIED = {
    "Preference-Applied": {
        "description": "`wait=S`, where the header Prefer asked for it",
        "schema": {"type": "string"},
    }
}
"""OpenAPI's entry for the header."""


__all__ = ["PREFERENCE_APPLIED", "Patience", "ThePatience", "patience_of"]
