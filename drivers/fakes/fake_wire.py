"""What all fake mounts share: bytes in, bytes out, answers in their order and in their time, and faults.

A family's fake says only how its bytes are cut into commands and what each does. There is no I/O and no
thread here: `drivers.fakes.bench` puts a fake on a wire, tests feed it by hand. Given the same bytes at the
same instants, the same faults and the same seed, it says the same again.
"""

from __future__ import annotations

import math
import random
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from typing import ClassVar

from drivers.fakes.fake_answers import Answers
from drivers.fakes.faults import LINE_KINDS, Fault, LineOrder, RandomFaults, Strike
from drivers.fakes.mount_faults import strike_mechanics
from drivers.wire.remembered import Remembered
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import utc_now


class WireFake(ABC):
    """The other end of a cable.

    Parameters
    ----------
    mechanics : Mechanics
        What moves, and what it believes of itself.
    faults : iterable of Fault
        What goes wrong. The list may be changed at any time; `add_fault` also wakes a sleeping bench.
    clock : callable
        Aware UTC of the mount's own clock.
    monotonic : callable
        Seconds; all times of faults and answers are in these.
    seed : int
        For what faults leave to chance.

    Attributes
    ----------
    chance : RandomFaults or None
        Faults at random, on top of `faults`.
    heard : Remembered of bytes
        All commands that reached it.
    obeyed : Remembered of bytes
        Those of them that it carried out.
    unknown : Remembered of bytes
        What it didn't know.
    strikes : Remembered of Strike
        Which faults struck, when, and on what.
    """

    IDENTITY: ClassVar[tuple[bytes, ...]] = ()
    """Questions (their beginnings) whose answers only tell who it is: a recorded profile may replace them."""

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
        seed: int = 0,
    ) -> None:
        self.mechanics = mechanics
        self.faults = list(faults)
        self.chance: RandomFaults | None = None
        self.heard = Remembered[bytes]()
        self.obeyed = Remembered[bytes]()
        self.unknown = Remembered[bytes]()
        self.strikes = Remembered[Strike]()
        self._clock = clock
        self._monotonic = monotonic
        self._chances = random.Random(seed)
        self._began_s = monotonic()
        self._lock = threading.RLock()
        self._buffer = b""
        self._answers = Answers()
        self._counts: Counter[bytes] = Counter()
        self._pending: list[tuple[float, Callable[[], None]]] = []
        self._dumb_until_s = self._dead_until_s = -math.inf
        self._line_orders: list[LineOrder] = []
        self._profile: dict[bytes, bytes] = {}
        self._wake: Callable[[], None] | None = None

    # -- what a family gives ---------------------------------------------------------------------

    @abstractmethod
    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        """Cut the next command off the front; noise before it is dropped (`self.unknown` may note it).

        Returns
        -------
        command : bytes or None
            None when there is no whole one.
        rest : bytes
            What waits for more bytes.
        """

    @abstractmethod
    def carry_out(self, command: bytes) -> bytes | None:
        """Do it and return the answer, b"" where it has none; None for a command that it doesn't know."""

    @abstractmethod
    def deaf_reply(self, command: bytes) -> bytes:
        """Answer as if it were carried out."""

    def denial(self, command: bytes) -> bytes | None:
        """How it says no to a command; None where it has no words for that."""
        return None

    def reboot(self) -> None:
        """Forget what a real one forgets; a family adds its own state (and calls this)."""
        self._buffer = b""
        self._answers.clear()
        self.mechanics.reboot()

    def dues(self) -> list[float]:
        """Instants (of the monotonic clock) at which `tick` has something to do."""
        return []

    def tick(self) -> None:  # noqa: B027 - a fake without timers of its own has nothing to add
        """Do what has come due: the end of a pulse, a message of its own (see `say`)."""

    # -- the wire --------------------------------------------------------------------------------

    def feed(self, data: bytes) -> bytes:
        """Take bytes (maybe none) and return what it says now, late answers included."""
        with self._lock:
            now_s = self._monotonic()
            self.tick()
            self._come_by_themselves(now_s)
            if now_s < self._dead_until_s:
                self._answers.take(now_s)
                return b""
            self._buffer += data
            while True:
                command, self._buffer = self.cut(self._buffer)
                if command is None:
                    break
                self._hear(command, now_s)
            # a command may have begun a slew that a fault waits for
            self._come_by_themselves(now_s)
            said = self._answers.take(now_s)
            return b"" if now_s < max(self._dumb_until_s, self._dead_until_s) else said

    def port_opened(self) -> None:
        """Take note that somebody has opened its port: faults that hang on that strike."""
        with self._lock:
            now_s = self._monotonic()
            for fault in tuple(self.faults):
                if not fault.by_opening or fault.times <= 0 or now_s - self._began_s < fault.at_s:
                    continue
                fault.times -= 1
                self.strikes.append(Strike(now_s - self._began_s, fault, b"", 0))
                if fault.kind == "reset-by-opening":
                    self.reboot()
                self._buffer = b""
                self._dead_until_s = max(self._dead_until_s, now_s + (fault.for_s or 0.0))

    def due_in_s(self) -> float | None:
        """Seconds until `feed` has something to do without new bytes; None when there is nothing."""
        with self._lock:
            dues = [
                *self.dues(),
                *self._answers.dues(),
                *(due_s for due_s, _ in self._pending),
                *(
                    self._began_s + fault.at_s
                    for fault in self.faults
                    if fault.by_itself and fault.times > 0 and not fault.when_slewing
                ),
            ]
            return max(0.0, min(dues) - self._monotonic()) if dues else None

    def say(self, data: bytes, delay_s: float = 0.0) -> None:
        """Say something, after all answers that are on their way."""
        self._answers.add(data, self._monotonic(), delay_s)

    def add_fault(self, fault: Fault) -> None:
        """Add a fault, from any thread; one that comes by itself counts its time from now."""
        with self._lock:
            if fault.by_itself:
                fault.at_s += self._monotonic() - self._began_s
            self.faults.append(fault)
        if self._wake is not None:
            self._wake()

    def wake_by(self, wake: Callable[[], None] | None) -> None:
        """Tell how to wake whoever sleeps until `due_in_s`."""
        self._wake = wake

    def line_orders(self) -> list[LineOrder]:
        """Hand out what faults want done to the line, once."""
        with self._lock:
            orders, self._line_orders = self._line_orders, []
        return orders

    def take_profile(self, answers: Mapping[bytes, bytes]) -> list[bytes]:
        """Answer questions about its identity as a recorded mount did; return those that were taken."""
        self._profile = {
            command: answer for command, answer in answers.items() if command.startswith(self.IDENTITY)
        }
        return list(self._profile)

    # -- one command -----------------------------------------------------------------------------

    def _hear(self, command: bytes, now_s: float) -> None:
        self.heard.append(command)
        struck = self._struck(command, now_s)
        kinds = {fault.kind for fault in struck}
        answer: bytes | None
        if "deaf" in kinds:
            answer = self.deaf_reply(command)
        elif "dead" in kinds or now_s < self._dead_until_s:
            answer = b""
        else:
            answer = self._profile.get(command)
            if answer is None:
                answer = self.carry_out(command)
            if answer is None:
                self.unknown.append(command)
                return
            self.obeyed.append(command)
            if "deny" in kinds:
                told = next((fault.data for fault in struck if fault.kind == "deny"), b"")
                answer = told or self.denial(command) or answer
        for fault in struck:
            answer = fault.spoil(answer) if answer else b""
        delay_s = sum(fault.delay_s for fault in struck if fault.kind == "late")
        gap_s = sum(fault.delay_s for fault in struck if fault.kind == "dribble")
        self._answers.add(answer, now_s, delay_s, gap_s)

    def _struck(self, command: bytes, now_s: float) -> list[Fault]:
        """Faults that spoil this answer; those of mount and line are set going."""
        t_s = now_s - self._began_s
        slewing = any(fault.when_slewing for fault in self.faults) and self.mechanics.slewing()
        struck = [
            fault
            for fault in tuple(self.faults)
            if fault.strikes(command, t_s=t_s, slewing=slewing, chances=self._chances)
        ]
        if self.chance is not None and (drawn := self.chance.draw(command)) is not None:
            struck.append(drawn)
        struck = [fault.complete(self._chances) for fault in struck]
        if struck:
            earlier = sum(count for text, count in self._counts.items() if text.startswith(command))
            # what waits for an opening is noted when that comes
            for fault in (one for one in struck if not one.by_opening):
                self.strikes.append(Strike(t_s, fault, command, earlier))
        self._counts[command] += 1
        for fault in struck:
            if not fault.spoils_answers:
                self._set_going(fault, now_s)
        return [fault for fault in struck if fault.spoils_answers]

    # -- faults of the mount and the line --------------------------------------------------------

    def _come_by_themselves(self, now_s: float) -> None:
        t_s = now_s - self._began_s
        for fault in tuple(self.faults):
            if not fault.by_itself or fault.times <= 0 or t_s < fault.at_s:
                continue
            slewing = fault.when_slewing and self.mechanics.slewing()
            if fault.comes(t_s, slewing=slewing, chances=self._chances):
                whole = fault.complete(self._chances)
                self.strikes.append(Strike(t_s, whole, b"", 0))
                self._set_going(whole, now_s)
        ready = [act for due_s, act in self._pending if due_s <= now_s]
        self._pending = [(due_s, act) for due_s, act in self._pending if due_s > now_s]
        for act in ready:
            act()

    def _set_going(self, fault: Fault, now_s: float) -> None:
        if fault.after_s > 0.0:
            due_s = now_s + fault.after_s
            self._pending.append((due_s, lambda: self._happen(fault, due_s)))
        else:
            self._happen(fault, now_s)

    def _happen(self, fault: Fault, now_s: float) -> None:
        end_s = now_s + (math.inf if fault.for_s is None else fault.for_s)
        if fault.kind in LINE_KINDS:
            self._line_orders.append(LineOrder(fault.kind, fault.for_s))
        elif fault.by_opening:
            # drawn on a command: it waits for the next opening
            self.faults.append(replace(fault, on=b"", times=1, after_s=0.0, at_s=0.0))
        elif fault.kind == "silence":
            self._dumb_until_s = max(self._dumb_until_s, end_s)
        elif fault.kind == "dead":
            self._dead_until_s = max(self._dead_until_s, end_s)
        elif fault.kind == "reboot":
            self.reboot()
            self._dead_until_s = max(self._dead_until_s, now_s + (fault.for_s or 0.0))
        elif fault.kind == "flood":
            self._answers.flood(fault.data, now_s, end_s, max(fault.delay_s, 0.001))
        else:
            end = strike_mechanics(self.mechanics, fault)
            if end_s < math.inf:
                self._pending.append((end_s, end))
