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
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import islice
from typing import ClassVar, SupportsIndex, TypeVar, overload

from drivers.fakes.faults import LINE_KINDS, Fault, LineOrder, RandomFaults, Strike, strike_mechanics
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Mechanics

T = TypeVar("T")
_MOST_KEPT = 20_000
"""How many entries a fake's records keep. Chosen by hand: an hour of a mount that is read twice a second, so
that a test finds all; doubled, a fake that runs for days holds some megabytes more."""

_SHORTEST_GAP_S = 0.001
"""Shortest time (s) between two pieces of a flood: a byte at 9600 baud takes as long. Halved, a flood
without a delay costs twice the processor time."""


class Remembered(Sequence[T]):
    """A sequence that drops its oldest items; those that are left keep their index.

    Parameters
    ----------
    things : iterable
        The first items.
    most : int
        How many items are kept.
    """

    def __init__(self, things: Iterable[T] = (), *, most: int = _MOST_KEPT) -> None:
        self._kept: deque[T] = deque(maxlen=most)
        self._count = 0
        for thing in things:
            self.append(thing)

    def append(self, thing: T) -> None:
        """Add an item; the oldest one is dropped if there are too many."""
        self._kept.append(thing)
        self._count += 1

    def keep(self, most: int) -> None:
        """Keep no more than this from now on; the oldest that are too many are dropped."""
        self._kept = deque(self._kept, maxlen=most)

    def clear(self) -> None:
        """Drop all items, and count from 0 again."""
        self._kept.clear()
        self._count = 0

    def __len__(self) -> int:
        """How many items were added, dropped ones included."""
        return self._count

    def __iter__(self) -> Iterator[T]:
        """The items that are kept, oldest first."""
        return iter(tuple(self._kept))

    @overload
    def __getitem__(self, index: SupportsIndex) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> list[T]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> T | list[T]:
        """Items by their index among all that were added.

        Raises
        ------
        IndexError
            If there is no such item, or it (for a slice: its first) was dropped.
        """
        forgotten = self._count - len(self._kept)
        if not isinstance(index, slice):
            at = index.__index__()
            at += self._count if at < 0 else 0
            if not forgotten <= at < self._count:
                raise IndexError(f"number {at} of {self._count}: there is none, or it is forgotten")
            return self._kept[at - forgotten]
        start, stop, step = index.indices(self._count)
        if step != 1:
            raise IndexError("only what came one after the other")
        if start < min(stop, forgotten):
            raise IndexError(f"number {start} of {self._count} is forgotten")
        return list(islice(tuple(self._kept), max(0, start - forgotten), max(0, stop - forgotten)))

    def __eq__(self, other: object) -> bool:
        """Equal to a sequence of the same items, if none was dropped."""
        if not isinstance(other, (Remembered, list, tuple)):
            return NotImplemented
        return len(self) == len(other) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """The kept items as a list."""
        return repr(list(self._kept))


@dataclass(slots=True)
class _Flood:
    """Bytes that are sent unasked, again and again, until some time."""

    data: bytes
    next_s: float
    end_s: float
    every_s: float


class AnswerQueue:
    """A queue of answers with the times at which they are sent; none overtakes another."""

    def __init__(self) -> None:
        self._late: list[tuple[float, bytes]] = []
        self._floods: list[_Flood] = []

    def add(self, answer: bytes, now_s: float, delay_s: float = 0.0, gap_s: float = 0.0) -> None:
        """Put an answer at the end.

        Parameters
        ----------
        answer : bytes
            May be empty.
        delay_s : float
            It is sent so much later; even later if the one before it is.
        gap_s : float
            Between its bytes; 0 keeps them together.
        """
        due_s = max(now_s + delay_s, self._late[-1][0] if self._late else -math.inf)
        pieces = [answer] if gap_s <= 0.0 else [answer[i : i + 1] for i in range(len(answer))]
        for number, piece in enumerate(pieces):
            if piece:
                self._late.append((due_s + number * gap_s, piece))

    def flood(self, data: bytes, now_s: float, end_s: float, every_s: float) -> None:
        """Send `data` every `every_s` until `end_s`, between all other answers."""
        self._floods.append(_Flood(data, now_s, end_s, every_s))

    def clear(self) -> None:
        """Drop everything."""
        self._late.clear()
        self._floods.clear()

    def dues(self) -> list[float]:
        """Times of the next bytes to send."""
        return [due_s for due_s, _ in self._late[:1]] + [flood.next_s for flood in self._floods]

    def take(self, now_s: float) -> bytes:
        """Take out and return what is due by now."""
        said: list[tuple[float, bytes]] = []
        ready = next((i for i, (due_s, _) in enumerate(self._late) if due_s > now_s), len(self._late))
        said += self._late[:ready]
        del self._late[:ready]
        for flood in self._floods:
            while flood.next_s <= min(now_s, flood.end_s):
                said.append((flood.next_s, flood.data))
                flood.next_s += flood.every_s
        self._floods = [flood for flood in self._floods if flood.next_s <= flood.end_s]
        # floods mix in by their times; the sort is stable, so answers of one time keep their order
        return b"".join(piece for _, piece in sorted(said, key=lambda entry: entry[0]))


class WireFake(ABC):
    """The mount's end of a cable; a family's fake inherits it and gives `cut`, `carry_out` and `deaf_reply`.

    Parameters
    ----------
    mechanics : Mechanics
        The telescope that moves, and what the mount believes about it.
    faults : iterable of Fault
        What goes wrong. The list may be changed at any time; `add_fault` also wakes a sleeping bench.
    clock : callable
        Aware UTC of the mount's own clock.
    monotonic : callable
        Gives seconds; all times of faults and answers are in these.
    seed : int
        For the random parts of faults.

    Attributes
    ----------
    chance : RandomFaults or None
        Faults at random, on top of `faults`.
    heard : Remembered of bytes
        All commands that reached it.
    obeyed : Remembered of bytes
        The commands that it carried out.
    unknown : Remembered of bytes
        The commands that it didn't know.
    strikes : Remembered of Strike
        Which faults struck, when, and on what.
    """

    IDENTITY: ClassVar[tuple[bytes, ...]] = ()
    """Beginnings of the questions whose answers only identify the mount: a recorded profile may replace
    them."""

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
        self._answers = AnswerQueue()
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
            What has to wait for more bytes.
        """

    @abstractmethod
    def carry_out(self, command: bytes) -> bytes | None:
        """Carry out a command and return its answer, b"" if it has none; None for an unknown command."""

    @abstractmethod
    def deaf_reply(self, command: bytes) -> bytes:
        """Answer as if the command were carried out."""

    def denial(self, command: bytes) -> bytes | None:
        """The refusal of a command; None where the protocol has none."""
        return None

    def reboot(self) -> None:
        """Forget what a real mount forgets; a family adds its own state and calls this."""
        self._buffer = b""
        self._answers.clear()
        self.mechanics.reboot()

    def dues(self) -> list[float]:
        """Times (of the monotonic clock) at which `tick` has something to do."""
        return []

    def tick(self) -> None:  # noqa: B027 - a fake without timers of its own has nothing to add
        """Do what is due: the end of a pulse, an unasked message (see `say`)."""

    # -- the wire --------------------------------------------------------------------------------

    def feed(self, data: bytes) -> bytes:
        """Take bytes (perhaps none) and return what is sent now, late answers included."""
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
            # a command may have started a slew that a fault waits for
            self._come_by_themselves(now_s)
            said = self._answers.take(now_s)
            return b"" if now_s < max(self._dumb_until_s, self._dead_until_s) else said

    def port_opened(self) -> None:
        """Let the faults strike that wait for the port to be opened."""
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
        """Send something unasked, after all answers that are on their way."""
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
        """Set the function that wakes the thread that sleeps until `due_in_s`."""
        self._wake = wake

    def line_orders(self) -> list[LineOrder]:
        """Take out what faults want done to the line."""
        with self._lock:
            orders, self._line_orders = self._line_orders, []
        return orders

    def take_profile(self, answers: Mapping[bytes, bytes]) -> list[bytes]:
        """Answer questions about its identity as a recorded mount did; return those that are used."""
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
                given = next((fault.data for fault in struck if fault.kind == "deny"), b"")
                answer = given or self.denial(command) or answer
        for fault in struck:
            answer = fault.spoil(answer) if answer else b""
        delay_s = sum(fault.delay_s for fault in struck if fault.kind == "late")
        gap_s = sum(fault.delay_s for fault in struck if fault.kind == "dribble")
        self._answers.add(answer, now_s, delay_s, gap_s)

    def _struck(self, command: bytes, now_s: float) -> list[Fault]:
        """The faults that spoil this answer; faults of mount and line are started here."""
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
            # a fault that waits for the port to be opened is recorded then
            for fault in (drawn for drawn in struck if not drawn.by_opening):
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
            # it was drawn on a command, and waits for the next time the port is opened
            self.faults.append(replace(fault, on=b"", times=1, after_s=0.0, at_s=0.0))
        elif fault.kind == "silence":
            self._dumb_until_s = max(self._dumb_until_s, end_s)
        elif fault.kind == "dead":
            self._dead_until_s = max(self._dead_until_s, end_s)
        elif fault.kind == "reboot":
            self.reboot()
            self._dead_until_s = max(self._dead_until_s, now_s + (fault.for_s or 0.0))
        elif fault.kind == "flood":
            self._answers.flood(fault.data, now_s, end_s, max(fault.delay_s, _SHORTEST_GAP_S))
        else:
            end = strike_mechanics(self.mechanics, fault)
            if end_s < math.inf:
                self._pending.append((end_s, end))
