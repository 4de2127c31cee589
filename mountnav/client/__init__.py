"""A typed client of our own HTTP API, for schedulers: `Client`, and `AsyncClient` with the same calls.

Nothing here moves a telescope twice: each order has an Idempotency-Key of its own, kept over all attempts to
send it.
"""

from mountnav.client import orders, targets
from mountnav.client.client import AsyncClient, Client
from mountnav.client.failures import JobFailed, ServiceError
from mountnav.client.results import (
    Capabilities,
    Health,
    Job,
    Json,
    LeaseState,
    NextPanel,
    Place,
    Problem,
    Reloaded,
    SkyObject,
    StopAll,
    Stopped,
    TelescopeState,
)
from mountnav.client.stream import ServerEvent
from mountnav.client.targets import Target

__all__ = [
    "AsyncClient",
    "Capabilities",
    "Client",
    "Health",
    "Job",
    "JobFailed",
    "Json",
    "LeaseState",
    "NextPanel",
    "Place",
    "Problem",
    "Reloaded",
    "ServerEvent",
    "ServiceError",
    "SkyObject",
    "StopAll",
    "Stopped",
    "Target",
    "TelescopeState",
    "orders",
    "targets",
]
