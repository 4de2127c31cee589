"""`mountnav serve --demo` as its users have it: a process of its own, ten times as fast, some night."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from api.demo.observatory import demo_service_settings, mount_errors_of_seed
from api.demo.targets import targets_up_now
from mountnav.catalog.embedded import embedded_catalog
from mountnav.settings.demo import DemoSettings
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

AT = datetime(2026, 12, 1, 22, 0, tzinfo=UTC)
SPEED, SEED = 10.0, 11
DEMO = "/v1/telescopes/demo"


@dataclass(slots=True)
class Observatory:
    """The running process."""

    process: subprocess.Popen[str]
    client: httpx.Client

    def now(self) -> dict[str, Any]:
        """What `/v1/virtual` tells."""
        answer = self.client.get("/v1/virtual")
        assert answer.status_code == 200, answer.text
        found: dict[str, Any] = answer.json()
        return found


@pytest.fixture(scope="module")
def observatory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Observatory]:
    state = tmp_path_factory.mktemp("state")
    command = [
        *(sys.executable, "-m", "api.main", "serve", "--demo", "--at", AT.isoformat()),
        *("--speed", str(SPEED), "--seed", str(SEED), "--port", "0"),
    ]
    environment = {**os.environ, "XDG_STATE_HOME": str(state), "TMPDIR": str(state)}
    environment.pop("MOUNTNAV_JOURNAL", None)
    with (
        (state / "log").open("w", encoding="utf-8") as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True, env=environment) as process,
    ):
        assert process.stdout is not None
        told = process.stdout.readline()
        try:
            assert " at http://" in told, (told, (state / "log").read_text(encoding="utf-8"))
            url = told.split(" at ")[1].split()[0]
            with httpx.Client(base_url=url, timeout=120, trust_env=False) as client:
                yield Observatory(process, client)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(60)
    # its journal was of this one run, also when it is ended so
    assert [path.name for path in state.iterdir()] == ["log"]


def test_a_target_is_centered_truly_and_all_of_it_in_virtual_time(observatory: Observatory) -> None:
    settings = demo_service_settings(DemoSettings(seed=SEED), 0)
    target, *_ = targets_up_now(AT, settings.site.site, settings.air.air, embedded_catalog(), count=1)

    before, began_s = observatory.now(), time.monotonic()
    order = {"ra_deg": target.position.ra_deg, "dec_deg": target.position.dec_deg}
    job = observatory.client.post(f"{DEMO}/center", json=order).json()
    job = observatory.client.get(f"/v1/jobs/{job['id']}", params={"wait": 100}).json()
    took_s, after = time.monotonic() - began_s, observatory.now()

    assert job["state"] == "succeeded", job
    assert settings.telescope[0].mount.errors == mount_errors_of_seed(SEED)
    # the mount pointed wrongly, and the truth is what the service says of it
    assert job["attempts"][0]["error_arcsec"] > 100.0
    (truth,) = after["truth"]
    truly_arcsec = separation_arcsec(Icrs(truth["ra_deg"], truth["dec_deg"]), target.position)
    assert truly_arcsec < 45.0
    assert truly_arcsec == pytest.approx(job["result"]["error_after_arcsec"], abs=15.0)

    # one time: jobs, journal and truth lie in the chosen night, in their order
    steps = [before["utc"], job["created_utc"], job["started_utc"], job["finished_utc"], after["utc"]]
    instants = [datetime.fromisoformat(step) for step in steps]
    assert instants == sorted(instants)
    assert AT <= instants[0] < AT.replace(day=2)
    # ten times as fast: the inner stretch is no longer than the outer one
    ran_s = (instants[3] - instants[1]).total_seconds()
    assert ran_s <= SPEED * (took_s + 0.05)
    assert (instants[4] - instants[0]).total_seconds() >= SPEED * took_s
    lines = observatory.client.get("/v1/journal", params={"limit": 200}).json()["lines"]
    times = [datetime.fromisoformat(line["utc"]) for line in lines]
    assert len(times) > 5
    assert min(times) >= AT
    assert max(times) <= instants[4]
    looks = observatory.client.get(f"{DEMO}/looks").json()["lines"]
    assert len(looks) >= len(job["attempts"])
    for look in looks:
        assert instants[1] <= datetime.fromisoformat(look["utc"]) <= instants[3]


@pytest.mark.long
def test_an_exposure_lasts_as_long_as_the_sky_says(observatory: Observatory) -> None:
    began_s = time.monotonic()
    job = observatory.client.post(f"{DEMO}/look", json={"exposure_s": 8.0}).json()
    job = observatory.client.get(f"/v1/jobs/{job['id']}", params={"wait": 100}).json()
    took_s = time.monotonic() - began_s
    assert job["state"] == "succeeded", job
    began, ended = (datetime.fromisoformat(job[name]) for name in ("started_utc", "finished_utc"))
    assert (ended - began).total_seconds() >= 8.0
    assert took_s >= 8.0 / SPEED - 0.01


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/v1/health", 200),
        ("GET", DEMO, 200),
        ("GET", "/v1/telescopes/none", 404),
        ("GET", "/nothing", 404),
        ("POST", f"{DEMO}/center", 422),
        ("GET", "/docs", 200),
        ("GET", "/management/apiversions", None),
        ("GET", "/", None),
    ],
)
def test_every_answer_says_that_it_is_virtual(
    observatory: Observatory, method: str, path: str, status: int | None
) -> None:
    body = {"ra_deg": "far"} if method == "POST" else None
    answer = observatory.client.request(method, path, json=body)
    assert status in (None, answer.status_code), answer.text
    _require_header(answer)


@pytest.mark.long
def test_event_streams_say_so_too(observatory: Observatory) -> None:
    with observatory.client.stream("GET", "/v1/events") as stream:
        _require_header(stream)


@pytest.mark.long
def test_health_and_capabilities_say_so(observatory: Observatory) -> None:
    for path in ("/v1/health", "/v1/capabilities"):
        virtual = observatory.client.get(path).json()["virtual"]
        assert virtual["speed"] == SPEED
        assert AT < datetime.fromisoformat(virtual["utc"]) < AT.replace(day=2)


def _require_header(answer: httpx.Response) -> None:
    said = dict(part.split("=") for part in answer.headers["Mountnav-Virtual"].split(", "))
    assert float(said["speed"]) == SPEED
    assert AT < datetime.fromisoformat(said["utc"]) < AT.replace(day=2)


@pytest.mark.long
def test_the_time_between_two_nights_passes_at_once_while_nothing_moves(observatory: Observatory) -> None:
    client = observatory.client
    if client.get(DEMO).json()["parked"]:
        client.post(f"{DEMO}/unpark", params={"wait": 60})
    assert client.post(f"{DEMO}/tracking", json={"on": True}, params={"wait": 60}).status_code == 200
    refused = client.post("/v1/virtual/skip", json={"until": "night"})
    assert refused.status_code == 409, refused.text
    assert "it tracks" in refused.json()["detail"]
    assert client.post(f"{DEMO}/park", params={"wait": 60}).json()["state"] == "succeeded"

    for wrong in ("2026-01-01T00:00:00Z", "2036-01-01T00:00:00Z"):
        assert client.post("/v1/virtual/skip", json={"until": wrong}).status_code == 422
    for unreadable in ("2026-12-05T00:00:00", "noon"):
        assert client.post("/v1/virtual/skip", json={"until": unreadable}).status_code == 422
    before = datetime.fromisoformat(observatory.now()["utc"])
    told = client.post("/v1/virtual/skip", json={"until": "night"})
    assert told.status_code == 200, told.text
    begins = datetime.fromisoformat(told.json()["utc"])
    assert before.date() < begins.date()
    assert 15 <= begins.hour <= 17
    # it was seen by the mount as well, and it works on
    assert client.get(DEMO).json()["parked"] is True
    assert client.post(f"{DEMO}/unpark", params={"wait": 60}).json()["state"] == "succeeded"
