"""The service's log: whoever writes, and whatever, it is one line with its level and its UTC."""

from __future__ import annotations

import io
import json
import logging
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from api.http.service_log import begin_log, form_for


@pytest.fixture
def root() -> Iterator[logging.Logger]:
    """The root logger, as it was."""
    logger = logging.getLogger()
    handlers, level, factory = list(logger.handlers), logger.level, logging.getLogRecordFactory()
    quiet = {name: logging.getLogger(name).level for name in ("httpx", "httpcore", "alembic")}
    yield logger
    logger.handlers[:] = handlers
    logger.setLevel(level)
    logging.setLogRecordFactory(factory)
    logging.captureWarnings(False)
    for name, before in quiet.items():
        logging.getLogger(name).setLevel(before)


def _fault() -> None:
    raise ValueError("mnk_" + "a" * 43)


def _written(form: str) -> str:
    stream = io.StringIO()
    begin_log(form, "info", stream)  # type: ignore[arg-type]
    begin_log(form, "info", stream)  # type: ignore[arg-type]
    log = logging.getLogger("test.of.lines")
    log.debug("not this")
    log.info("slew to %s", "M 13 \u2033 \U0001f52d")
    try:
        _fault()
    except ValueError:
        log.exception("a fault")
    return stream.getvalue()


def test_text_has_the_instant_in_utc_and_one_line_for_each(root: logging.Logger) -> None:
    lines = _written("text").splitlines()
    assert re.fullmatch(
        r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z INFO     test.of.lines: slew to M 13 \u2033 \U0001f52d",
        lines[0],
    )
    assert " ERROR    test.of.lines: a fault" in lines[1]
    assert all(line.startswith("    ") for line in lines[2:])
    assert lines[-1] == "    ValueError: mnk_***"


def test_journald_gets_priorities_and_adds_the_instant_itself(root: logging.Logger) -> None:
    lines = _written("journald").splitlines()
    assert lines[0].startswith("<6>test.of.lines: slew to M 13")
    assert {line[:3] for line in lines[1:]} == {"<3>"}


def test_json_is_an_object_a_line(root: logging.Logger) -> None:
    told = [json.loads(line) for line in _written("json").splitlines()]
    assert [one["level"] for one in told] == ["info", "error"]
    assert told[0]["message"] == "slew to M 13 \u2033 \U0001f52d"
    assert told[1]["exception"].endswith("ValueError: mnk_***")
    assert set(told[0]) == {"utc", "level", "logger", "message"}
    # it logs whole addresses, and those of webhooks are secrets
    assert not logging.getLogger("httpx").isEnabledFor(logging.INFO)


def test_journald_is_known_by_its_own_socket_alone(tmp_path: Path) -> None:
    mine, _other = socket.socketpair()
    with mine, _other, os.fdopen(os.dup(mine.fileno()), "w") as stream:
        found = os.fstat(stream.fileno())
        told = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        assert form_for("auto", stream, told) == "journald"
        assert form_for("json", stream, told) == "json"
        assert form_for("auto", stream, {"JOURNAL_STREAM": "1:2"}) == "text"
        assert form_for("auto", stream, {}) == "text"
    with (tmp_path / "file").open("w") as file:
        found = os.fstat(file.fileno())
        assert form_for("auto", file, {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}) == "text"
    assert form_for("auto", io.StringIO(), {"JOURNAL_STREAM": "1:2"}) == "text"


@pytest.mark.long
def test_a_service_says_its_fingerprint_and_logs_json(tmp_path: Path) -> None:
    """The process itself: https, each line of its standard error JSON, the audit's place among them."""
    words = ["-m", "api.main", "serve", "--demo", "--port", "0", "--tls", "self", "--log-form", "json"]
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stdout is not None
    told = ""
    for line in process.stdout:
        told += line
        if "fingerprint" in line:
            break
    assert "observatory at https://127.0.0.1:" in told
    assert re.search(r"SHA-256 fingerprint ([0-9A-F]{2}:){31}[0-9A-F]{2}", told)
    assert process.stderr is not None
    begun = ""
    for line in process.stderr:
        begun += line
        if "Application startup complete" in line:
            break
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=120)
    records = [json.loads(line) for line in f"{begun}{errors}".splitlines()]
    assert all(set(one) <= {"utc", "level", "logger", "message", "exception"} for one in records)
    assert "uvicorn.error" in {one["logger"] for one in records}
    assert "the service ends; the audit stands at" in str(records)
