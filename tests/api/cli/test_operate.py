"""An operator's commands, as they are typed, against a service on a real socket."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from api.cli.app import app
from api.cli.operate_targets import TargetOptions
from mountnav.errors import BadRequest
from tests.client.test_client import Served, served


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One for all."""
    patch = pytest.MonkeyPatch()
    patch.setenv("MOUNTNAV_JOURNAL", str(tmp_path_factory.mktemp("operate") / "journal.sqlite"))
    with served() as one:
        yield one
    patch.undo()


def run(service: str, *words: str) -> Result:
    return CliRunner().invoke(app, [*words, "--service", service])


def told(service: str, *words: str) -> tuple[int, dict[str, Any]]:
    """The exit code, and what --json printed: one object on one line, nothing else."""
    result = run(service, *words, "--json")
    (line,) = result.stdout.splitlines()
    answer = json.loads(line)
    assert set(answer) == {"command", "ok", "telescope", "answer", "problem"}
    assert answer["command"] == words[0]
    assert answer["ok"] is (result.exit_code == 0) is (answer["problem"] is None)
    return result.exit_code, answer


@pytest.mark.long
def test_status_tells_where_it_points(service: Served) -> None:
    result = run(service.url, "status")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith("east: ")
    assert "(ICRS); altitude" in result.stdout
    code, answer = told(service.url, "status", "east")
    assert code == 0
    assert answer["answer"]["id"] == "east"


@pytest.mark.long
def test_orders_are_carried_out_to_their_end(service: Served) -> None:
    _, state = told(service.url, "status", "east")
    place = state["answer"]["icrs"]
    where = f"{place['ra_deg']:.5f}, {place['dec_deg'] - 2.0:+.5f}"
    code, answer = told(service.url, "center", where, "--tolerance", "30")
    assert code == 0, answer["problem"]
    assert answer["answer"]["state"] == "succeeded"
    assert answer["answer"]["request"]["target"] == {"kind": "typed", "text": where, "frame": "icrs"}
    assert answer["answer"]["result"]["error_after_arcsec"] < 30.0
    look = run(service.url, "look", "-t", "east")
    assert look.exit_code == 0
    assert "points at RA" in look.stdout
    # its way stands on the other stream
    assert "solved: " in look.stderr
    assert "solved: " not in look.stdout


@pytest.mark.long
def test_what_is_refused_has_a_code_and_one_line_of_words(service: Served) -> None:
    code, answer = told(service.url, "center", "No Such Star")
    assert (code, answer["ok"]) == (2, False)
    code, answer = told(service.url, "look", "-t", "nowhere")
    assert code == 2
    assert "there is: east" in answer["problem"]["advice"]
    below = run(service.url, "slew", "--altaz=-10,180")
    assert below.exit_code == 1
    (line,) = [line for line in below.stderr.splitlines() if line.startswith("mountnav: ")]
    assert "below" in line or "altitude" in line
    assert below.stdout == ""


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("center",),
        ("center", "Vega", "--altaz", "60,180"),
        ("center", "--altaz", "60"),
        ("center", "--altaz", "60,180", "--rates", "1,2"),
        ("center", "Vega", "--rates", "1,2"),
        ("slew", "--tle", "/there/is/no/such/file"),
        ("track", "sideways"),
        ("track", "rates", "--ra", "0.1"),
        ("track", "lunar", "--ra", "0.1"),
        ("follow", "Vega"),
        ("follow", "Vega", "--for", "60", "--until", "2026-11-26T03:00"),
    ],
)
def test_what_makes_no_sense_is_code_2_and_orders_nothing(service: Served, words: tuple[str, ...]) -> None:
    before = run(service.url, "status", "--json").stdout.count("job_id")
    code, answer = told(service.url, *words)
    assert code == 2
    assert answer["answer"] is None
    assert answer["problem"]["detail"]
    assert before == 1


@pytest.mark.long
def test_stop_asks_nothing_before(service: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    import httpx

    request = httpx.Client.request

    def noted(self: httpx.Client, method: str, url: Any, **arguments: Any) -> httpx.Response:
        asked.append(f"{method} {url}")
        return request(self, method, url, **arguments)

    monkeypatch.setattr(httpx.Client, "request", noted)
    code, answer = told(service.url, "stop")
    assert code == 0, answer
    assert asked == ["POST /v1/stop"]
    assert run(service.url, "stop", "east").stdout.startswith("east: stopped")


@pytest.mark.long
def test_stop_ends_what_runs(service: Served) -> None:
    started = run(service.url, "look", "--exposure", "60", "--detach")
    assert started.exit_code == 0, started.stderr
    stopped = run(service.url, "stop")
    assert stopped.exit_code == 0
    assert "was cancelled" in stopped.stdout
    # a second one has nothing to cancel, and is fine
    assert "was cancelled" not in run(service.url, "stop").stdout


@pytest.mark.long
def test_no_service_is_said_so(unused_port: str) -> None:
    code, answer = told(unused_port, "stop")
    assert code == 1
    assert "no mountnav service answers" in answer["problem"]["detail"]
    words = run(unused_port, "status")
    assert words.exit_code == 1
    assert words.stderr.startswith("mountnav: ")
    assert len(words.stderr.splitlines()) == 1


@pytest.fixture
def unused_port() -> str:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"http://127.0.0.1:{listener.getsockname()[1]}"


def _page(status: bytes, body: bytes) -> bytes:
    return b"HTTP/1.1 %s\r\nContent-Length: %d\r\nConnection: close\r\n\r\n%s" % (status, len(body), body)


@pytest.mark.parametrize(
    "page",
    [
        _page(b"200 OK", b"hello"),
        _page(b"404 Not Found", b"<!DOCTYPE HTML>\n<html>\n<head>\n<title>Error</title>\n</head>\n"),
        _page(b"502 Bad Gateway", b""),
        b"SSH-2.0-OpenSSH_9.2\r\n",
    ],
    ids=["words", "page", "empty", "ssh"],
)
def test_something_else_that_answers_is_no_service(page: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"

        def answer() -> None:
            near, _ = listener.accept()
            with near:
                near.recv(65536)
                near.sendall(page)

        answering = threading.Thread(target=answer)
        answering.start()
        result = run(url, "stop")
        answering.join()
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert "no mountnav service" in line
    assert len(line) < 240


@pytest.mark.parametrize("url", ["localhost:8000", "ftp://127.0.0.1", "", "http://[::1"])
def test_what_is_no_address_is_code_2(url: str) -> None:
    result = run(url, "status")
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert "that is not the address of a service" in line


# -- targets -----------------------------------------------------------------------------------------


def test_a_text_is_a_position_or_a_name() -> None:
    assert TargetOptions(target="M31").chosen() == {"kind": "name", "name": "M31"}
    assert TargetOptions(target="05h34m31.9s +22d00m52s").chosen()["kind"] == "typed"
    assert TargetOptions(altaz="60, 170").chosen() == {"kind": "altaz", "alt_deg": 60.0, "az_deg": 170.0}


def test_a_file_that_is_too_large_is_refused(tmp_path: Path) -> None:
    large = tmp_path / "table.csv"
    large.write_bytes(b"x" * (1 << 20) + b"x")
    with pytest.raises(BadRequest, match="larger than 1 MB"):
        TargetOptions(table=large).chosen()
