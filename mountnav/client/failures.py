"""How a request or a job ends badly, for programs: what, whether to try again, and when."""

from __future__ import annotations

from typing import Any

from mountnav.client.results import Job, Json
from mountnav.errors import MountnavError

_PREFIX = "urn:mountnav:problem:"


class ServiceError(MountnavError):
    """The service answered with a problem (RFC 9457).

    Parameters
    ----------
    problem : mapping
        As it came; whole.
    status : int
        Of HTTP.

    Attributes
    ----------
    slug : str
        Which problem it is, for programs: ``busy``, ``leased``, ``outside-limits``, ...
    retryable : bool
        Whether the same request may succeed later.
    retry_after_s : float or None
        So long to wait before.
    """

    def __init__(self, problem: Json, status: int) -> None:
        self.problem = problem
        self.status = status
        super().__init__(
            str(problem.get("detail") or problem.get("title") or f"HTTP status {status}"),
            device=_text(problem.get("device")),
            advice=_text(problem.get("advice")),
        )
        # each problem has its own: the service's errors come through one class here
        self.slug = str(problem.get("type", "")).removeprefix(_PREFIX) or "service-error"
        self.retryable = bool(problem.get("retryable", False))
        after: Any = problem.get("retry_after_s")
        self.retry_after_s: float | None = float(after) if isinstance(after, (int, float)) else None

    @property
    def job_id(self) -> str | None:
        """Of ``busy``: the job that holds the telescope."""
        return _text(self.problem.get("job_id"))

    @property
    def reasons(self) -> tuple[str, ...]:
        """Which limit, doubt or refusal it was."""
        return tuple(map(str, self.problem.get("reasons") or ()))


class JobFailed(ServiceError):
    """A job failed or was cancelled.

    Parameters
    ----------
    job : Job
        Ended.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        problem = job["problem"] or {"detail": f"the {job['kind']} was {job['state']}", "type": job["state"]}
        status: Any = problem.get("status", 0)
        super().__init__(problem, int(status))


def _text(value: object) -> str | None:
    return None if value is None else str(value)
