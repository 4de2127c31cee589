"""What must not go on is ended: tried again, the mount stopped at last, and never given up."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from mountnav.errors import DeviceSilent
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import EntryKind
from mountnav.mount.ending import Ending
from mountnav.mount.order_book import OrderBook
from mountnav.simulation.virtual_time import VirtualClock, run_virtually


class Rig:
    """Something that goes on, on a mount that answers or keeps silent."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.journal = MemoryJournal()
        self.goes_on = True
        self.told: list[str] = []
        self.stops = 0
        self.ends: Callable[[], None] = self._end
        self.stopped: Callable[[], None] = lambda: None
        self.ending = Ending(
            "offset-rates",
            "the offset rates",
            once=self._once,
            stop=self._stop,
            owed=lambda: self.goes_on,
            book=OrderBook(self.journal, clock, "east"),
            clock=clock,
            tell=lambda what, facts: self.told.append(what),
        )

    def _end(self) -> None:
        self.goes_on = False

    async def _once(self, why: str) -> None:
        self.ends()

    async def _stop(self, why: str) -> None:
        self.stops += 1
        self.stopped()

    @property
    def faults(self) -> list[str]:
        return [one.what for one in self.journal.entries if one.kind is EntryKind.FAULT]


def silent() -> None:
    raise DeviceSilent("no answer")


def run(work: Callable[[Rig], Coroutine[Any, Any, None]]) -> Rig:
    clock = VirtualClock()
    rig = Rig(clock)
    run_virtually(work(rig), clock)
    return rig


def test_a_mount_that_hears_neither_the_end_nor_the_stop_is_tried_on() -> None:
    async def work(rig: Rig) -> None:
        rig.ends = rig.stopped = silent
        rig.ending.begin("their time is over")
        await rig.clock.sleep(60.0)
        assert rig.stops > 5
        assert rig.ending.problem is not None
        # heard at last, it is stopped once, and ending goes on
        rig.stopped = lambda: None
        await rig.clock.sleep(20.0)
        stops = rig.stops
        await rig.clock.sleep(60.0)
        assert rig.stops == stops
        assert "offset-rates-stopped" in rig.told
        rig.ends = rig._end
        assert await rig.ending.over(20.0)
        assert rig.ending.problem is None

    rig = run(work)
    assert any("nor it stopped" in what for what in rig.faults)
    assert any("it was stopped" in what for what in rig.faults)
    assert rig.told[-1] == "offset-rates-ended-late"


def test_an_ending_that_dies_is_begun_again() -> None:
    async def work(rig: Rig) -> None:
        def broken() -> None:
            rig.ends = rig._end
            raise ZeroDivisionError

        rig.ends = broken
        rig.ending.begin("their time is over")
        await rig.clock.sleep(5.0)
        assert not rig.goes_on

    assert "offset-rates-not-ended" in run(work).told
