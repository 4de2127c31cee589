"""A safety file that hangs, lies about its age or is none: then it isn't safe, and nothing else waits."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import api.nights.safety_file
from api.nights.safety_file import SafetyFile, unsafe_by_file
from mountnav.files import read_bytes
from tests.api.nights.night_site import night_toml, served


def test_what_is_no_file_says_nothing_safe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert "a pipe" in unsafe_by_file(pipe, 300, time.time)
    assert "a device" in unsafe_by_file(Path("/dev/zero"), 1e12, time.time)
    assert "a folder" in unsafe_by_file(tmp_path, 300, time.time)
    long = tmp_path / "log.txt"
    long.write_text("safe " * 20_000)
    assert "longer" in unsafe_by_file(long, 300, time.time)


def test_a_file_from_a_clock_that_is_ahead_would_never_be_old(tmp_path: Path) -> None:
    file = tmp_path / "safety.txt"
    file.write_text("safe")
    os.utime(file, (1e9 + 4.0, 1e9 + 4.0))
    assert unsafe_by_file(file, 300, lambda: 1e9) == ""
    os.utime(file, (1e9 + 3600.0, 1e9 + 3600.0))
    assert "3600 s after now" in unsafe_by_file(file, 300, lambda: 1e9)


async def test_a_file_that_hangs_is_answered_for_in_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, back = tmp_path / "safety.txt", threading.Event()
    file.write_text("safe")
    begun: list[Path] = []

    def from_a_share_that_is_gone(path: Path, most: int) -> bytes:
        begun.append(path)
        back.wait()
        return read_bytes(path, most)

    monkeypatch.setattr(api.nights.safety_file, "read_bytes", from_a_share_that_is_gone)
    safety = SafetyFile(file, 300, look_s=0.05)
    for _ in range(3):
        assert "no answer" in await safety.look()
    assert len(begun) == 1, "one thread waits, not one for each look"
    back.set()
    async with asyncio.timeout(60):
        while await safety.look():
            pass
    monkeypatch.setattr(api.nights.safety_file, "read_bytes", lambda path, most: 1 // 0)
    assert "ZeroDivisionError" in await safety.look()


@pytest.mark.long
async def test_what_the_file_says_and_what_is_said_are_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))
    monkeypatch.setattr("api.nights.nights.TICK_S", 0.05)
    folder, record, safety = tmp_path / "frames", tmp_path / "recordings", tmp_path / "safety.txt"
    (folder / "elsewhere").mkdir(parents=True)
    safety.write_text("safe")
    toml = night_toml(folder, record, safety)

    async def until(words: str | None) -> dict[str, Any]:
        async with asyncio.timeout(60):
            while True:
                night: dict[str, Any] = await site.night()
                if night["unsafe_why"] == words:
                    return night
                await asyncio.sleep(0.02)

    async with served(toml, folder, record, safety) as site:
        await site.said("start")
        said = await site.client.post("/v1/telescopes/east/night/safety", json={"safe": False, "why": "wind"})
        assert said.json()["unsafe_why"] == "wind"
        safety.write_text("rain")
        await until("wind; the safety file says 'rain'")
        # the roof's sensor is dry again: the wind has not gone by that
        safety.write_text("safe")
        assert (await until("wind"))["holds"] == ["not safe"]
        safety.write_text("rain")
        await until("wind; the safety file says 'rain'")
    # it became safe while the service was away: of the file's word nothing is left, of the other all
    safety.write_text("safe")
    async with served(toml, folder, record, safety) as site:
        assert (await until("wind"))["holds"] == ["not safe"]
        said = await site.client.post("/v1/telescopes/east/night/safety", json={"safe": True})
        assert said.json()["holds"] == []
        safety.write_text("rain")
        await until("the safety file says 'rain'")
    # nor when no file is named any more
    without = "\n".join(line for line in toml.splitlines() if not line.startswith("safety_"))
    async with served(without, folder, record, safety) as site:
        assert (await until(None))["holds"] == []
