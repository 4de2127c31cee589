"""A typed client of our own HTTP API, for schedulers and the demo."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import httpx

from mountnav.errors import MountnavError

Json = dict[str, Any]


class ServiceError(MountnavError):
    """The service answered with a problem (RFC 9457); `problem` holds it whole."""

    slug = "service-error"

    def __init__(self, problem: Json, status: int) -> None:
        self.problem = problem
        self.status = status
        super().__init__(str(problem.get("detail") or problem.get("title") or f"HTTP status {status}"))


@dataclass(frozen=True, slots=True)
class ServerEvent:
    """One server-sent event."""

    event_id: str
    kind: str
    data: Json


class Client:
    """Talks to one mountnav service.

    Parameters
    ----------
    base_url : str
        Such as ``http://127.0.0.1:8000``.
    token : str, optional
        API token.
    timeout_s : float
        For each request; waiting for a job has its own.
    """

    def __init__(self, base_url: str, *, token: str | None = None, timeout_s: float = 10.0) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx.Client(base_url=base_url, headers=headers, timeout=timeout_s, trust_env=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the connection."""
        self._http.close()

    def telescope(self, telescope_id: str) -> Json:
        """State of one telescope."""
        return self._json("GET", f"/v1/telescopes/{telescope_id}")

    def center(self, telescope_id: str, ra_deg: float, dec_deg: float, **options: float) -> Json:
        """Start a centering on an ICRS place; the job. Options: tolerance_arcsec, max_tries, timeout_s."""
        body = {"ra_deg": ra_deg, "dec_deg": dec_deg, "frame": "icrs", **options}
        return self._json("POST", f"/v1/telescopes/{telescope_id}/center", json=body)

    def recover(self, telescope_id: str) -> Json:
        """Start the recovery of a mount that doesn't know where it points; the job. Moves nothing."""
        return self._json("POST", f"/v1/telescopes/{telescope_id}/recover")

    def stop(self, telescope_id: str) -> Json:
        """Stop all motion now."""
        return self._json("POST", f"/v1/telescopes/{telescope_id}/stop")

    def job(self, job_id: str, *, wait_s: float = 0.0) -> Json:
        """A job; with `wait_s`, when it has ended or that time has passed."""
        return self._json("GET", f"/v1/jobs/{job_id}", params={"wait": wait_s}, timeout=wait_s + 10.0)

    def cancel(self, job_id: str) -> Json:
        """End a job; the mount is stopped."""
        return self._json("DELETE", f"/v1/jobs/{job_id}")

    def events(self, *, after: str | None = None) -> Iterator[ServerEvent]:
        """Events as they come, from now or from after the event with id `after`; ends with the connection."""
        headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": after} if after is not None else {})
        with self._http.stream("GET", "/v1/events", headers=headers, timeout=None) as response:
            response.raise_for_status()
            fields: dict[str, str] = {}
            for line in response.iter_lines():
                if line:
                    name, _, value = line.partition(":")
                    fields[name] = value.removeprefix(" ")
                elif "data" in fields:
                    yield ServerEvent(
                        fields.get("id", ""), fields.get("event", ""), json.loads(fields["data"])
                    )
                    fields = {}

    def _json(self, method: str, path: str, **arguments: Any) -> Json:
        response = self._http.request(method, path, **arguments)
        body: Json = response.json() if response.content else {}
        if response.is_error:
            raise ServiceError(body, response.status_code)
        return body
