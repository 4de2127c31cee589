"""systemd is told when the service is up, that its loop turns, and that it goes down."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from api.http.service_manager import ServiceManager
from tests.conftest import ROOT

pytestmark = pytest.mark.long

WATCHDOG_S = 1.5


@pytest.mark.parametrize("abstract", [False, True])
def test_a_served_observatory_tells_its_manager(
    abstract: bool, tmp_path: Path, observatory_toml: str
) -> None:
    config = tmp_path / "observatory.toml"
    config.write_text(observatory_toml)
    name = f"@mountnav-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name[1:] if abstract else name)
        manager.settimeout(120)
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": name,
            "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)),
            "MOUNTNAV_JOURNAL": str(tmp_path / "journal.sqlite"),
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            said = [manager.recv(4096).decode()]
            while not any(one.startswith("READY=1") for one in said):
                said.append(manager.recv(4096).decode())
            ready = next(one for one in said if one.startswith("READY=1"))
            assert "STATUS=observatory at http://127.0.0.1:" in ready
            assert "east" in ready
            fed = 0
            while fed < 3:
                fed += manager.recv(4096) == b"WATCHDOG=1"
            process.send_signal(signal.SIGTERM)
            while not manager.recv(4096).startswith(b"STOPPING=1"):
                pass
            assert process.wait() in {0, -signal.SIGTERM}
        finally:
            process.kill()
            process.wait()


def test_a_watchdog_of_another_process_is_not_fed() -> None:
    given = {"NOTIFY_SOCKET": "/run/none", "WATCHDOG_USEC": "2000000"}
    assert ServiceManager(given).watchdog_s == 2.0
    assert ServiceManager(given | {"WATCHDOG_PID": str(os.getpid())}).watchdog_s == 2.0
    assert ServiceManager(given | {"WATCHDOG_PID": "1"}).watchdog_s is None


@pytest.mark.parametrize("word", ["", "0", "-5", "soon", "1e6", "٣", "9" * 40])
def test_a_span_that_makes_no_sense_is_none(word: str) -> None:
    assert ServiceManager({"WATCHDOG_USEC": word}).watchdog_s is None


def test_a_manager_that_is_gone_keeps_nobody_from_work(caplog: pytest.LogCaptureFixture) -> None:
    ServiceManager({"NOTIFY_SOCKET": "/there/is/none"}).tell("READY=1")
    assert "READY=1" in caplog.text
    ServiceManager({}).tell("READY=1")


def test_the_unit_leaves_little_to_attack() -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not on this machine")
    unit = str(ROOT / "deploy" / "mountnav.service")
    done = subprocess.run(
        [analyze, "security", "--offline=yes", "--threshold=25", unit], capture_output=True, text=True
    )
    if "unrecognized option" in done.stderr or "Unknown option" in done.stderr:
        pytest.skip("this systemd-analyze can't judge a file")
    assert done.returncode == 0, done.stdout[-300:] + done.stderr


def test_the_unit_reads_the_settings_again_by_a_command_that_is_there() -> None:
    unit = (ROOT / "deploy" / "mountnav.service").read_text().splitlines()
    (command,) = (line.partition("=")[2].split() for line in unit if line.startswith("ExecReload="))
    (start,) = (line.partition("=")[2].split() for line in unit if line.startswith("ExecStart="))
    assert command[0] == start[0]
    # nobody answers there: told plainly, and the code by which systemctl reload fails
    done = subprocess.run(
        [sys.executable, "-m", "api.main", *command[1:], "--service", "http://127.0.0.1:1"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert "no mountnav service answers" in done.stderr


def _ended(config: Path) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "api.main", "serve", "--config", str(config)], capture_output=True, text=True
    )
    return done.returncode, done.stderr


def test_what_starting_again_would_not_help_is_not_started_again(
    tmp_path: Path, observatory_toml: str
) -> None:
    unit = (ROOT / "deploy" / "mountnav.service").read_text().splitlines()
    (kept_down,) = (line.partition("=")[2].split() for line in unit if line.startswith("RestartPrevent"))
    damaged = tmp_path / "damaged.sqlite"
    damaged.write_text("no database at all, and long enough to be taken for one " * 30)
    config = tmp_path / "observatory.toml"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for text, said in (
            ("nonsense = [", "not TOML"),
            (observatory_toml.replace("[service]", "[service]\nunknown = 3"), "no such setting"),
            (observatory_toml.replace("port = 0", f"port = {port}"), "can't listen"),
            (f"{observatory_toml}\n[journal]\nurl = '{damaged}'", "it is damaged"),
        ):
            config.write_text(text)
            code, stderr = _ended(config)
            assert said in stderr, stderr
            assert str(code) in kept_down, (said, code)
    # and the program that is gone, as systemd counts it (EXIT_EXEC), is not tried each 5 s for ever
    assert "203" in kept_down
