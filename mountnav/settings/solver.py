"""`[solver]`: where frames are solved: in the service's own processes, in a pool, or on a Dask cluster."""

from __future__ import annotations

import re
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.section import Section

_SCHEDULER = re.compile(r"(tcp|tls)://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):\d{1,5}")


class SolverSettings(Section):
    """`[solver]`: where frames are solved.

    Attributes
    ----------
    engine : {"process", "pool", "dask"}
        process: one process for looks and one for uploads. pool: `workers` processes, which all telescopes
        and uploads share fairly, looks first. dask: looks on the site's Dask cluster, and where that is slow
        or gone in the service's own pool; uploads in the pool.
    workers : int
        Most processes of the pool. All but one are started when they are needed, and each may hold
        `solving.memory_mb`.
    scheduler : str or None
        Of the Dask cluster: ``tcp://host:port`` or ``tls://host:port``.
    deadline_s : float
        A look that the cluster hasn't answered by then is solved in the service's own pool, too; the answer
        that comes first counts.
    resource : str or None
        Only workers of the cluster with this resource are asked (``dask worker --resources "looks=1"``):
        kept for looks, they are never busy with an archive.
    """

    engine: Literal["process", "pool", "dask"] = "process"
    workers: int = Field(default=2, ge=2, le=32)
    scheduler: str | None = None
    deadline_s: float = Field(default=5.0, ge=0.1, le=600)
    resource: str | None = Field(default=None, pattern=r"^[A-Za-z0-9_-]{1,40}$")

    @field_validator("scheduler")
    @classmethod
    def _is_an_address(cls, scheduler: str | None) -> str | None:
        if scheduler is not None and not _SCHEDULER.fullmatch(scheduler):
            raise PydanticCustomError(
                "no_scheduler",
                "{scheduler} is not the address of a scheduler",
                {
                    "scheduler": repr(scheduler),
                    "fix": 'write it as `dask scheduler` tells it: "tcp://HOST:8786"',
                },
            )
        return scheduler

    @model_validator(mode="after")
    def _dask_has_a_scheduler(self) -> Self:
        if self.engine == "dask" and self.scheduler is None:
            raise PydanticCustomError(
                "no_scheduler",
                "the engine dask needs the address of a scheduler",
                {"key": "engine", "fix": 'add scheduler = "tcp://HOST:8786"'},
            )
        return self
