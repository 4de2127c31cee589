"""Time that jumps: nothing waits, nothing is lost, and what would break it is refused."""

from __future__ import annotations

import asyncio
import threading
import time
from datetime import UTC, datetime, timedelta

import pytest

from mountnav.clock import Clock
from mountnav.simulation.virtual_time import NothingWillHappen, VirtualClock, for_all_modules, run_virtually


def test_a_night_passes_in_a_moment_and_all_faces_are_one_time() -> None:
    start = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)
    clock = VirtualClock(start)
    taken: Clock = clock

    async def night() -> tuple[float, float, datetime]:
        before_s = taken.monotonic_s()
        await taken.sleep(36_000.0)
        return before_s, asyncio.get_running_loop().time(), taken.utc()

    real = time.monotonic()
    before_s, after_s, utc = run_virtually(night(), clock)
    assert time.monotonic() - real < 60.0
    assert after_s - before_s == pytest.approx(36_000.0, abs=1e-3)
    assert utc - start == pytest.approx(timedelta(hours=10), abs=timedelta(milliseconds=1))
    assert clock() == utc
    assert clock.monotonic() == after_s


def test_who_waits_less_long_is_woken_first_and_time_outs_are_virtual() -> None:
    clock, order = VirtualClock(), []

    async def waiting(seconds: float) -> None:
        await clock.sleep(seconds)
        order.append((seconds, round(clock.now_s - 1000.0, 3)))

    async def life() -> None:
        await asyncio.gather(*(waiting(seconds) for seconds in (300.0, 10.0, 7200.0, 0.5)))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(3600.0):
                await asyncio.Event().wait()

    run_virtually(life(), clock)
    assert order == [(0.5, 0.5), (10.0, 10.0), (300.0, 300.0), (7200.0, 7200.0)]
    assert clock.now_s == pytest.approx(1000.0 + 7200.0 + 3600.0, abs=1e-3)


def test_time_stands_while_a_thread_works() -> None:
    clock = VirtualClock()

    async def life() -> float:
        began = threading.Event()
        let = threading.Event()

        def work() -> float:
            began.set()
            assert let.wait(60.0)
            return clock.now_s

        async def others() -> float:
            await clock.sleep(5.0)
            return clock.now_s

        working, waiting = asyncio.create_task(asyncio.to_thread(work)), asyncio.create_task(others())

        def release() -> None:
            began.wait(60.0)
            time.sleep(0.05)
            let.set()

        threading.Thread(target=release).start()
        seen_s = await working
        assert not waiting.done()
        assert await waiting >= 1005.0
        return seen_s

    assert run_virtually(life(), clock) == 1000.0


def test_time_stands_for_a_thread_that_nobody_waits_for_any_more() -> None:
    clock = VirtualClock()
    ended_at: list[float] = []

    async def life() -> None:
        began = asyncio.Event()
        loop = asyncio.get_running_loop()

        def work() -> None:
            loop.call_soon_threadsafe(began.set)
            time.sleep(0.05)
            ended_at.append(clock.now_s)

        working = asyncio.create_task(asyncio.to_thread(work))
        await began.wait()
        working.cancel()
        with pytest.raises(asyncio.CancelledError):
            await working
        await clock.sleep(100.0)

    run_virtually(life(), clock)
    assert ended_at == [1000.0]


def test_what_would_break_it_is_refused() -> None:
    clock = VirtualClock()
    said: list[str] = []

    async def life() -> None:
        loop = asyncio.get_running_loop()

        def stranger() -> None:
            try:
                loop.call_soon_threadsafe(said.append, "woken")
            except RuntimeError as refusal:
                said.append(str(refusal))

        thread = threading.Thread(target=stranger)
        thread.start()
        thread.join()
        with pytest.raises(RuntimeError, match="lines to the outside"):
            await asyncio.open_connection("127.0.0.1", 9)

    run_virtually(life(), clock)
    assert len(said) == 1
    assert "doesn't know" in said[0]


def test_a_hang_is_told_and_doesnt_hang() -> None:
    async def life() -> None:
        await asyncio.Event().wait()

    with pytest.raises(NothingWillHappen, match="hang"):
        run_virtually(life(), VirtualClock())


def test_one_clock_goes_from_run_to_run() -> None:
    clock = VirtualClock()
    for number in range(1, 4):
        run_virtually(clock.sleep(10.0), clock)
        assert clock.now_s == pytest.approx(1000.0 + 10.0 * number, abs=1e-3)


def test_everybody_takes_the_clock_for_the_present_and_gives_it_back() -> None:
    from drivers.lx200 import readings
    from mountnav import clock as clock_module

    clock = VirtualClock()
    real = clock_module.utc_now
    for _ in range(2):
        with for_all_modules(clock):
            assert clock_module.utc_now() == clock.utc()
            assert vars(readings)["utc_now"] is clock
        assert clock_module.utc_now is real
        assert vars(readings)["utc_now"] is real
