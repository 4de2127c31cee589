"""kill -9 amid a centering, with a real process, driver, line and journal: nothing lost, nothing twice."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from benchmarks.killed import Kill, Received, compared, steps_of, tried
from mountnav.clock import utc_now
from mountnav.journal.records import CommandEnd, CommandRecord, Outcome, new_id
from mountnav.journal.restart import Likely
from mountnav.sky.coordinates import Icrs

# what is worst: written and not sent, on its way, done and not closed; of a slew and of a sync
WORST = (
    Kill(named="slew begun"),
    Kill(named="slew on the wire"),
    Kill(named="sync on the wire"),
    Kill(named="sync sent"),
)


@pytest.mark.long
def test_killed_at_the_worst_moments_nothing_is_lost_and_nothing_happens_twice(tmp_path: Path) -> None:
    results = tried(tmp_path, list(WORST))
    for kill, (life, wrong) in zip(WORST, results, strict=True):
        assert life.killed, f"{kill} was never reached: {life.steps}"
        assert life.steps[-1] == kill.named
        assert wrong == [], f"{kill}: {wrong}"


@pytest.mark.long
def test_killed_at_any_moment_nothing_is_lost(tmp_path: Path) -> None:
    steps = steps_of(tmp_path)
    assert {"slew begin", "slew ended", "sync begin", "sync ended", "look exposed"} <= set(steps)
    # a third of the steps, all of them in the benchmark
    kills = [Kill(at=number) for number in range(2, len(steps) + 1, 3)]
    results = tried(tmp_path, kills)
    assert sum(life.killed for life, _ in results) >= len(kills) - 1
    assert [f"{kill}: {wrong}" for kill, (_, wrong) in zip(kills, results, strict=True) if wrong] == []


# -- the comparison itself can fail ------------------------------------------------------------------------

HERE = Icrs(80.0, 30.0)
NOW = utc_now()


def row(outcome: Outcome | None, after_s: float = 0.0) -> tuple[CommandRecord, CommandEnd | None]:
    command = CommandRecord(new_id(), "rig", NOW + timedelta(seconds=after_s), "slew", "s", place=HERE)
    return command, None if outcome is None else CommandEnd(NOW, outcome)


def came(after_s: float) -> Received:
    return Received("slew", NOW + timedelta(seconds=after_s), HERE)


def test_what_is_right_is_found_right() -> None:
    assert compared([row(Outcome.DONE), row(Outcome.NOT_SENT, 5.0)], [came(1.0)], {}) == []
    assert compared([row(Outcome.UNKNOWN)], [], {}) == []


def test_an_order_that_came_twice_is_found() -> None:
    assert compared([row(Outcome.DONE)], [came(1.0), came(2.0)], {}) != []


def test_an_order_that_is_not_written_or_written_later_is_found() -> None:
    assert compared([], [came(1.0)], {}) != []
    assert compared([row(Outcome.DONE, 5.0)], [came(1.0)], {}) != []
    assert compared([row(Outcome.DONE)], [replace(came(1.0), place=Icrs(81.0, 30.0))], {}) != []


def test_an_outcome_that_is_not_true_is_found() -> None:
    assert compared([row(Outcome.DONE)], [], {}) != []
    assert compared([row(Outcome.NOT_SENT)], [came(1.0)], {}) != []
    unknown = row(Outcome.UNKNOWN)
    identity = unknown[0].command_id
    assert compared([unknown], [came(1.0)], {identity: Likely.NOT_CARRIED_OUT}) != []
    assert compared([unknown], [], {identity: Likely.CARRIED_OUT}) != []
