"""kill -9 at each step of a centering: nothing that was ordered is lost, nothing is sent twice.

Run: python -m benchmarks.killed [--steps 1-200] [--anywhere 20] [--at-once 4] [--verbose]

A fake mount lives in this process, on a real serial line (pty). A child - the real navigator, the real
driver, the real journal in a SQLite file - centers a target on it and is killed by SIGKILL at its n-th step
(`mountnav.mount.kill_points`, and each order as it goes onto the wire), or at a random moment (`--anywhere`).
A second child takes the telescope up again, as a service does at its start, and orders nothing; a third one,
after every fourth kill, centers the target. What the mount truly received is compared with what is written:
nothing was sent that was not written first, nothing twice, each command is closed - with an outcome that is
true, or as unknown - and nothing happens by itself. The exit code is 1 when any of that fails.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.killed_child import AIR, LONGEST_S, SITE, Plan, child
from drivers.fakes.bench import FakeOnPty
from drivers.lx200.fake.base import FakeLx200
from mountnav.clock import utc_now
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandEnd, CommandRecord, Outcome
from mountnav.journal.restart import Likely
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, hour_angle_to_icrs
from mountnav.sky.coordinates import Apparent, HourAngle, Icrs
from mountnav.sky.sphere import separation_arcsec

ERRORS = PointingErrors(ih_arcsec=500.0, id_arcsec=-400.0, ch_arcsec=150.0, ma_arcsec=200.0)
SAME_ARCSEC = 40.0
"""An order on the wire and its row name the same place to within the wire's steps."""
KNOWN = (Outcome.DONE, Outcome.LATE, Outcome.IGNORED, Outcome.ELSEWHERE, Outcome.STALLED)


@dataclass(frozen=True, slots=True)
class Received:
    """An order that reached the mount."""

    order: str
    utc: datetime
    place: Icrs


class Telescope:
    """The fake on its line, and all that reached it."""

    def __init__(self) -> None:
        self.mechanics = Mechanics(SITE, AIR, ERRORS, slew_rate_deg_s=25.0, acceleration_deg_s2=60.0)
        self.received: list[Received] = []
        for order in ("slew", "sync"):
            setattr(self.mechanics, order, self._noted(order, getattr(self.mechanics, order)))
        self.bench = FakeOnPty(FakeLx200(self.mechanics))

    def _noted(self, order: str, carry_out: Any) -> Any:
        def noted(place: Apparent, *more: Any) -> Any:
            # noted before it is carried out: no answer may come before the note
            now = utc_now()
            self.received.append(
                Received(order, now, apparent_to_icrs(Apparent(place.ra_deg, place.dec_deg, now)))
            )
            return carry_out(place, *more)

        return noted

    def target(self) -> Icrs:
        """A place that is up now."""
        return hour_angle_to_icrs(HourAngle(35.0, 20.0, utc_now()), SITE, AIR)


@dataclass
class Life:
    """What a child told before its end."""

    steps: list[str] = field(default_factory=list)
    notice: str | None = None
    likely: dict[str, str] = field(default_factory=dict)
    said: str = ""
    killed: bool = False


# -- the parent ------------------------------------------------------------------------------------------


@contextmanager
def telescope() -> Iterator[Telescope]:
    """A mount on its line, that outlives whoever drives it."""
    made = Telescope()
    with made.bench:
        yield made


def live(made: Telescope, plan: Plan, *, kill_after_s: float | None = None) -> Life:
    """Let a child live, answer it, and wait for its end."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["benchmarks.killed_child"])
    ours, theirs = context.Pipe()
    process = context.Process(target=child, args=(theirs, plan), daemon=True)
    process.start()
    theirs.close()
    told = Life()
    began = time.monotonic()
    try:
        while True:
            left_s = LONGEST_S * 3.0 - (time.monotonic() - began)
            wait_s = left_s if kill_after_s is None else max(0.0, kill_after_s - (time.monotonic() - began))
            if not ours.poll(wait_s):
                process.kill()
                if kill_after_s is None:
                    told.said = "hung"
                break
            _answer(made, ours, ours.recv(), told)
    except (EOFError, ConnectionResetError):
        pass
    process.join(LONGEST_S)
    told.killed = process.exitcode == -signal.SIGKILL
    if not told.killed and process.exitcode != 0:
        told.said = f"ended with {process.exitcode}"
    process.close()
    ours.close()
    return told


def _answer(made: Telescope, ours: Connection, said: tuple[Any, ...], told: Life) -> None:
    match said:
        case ("truth", utc):
            ours.send(made.mechanics.truth(utc))
        case ("angle", utc):
            ours.send(made.mechanics.tube_angle_deg(utc))
        case ("step", name):
            told.steps.append(name)
        case ("taken up", notice, likely):
            told.notice, told.likely = notice, likely
        case ("said", words):
            told.said = words


@dataclass(frozen=True, slots=True)
class Kill:
    """When a centering is killed.

    Attributes
    ----------
    at : int
        At this step; 0: never.
    named : str
        At the step of this name, the `times`-th time it is reached.
    times : int
    after_s : float or None
        So long after its beginning.
    """

    at: int = 0
    named: str = ""
    times: int = 1
    after_s: float | None = None

    def __str__(self) -> str:
        if self.after_s is not None:
            return f"after {self.after_s:.2f} s"
        return f"step {self.at}" if self.at else f"{self.named} ({self.times})"


def trial(folder: Path, kill: Kill, *, goes_on: bool = True) -> tuple[Life, list[str]]:
    """Kill a centering, take the telescope up again, and compare; what was wrong, in words."""
    database = str(folder / f"{kill}.sqlite")
    with telescope() as made:
        target = made.target()
        plan = Plan(made.bench.address, database, target, True, kill.at, kill.named, kill.times)
        first = live(made, plan, kill_after_s=kill.after_s)
        if not first.killed:
            return first, [] if first.said.startswith("centered") else [f"undisturbed it {first.said}"]
        sent = len(made.received)
        second = live(made, Plan(made.bench.address, database, target, False))
        wrong = _by_itself(made.received[sent:]) + _closed(Path(database), second)
        wrong += compared(JournalReader(database).commands(), made.received, second.likely)
        if not goes_on:
            return first, wrong
        third = live(made, Plan(made.bench.address, database, target, True))
        if not third.said.startswith("centered"):
            wrong.append(f"afterwards it {third.said}")
        off_arcsec = separation_arcsec(made.mechanics.truth(), target)
        if off_arcsec > 60.0:
            wrong.append(f"afterwards the tube is {off_arcsec:.0f}″ off")
        wrong += compared(JournalReader(database).commands(), made.received, {})
    return first, list(dict.fromkeys(wrong))


def _by_itself(received: list[Received]) -> list[str]:
    return [f"after the restart, a {one.order} was sent that nobody ordered" for one in received]


def _closed(database: Path, second: Life) -> list[str]:
    reader = JournalReader(database)
    wrong = [f"the {one.order} of {one.utc:%H:%M:%S.%f} is still open" for one in reader.in_flight()]
    if second.said:
        wrong.append(f"the restart {second.said}")
    if second.likely and not second.notice:
        wrong.append("something was in flight, and the restart doesn't tell")
    unknown = [one for one, end in reader.commands() if end is not None and end.outcome is Outcome.UNKNOWN]
    if unknown and not second.likely:
        wrong.append("an outcome is unknown, and the restart doesn't tell")
    return wrong


def compared(
    commands: list[tuple[CommandRecord, CommandEnd | None]],
    received: list[Received],
    likely: dict[str, str],
) -> list[str]:
    """What is written against what the mount received: each order has one row, written before it came."""
    wrong = []
    left = [(command, end) for command, end in commands if command.order in ("slew", "sync")]
    matched = set()
    for one in received:
        rows = [
            (command, end)
            for command, end in left
            if command.order == one.order
            and command.utc <= one.utc
            and command.command_id not in matched
            and _same(command, one)
        ]
        if not rows:
            wrong.append(f"a {one.order} reached the mount that is not written, or twice")
            continue
        # the newest that it can have come from: a place may be ordered again, later
        command, end = max(rows, key=lambda row: row[0].utc)
        matched.add(command.command_id)
        if end is not None and end.outcome in (Outcome.NOT_SENT, Outcome.REFUSED):
            wrong.append(f"a {one.order} reached the mount, and its row says {end.outcome}")
        if likely.get(command.command_id) == Likely.NOT_CARRIED_OUT:
            wrong.append(f"a {one.order} reached the mount, and the restart says it was not carried out")
    for command, end in left:
        got = command.command_id in matched
        if not got and end is not None and end.outcome in KNOWN:
            wrong.append(f"a {command.order} is said to be {end.outcome}, and never reached the mount")
        if not got and likely.get(command.command_id) == Likely.CARRIED_OUT:
            wrong.append(
                f"a {command.order} never reached the mount, and the restart says it was carried out"
            )
    return wrong


def _same(command: CommandRecord, one: Received) -> bool:
    place = command.place
    if place is None:
        return False
    icrs = place if isinstance(place, Icrs) else apparent_to_icrs(place)
    return separation_arcsec(icrs, one.place) < SAME_ARCSEC


def steps_of(folder: Path) -> list[str]:
    """The steps of a centering that nobody disturbs."""
    life, wrong = trial(folder, Kill())
    if wrong:
        raise SystemExit("; ".join(wrong))
    return life.steps


def tried(folder: Path, kills: list[Kill], at_once: int = 4) -> list[tuple[Life, list[str]]]:
    """Several kills, on telescopes beside each other; every fourth telescope is used again afterwards."""
    with ThreadPoolExecutor(at_once) as threads:
        numbered = enumerate(kills)
        return list(threads.map(lambda one: trial(folder, one[1], goes_on=one[0] % 4 == 3), numbered))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", default="1-1000", help="from-to, of the steps of an undisturbed centering")
    parser.add_argument("--anywhere", type=int, default=0, help="so many more, at random moments")
    parser.add_argument("--at-once", type=int, default=4, help="telescopes beside each other")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    low, _, high = asked.steps.partition("-")
    with tempfile.TemporaryDirectory() as name:
        began = time.monotonic()
        steps = steps_of(Path(name))
        whole_s = time.monotonic() - began
        print(f"{len(steps)} steps, an undisturbed centering takes {whole_s:.1f} s")
        kills = [Kill(at=n) for n in range(int(low), min(int(high or low), len(steps)) + 1)]
        chance = random.Random(asked.seed)
        kills += [Kill(after_s=chance.uniform(0.1, whole_s)) for _ in range(asked.anywhere)]
        results = tried(Path(name), kills, asked.at_once)
        took_s = time.monotonic() - began
    for kill, (life, wrong) in zip(kills, results, strict=True):
        if asked.verbose or wrong:
            at = f" ({life.steps[-1]})" if life.steps else ""
            print(f"{kill}{at}: {'; '.join(wrong) or 'right'}")
    bad = sum(bool(wrong) for _, wrong in results)
    killed = sum(life.killed for life, _ in results)
    print(f"{len(kills)} kills ({killed} in time) in {took_s:.0f} s: {bad} went wrong")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
