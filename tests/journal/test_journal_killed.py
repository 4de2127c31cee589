"""kill -9 at any moment: what was awaited is there, whole; what is in flight is known."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mountnav.journal.database import database_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import Outcome
from mountnav.journal.upkeep import check

ROOT = Path(__file__).resolve().parents[2]


def _kill_while_writing(
    url: str, after_s: float, *, after: str = "begun"
) -> tuple[dict[str, int], dict[str, int]]:
    """Start a writer, kill it after it has written for a while; what it said had begun and ended.

    The while counts from the first word `after`, however long a busy machine takes to get there.
    """
    child = subprocess.Popen(
        [sys.executable, "-m", "tests.journal.killed_writer", url],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    lines = [child.stdout.readline()]
    while lines[-1] and not lines[-1].startswith(after):
        lines.append(child.stdout.readline())
    time.sleep(after_s)
    child.kill()
    lines += child.stdout.readlines()
    child.wait()
    child.stdout.close()
    told: tuple[dict[str, int], dict[str, int]] = ({}, {})
    for line in lines:
        if line.endswith("\n"):  # the last one may be cut
            what, command_id, number = line.split()
            told[what == "ended"][command_id] = int(number)
    return told


def _judge(url: str, begun: dict[str, int], ended: dict[str, int]) -> None:
    reader = JournalReader(url)
    kept = {command.command_id: (command, end) for command, end in reader.commands()}
    for command_id, number in begun.items():
        assert kept[command_id][0].facts["number"] == number
    for command_id, number in ended.items():
        end = kept[command_id][1]
        assert end is not None
        assert (end.outcome, end.detail) == (Outcome.DONE, f"end {number}")
    in_flight = reader.in_flight()
    # no torn row: all can be read, and one command per telescope at most was cut off by each kill
    assert {one.command_id for one in in_flight} == {one for one, (_, end) in kept.items() if end is None}
    assert not {one.command_id for one in in_flight} & set(ended)
    assert check(database_url(url)).damage == ()
    list(reader.story())


def _kill_again_and_again(url: str, times: int, seed: int) -> None:
    chance = random.Random(seed)
    begun: dict[str, int] = {}
    ended: dict[str, int] = {}
    for kills in range(1, times + 1):
        # the last one lives to see an end: else there is nothing to survive
        after = "ended" if kills == times else "begun"
        more_begun, more_ended = _kill_while_writing(url, chance.uniform(0.0, 0.15), after=after)
        begun |= more_begun
        ended |= more_ended
        _judge(url, begun, ended)
        assert len(JournalReader(url).in_flight()) <= 2 * kills
    assert ended


@pytest.mark.long
def test_what_was_awaited_survives_a_kill(file: Path) -> None:
    _kill_again_and_again(str(file), 2, seed=7)


@pytest.mark.long
def test_what_was_awaited_survives_many_kills(file: Path) -> None:
    _kill_again_and_again(str(file), 12, seed=11)


@pytest.mark.long
def test_what_was_awaited_survives_a_kill_on_postgresql(postgresql: str) -> None:
    _kill_again_and_again(postgresql, 3, seed=5)
