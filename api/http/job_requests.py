"""What all routes that start jobs share: the caller, the idempotency key, how long to wait for the end.

A client waits by `?wait=30` or `Prefer: wait=30` [RFC 7240].
"""

from __future__ import annotations

import asyncio
import contextlib
import re
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, Query, Request, Response

from api.access.callers import Caller
from api.access.security import TheCaller, stops_before
from api.orders.job_views import JobView, job_view
from api.orders.jobs import Job
from api.orders.vocabulary import Order
from api.problems import responses
from api.service import Service, TheService

__all__ = [
    "PREFERENCE_APPLIED",
    "STARTING",
    "Key",
    "Ordering",
    "Patience",
    "Supersede",
    "TheOrdering",
    "ThePatience",
    "patience_of",
]


LONGEST_S = 3600.0
"""Longest `wait` of a request, s; part of the interface (docs/openapi.json). Doubled, a client that went
away unnoticed holds its connection twice as long."""
_PREFERENCE = re.compile(r'(?:^|[,;])\s*wait\s*=\s*"?(\d{1,9})"?\s*(?=$|[,;])', re.IGNORECASE)


class Patience:
    """A client's patience.

    Parameters
    ----------
    response : Response
        Told if the header was heeded.
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


Key = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        description="Made by the client: the same key with the same request never starts a second job",
    ),
]
Supersede = Annotated[
    bool,
    Query(
        description="End the job that holds the telescope, stop the mount, and then begin; "
        "else that is refused as busy"
    ),
]
_LOCATION = {"Location": {"description": "The job", "schema": {"type": "string"}}}
STARTING: dict[int | str, dict[str, Any]] = {
    **responses(404, 409, 503),
    200: {
        "model": JobView,
        "description": "The job has ended within `wait`",
        "headers": {**_LOCATION, **PREFERENCE_APPLIED},
    },
    202: {"headers": {**_LOCATION, **PREFERENCE_APPLIED}},
}
"""OpenAPI's entries for routes that start a job."""


@dataclass(frozen=True, slots=True)
class Ordering:
    """An order on its way from a request to the dispatcher."""

    service: Service
    caller: Caller
    patience: Patience
    response: Response
    telescope_id: str
    key: str | None
    supersede: bool
    stops_given: int | None

    async def take(self, order: Order) -> JobView:
        """Give it to the dispatcher; answer with its job, at once or when that has ended."""
        job = await self.service.dispatcher.order(
            self.caller,
            self.telescope_id,
            order,
            key=self.key,
            supersede=self.supersede,
            stops_given=self.stops_given,
        )
        self.response.headers["Location"] = f"/v1/jobs/{job.id}"
        if await self.patience.wait(job) and self.patience.wait_s > 0:
            self.response.status_code = 200
        return job_view(job)


async def ordering_of(
    request: Request,
    service: TheService,
    caller: TheCaller,
    patience: ThePatience,
    response: Response,
    telescope_id: str,
    key: Key = None,
    supersede: Supersede = False,
) -> Ordering:
    """What a request says besides its body; parameters that no order has are refused before."""
    stops_given = stops_before(request).get(telescope_id)
    return Ordering(service, caller, patience, response, telescope_id, key, supersede, stops_given)


TheOrdering = Annotated[Ordering, Depends(ordering_of)]
