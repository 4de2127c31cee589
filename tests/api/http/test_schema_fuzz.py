"""The whole described interface fuzzed at a running service: no server error, no answer beside its schema."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from benchmarks.schema_fuzz import STREAMS, TOKEN, fuzz, server_errors, serving

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzzed")


@pytest.fixture(scope="module")
def port(folder: Path) -> Iterator[int]:
    with serving(folder) as served:
        yield served.port


@pytest.fixture(scope="module")
def job_id(port: int) -> str:
    """Of a job that has ended."""
    url = f"http://127.0.0.1:{port}/v1/telescopes/east/stop"
    headers = {"X-API-Key": TOKEN}
    # whatever was fuzzed before: a lease that it took may keep orders out, but never hides a job
    jobs = httpx.get(f"http://127.0.0.1:{port}/v1/jobs", headers=headers, trust_env=False).json()
    if jobs:
        return str(jobs[0]["id"])
    assert httpx.post(url, headers=headers, timeout=60, trust_env=False).status_code == 200
    order = url.replace("/stop", "/unpark?wait=60")
    return str(httpx.post(order, headers=headers, timeout=120, trust_env=False).json()["id"])


@pytest.mark.parametrize(
    "options",
    [
        # every bound of every parameter; a few examples more of what fits
        pytest.param(("--mode", "positive", "--max-examples", "1"), id="fits"),
        # what doesn't fit is sampled here, and covered by `python -m benchmarks.schema_fuzz`
        pytest.param(("--mode", "negative", "--max-examples", "1", "--phases", "fuzzing"), id="doesnt"),
    ],
)
def test_no_server_error_and_no_answer_beside_the_schema(
    port: int, folder: Path, options: tuple[str, ...]
) -> None:
    # in CI the same examples each time, as hypothesis' own tests there
    seed = ("--seed", "20261126") if os.environ.get("CI") else ()
    done = fuzz(port, folder, (*options, *seed))
    assert done.returncode == 0, done.stdout + done.stderr
    # it did ask: every operation but the streams
    told = re.search(r"Operations: +(\d+) selected / (\d+) total", done.stdout)
    assert told is not None, done.stdout
    assert int(told[1]) == int(told[2]) - len(_streams(port)) > 50
    assert server_errors(folder) == []


@pytest.mark.parametrize(
    "last_event_id", [None, "", "0", "abc-3", "x" * 100, "-1", "deadbeef-99999999999999999999"]
)
def test_event_streams_begin_as_described(port: int, job_id: str, last_event_id: str | None) -> None:
    headers = {"X-API-Key": TOKEN} | ({} if last_event_id is None else {"Last-Event-ID": last_event_id})
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60, trust_env=False) as client:
        for path in _streams(port):
            asked = path.format(telescope_id="east", job_id=job_id)
            with client.stream("GET", asked, headers=headers) as stream:
                assert stream.status_code == 200, asked
                assert stream.headers["content-type"].startswith("text/event-stream")
                assert next(stream.iter_lines()).startswith(":")
            if path != asked:
                wrong = client.get(path.format(telescope_id="none", job_id="none"), headers=headers)
                assert wrong.status_code == 404
                assert wrong.headers["content-type"] == "application/problem+json"


def test_streams_refuse_what_the_schema_refuses(port: int) -> None:
    base = f"http://127.0.0.1:{port}"
    for path in _streams(port):
        url = base + path.format(telescope_id="east", job_id="none")
        headers = {"X-API-Key": TOKEN, "Last-Event-ID": "x" * 101}
        assert httpx.get(url, headers=headers, trust_env=False).status_code in (404, 422)
        assert httpx.get(url, trust_env=False).status_code == 401


def _streams(port: int) -> list[str]:
    answer = httpx.get(f"http://127.0.0.1:{port}/openapi.json", trust_env=False)
    paths: dict[str, Any] = json.loads(answer.text)["paths"]
    found = [path for path in paths if re.search(STREAMS, path)]
    assert len(found) >= 3
    return found
