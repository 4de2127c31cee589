"""What all routes that order something share: the caller, the key against doing it twice, the job."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, Query, Response

from api.access.callers import Caller
from api.access.security import TheCaller
from api.http.faults import responses
from api.http.models import JobView
from api.http.views import job_view
from api.http.waiting import PREFERENCE_APPLIED, Patience, ThePatience
from api.orders.orders import Order
from api.service import Service, TheService

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
    """An order on its way from a request to the desk."""

    service: Service
    caller: Caller
    patience: Patience
    response: Response
    telescope_id: str
    key: str | None
    supersede: bool

    async def take(self, order: Order) -> JobView:
        """Give it to the desk; answer with its job, at once or when that has ended."""
        job = await self.service.desk.order(
            self.caller, self.telescope_id, order, key=self.key, supersede=self.supersede
        )
        self.response.headers["Location"] = f"/v1/jobs/{job.id}"
        if await self.patience.wait(job) and self.patience.wait_s > 0:
            self.response.status_code = 200
        return job_view(job)


async def ordering_of(
    service: TheService,
    caller: TheCaller,
    patience: ThePatience,
    response: Response,
    telescope_id: str,
    key: Key = None,
    supersede: Supersede = False,
) -> Ordering:
    """What a request says besides its body; parameters that no order has are refused before."""
    return Ordering(service, caller, patience, response, telescope_id, key, supersede)


TheOrdering = Annotated[Ordering, Depends(ordering_of)]


__all__ = ["STARTING", "Key", "Ordering", "Supersede", "TheOrdering"]
