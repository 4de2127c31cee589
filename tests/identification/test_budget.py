"""A budget is processor time: waiting costs nothing of it, up to a wall limit; computing does."""

from __future__ import annotations

import time

import pytest

from mountnav.identification.budget import Budget, wall_limit_s


class Clocks:
    def __init__(self) -> None:
        self.cpu_s, self.wall_s = 100.0, 5000.0


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    clocks = Clocks()
    monkeypatch.setattr(time, "thread_time", lambda: clocks.cpu_s)
    monkeypatch.setattr(time, "monotonic", lambda: clocks.wall_s)
    return clocks


def test_waiting_for_a_core_is_not_counted(clocks: Clocks) -> None:
    one = Budget.of(30.0)
    clocks.wall_s += 100.0  # where a wall budget was over after 30 s with 4.5 s computed
    clocks.cpu_s += 4.5
    assert not one.spent
    assert one.left_s == pytest.approx(25.5)
    clocks.cpu_s += 25.6
    assert one.spent
    assert one.left_s == 0.0


def test_the_wall_limit_holds_all_the_same(clocks: Clocks) -> None:
    one = Budget.of(2.0)
    assert wall_limit_s(2.0) == 26.0
    clocks.wall_s += 25.9
    assert not one.spent
    clocks.wall_s += 0.2
    assert one.spent
    assert one.left_s == 0.0


def test_real_clocks_tell_computing_from_waiting() -> None:
    one = Budget.of(0.05)
    time.sleep(0.1)
    assert not one.spent
    began = time.thread_time()
    while not one.spent:
        pass
    assert time.thread_time() - began < 1.0
