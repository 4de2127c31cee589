"""A closed terminal (SIGHUP) ends the service as SIGTERM does: what moves is stopped first."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from mountnav.journal.reading import JournalReader
from tests.api.conftest import OBSERVATORY


@pytest.mark.parametrize("number", [signal.SIGHUP, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_slewing_mount_is_stopped(tmp_path: Path, number: signal.Signals) -> None:
    config, journal = tmp_path / "observatory.toml", tmp_path / "night.sqlite"
    config.write_text(OBSERVATORY.replace("slew_rate_deg_s = 45.0", "slew_rate_deg_s = 0.5"))
    process = subprocess.Popen(
        [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"MOUNTNAV_JOURNAL": str(journal)},
        # whoever runs the tests may have been begun by nohup, which children inherit
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    assert process.stdout is not None
    try:
        url = process.stdout.readline().split()[-1]
        with httpx.Client(base_url=url, trust_env=False, timeout=120) as client:
            target = {"target": {"kind": "altaz", "alt_deg": 50.0, "az_deg": 170.0}}
            while True:
                try:
                    answer = client.post("/v1/telescopes/east/slew", json=target)
                    break
                except httpx.TransportError:
                    assert process.poll() is None
            assert answer.status_code == 202, answer.text
            while not client.get("/v1/telescopes/east").json()["slewing"]:
                assert process.poll() is None
        process.send_signal(number)
        process.wait(60)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    reader = JournalReader(journal)
    orders = [(command.order, end) for command, end in reader.commands()]
    assert "stop" in [order for order, _ in orders], orders
    assert all(end is not None for _, end in orders)
    assert reader.runs()[-1].ended_utc is not None
