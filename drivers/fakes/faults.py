"""What can go wrong on the wire and behind it, as a list that a test or a demonstration scripts.

A `Fault` says what, and when: on which commands, from which second on, only while slewing, with what
probability. `RandomFaults` draws them. What really struck is a `Strike`, which can be turned into a fault
again: so a random run becomes a script that goes the same way.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, get_args

AnswerKind = Literal[
    "lose",
    "late",
    "cut",
    "double",
    "garble",
    "scramble",
    "noise-before",
    "noise-after",
    "dribble",
    "deaf",
    "deny",
]
"""What happens to the answer to one command."""

MountKind = Literal[
    "silence",
    "dead",
    "flood",
    "reboot",
    "sync-ignored",
    "sync-refused",
    "sync-late",
    "sync-half",
    "sync-elsewhere",
    "stick",
    "run-away",
    "deaf-start",
    "reset-by-opening",
]
"""What happens to the mount as a whole."""

OpeningKind = Literal["deaf-start", "reset-by-opening"]
"""Of these, what happens when its port is opened, each time."""

LineKind = Literal["vanish", "hang-up", "reset", "black-hole"]
"""What happens to the line; `drivers.fakes.bench` does it."""

Kind = Literal[AnswerKind, MountKind, LineKind]
ANSWER_KINDS: tuple[str, ...] = get_args(AnswerKind)
MOUNT_KINDS: tuple[str, ...] = get_args(MountKind)
LINE_KINDS: tuple[str, ...] = get_args(LineKind)
OPENING_KINDS: tuple[str, ...] = get_args(OpeningKind)
KINDS = ANSWER_KINDS + MOUNT_KINDS + LINE_KINDS


@dataclass(slots=True)
class Fault:
    """One thing that goes wrong, and when.

    Attributes
    ----------
    kind : str
        To the answer of one command: ``lose``: carried out, no answer. ``late``: the answer (and all after
        it) comes `delay_s` later. ``cut``: only its first `byte` bytes come, half of it by default.
        ``double``: it comes twice. ``garble``: one bit flips. ``scramble``: `data` overwrites it from `byte`
        on. ``noise-before``, ``noise-after``: `data` comes as well. ``dribble``: its bytes come `delay_s`
        apart. ``deaf``: answered, but not carried out. ``deny``: carried out, and answered by a refusal,
        where the family has words for one (or by `data`).
        To the mount: ``silence``: for `for_s` it says nothing, but carries out what it hears. ``dead``: for
        `for_s` it neither hears nor speaks. ``flood``: for `for_s` it sends `data` unasked, every `delay_s`.
        ``reboot``: it forgets, and is dead for `for_s`. ``sync-ignored``, ``sync-refused``, ``sync-late``
        (after `delay_s`), ``sync-half`` (the declination alone), ``sync-elsewhere`` (another place): what
        becomes of the syncs for `for_s`. ``stick``: an `axis` no longer moves, for
        `for_s`. ``run-away``: for `for_s`, slews of an `axis` go on past their target, until a stop.
        ``deaf-start``: for `for_s` after its port was opened it neither hears nor speaks, as a network
        adapter that makes its connection. ``reset-by-opening``: it forgets as well, as an Arduino that DTR
        starts anew. Both each time the port is opened, `times` times; on TCP and in memory, for a
        pseudo-terminal doesn't tell when it is opened.
        To the line: ``vanish``: the port is gone for `for_s` and comes back under another name. ``hang-up``:
        the other end closes. ``reset``: it breaks off hard. ``black-hole``: for `for_s` the port can be
        opened, and nothing comes.
    on : bytes
        Commands that begin so; empty means all. A fault of the mount or the line with an empty one doesn't
        wait for a command, it comes by itself.
    skip : int
        How many of them go well before; counted down.
    times : int
        How many go wrong then; counted down.
    delay_s : float
        See the kinds.
    byte : int or None
        Which byte of the answer, counted round and round.
    bit : int
        For ``garble``.
    at_s : float
        Not before this time, counted from the making of the fake.
    when_slewing : bool
        Only while the mount slews.
    chance : float
        With this probability each time all else is right.
    after_s : float
        Faults of mount and line come so long after what brings them on.
    every_s : float
        Faults that come by themselves come again after this time, as often as `times` says.
    for_s : float
        How long it lasts; for ever where it is not said (a reboot: no time at all).
    data : bytes
        See the kinds; drawn at random where it is empty and needed.
    axis : {"ha", "dec"}
        For ``stick`` and ``run-away``.
    stops : int
        For ``run-away``: so many stops are not heeded.
    """

    kind: Kind
    on: bytes = b""
    skip: int = 0
    times: int = 1
    delay_s: float = 0.0
    byte: int | None = None
    bit: int = 6
    at_s: float = 0.0
    when_slewing: bool = False
    chance: float = 1.0
    after_s: float = 0.0
    every_s: float = 0.0
    for_s: float | None = None
    data: bytes = b""
    axis: Literal["ha", "dec"] = "ha"
    stops: int = 0

    @property
    def spoils_answers(self) -> bool:
        """Whether it happens to an answer, not to the mount or the line."""
        return self.kind in ANSWER_KINDS

    @property
    def by_itself(self) -> bool:
        """Whether it comes without a command."""
        return not self.on and not self.spoils_answers and not self.by_opening

    @property
    def by_opening(self) -> bool:
        """Whether the opening of its port brings it on."""
        return self.kind in OPENING_KINDS

    def strikes(
        self,
        command: bytes,
        *,
        t_s: float = float("inf"),
        slewing: bool = False,
        chances: random.Random | None = None,
    ) -> bool:
        """Count one command; True when it is one that goes wrong.

        Parameters
        ----------
        command : bytes
        t_s : float
            Since the making of the fake.
        slewing : bool
        chances : random.Random, optional
            For `chance`.
        """
        if self.by_itself or self.by_opening or self.times <= 0 or not command.startswith(self.on):
            return False
        if t_s < self.at_s or (self.when_slewing and not slewing):
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        if self.chance < 1.0 and (chances is None or chances.random() >= self.chance):
            return False
        self.times -= 1
        return True

    def comes(self, t_s: float, *, slewing: bool, chances: random.Random) -> bool:
        """Whether it comes by itself now; counted."""
        if not self.by_itself or self.times <= 0 or t_s < self.at_s:
            return False
        if self.when_slewing and not slewing:
            return False
        self.times -= 1
        self.at_s = t_s + self.every_s
        return self.chance >= 1.0 or chances.random() < self.chance

    def complete(self, chances: random.Random) -> Fault:
        """Copy it with its random parts drawn."""
        if self.data or self.kind not in ("scramble", "noise-before", "noise-after", "flood"):
            return replace(self)
        return replace(self, data=chances.randbytes(chances.randint(1, 6)))

    def spoil(self, reply: bytes) -> bytes:
        """Return what is left of an answer; `reply` is not empty."""
        place = (self.byte or 0) % len(reply)
        match self.kind:
            case "lose":
                return b""
            case "cut":
                return reply[: len(reply) // 2 if self.byte is None else place]
            case "double":
                return reply * 2
            case "garble":
                return reply[:place] + bytes([reply[place] ^ (1 << self.bit)]) + reply[place + 1 :]
            case "scramble":
                return (reply[:place] + self.data)[: len(reply)] + reply[place + len(self.data) :]
            case "noise-before":
                return self.data + reply
            case "noise-after":
                return reply + self.data
            case _:
                return reply


@dataclass(frozen=True, slots=True)
class LineOrder:
    """What a fault wants done to the line: ``vanish``, ``hang-up``, ``reset`` or ``black-hole``."""

    kind: str
    for_s: float | None


@dataclass(frozen=True, slots=True)
class Strike:
    """A fault that has struck.

    Attributes
    ----------
    t_s : float
        Since the making of the fake.
    fault : Fault
        With its random parts drawn.
    command : bytes
        The command that brought it on; empty when it came by itself.
    earlier : int
        How many commands that begin like it had been heard before.
    """

    t_s: float
    fault: Fault
    command: bytes
    earlier: int

    def scripted(self) -> Fault:
        """As a fault that strikes in just this place."""
        fault = replace(self.fault, times=1, chance=1.0, when_slewing=False, every_s=0.0)
        if self.command:
            return replace(fault, on=self.command, skip=self.earlier, at_s=0.0)
        return replace(fault, on=b"", at_s=self.t_s, after_s=0.0)


def scripted(strikes: Iterable[Strike]) -> list[Fault]:
    """Turn what has struck into a script that goes the same way, as far as the questions do."""
    return [strike.scripted() for strike in strikes]


USUAL_KINDS: tuple[Kind, ...] = (
    "lose",
    "late",
    "cut",
    "double",
    "garble",
    "scramble",
    "noise-before",
    "noise-after",
    "dribble",
)
"""What a bad cable does."""


class RandomFaults:
    """Faults drawn at random, one draw for each command.

    Parameters
    ----------
    seed : int
        The same commands then meet the same faults.
    rate : float
        Probability for each command, 0..1.
    kinds : sequence of str
        Of these, evenly.
    on : bytes
        Only commands that begin so.
    longest_s : float
        Delays and spells last up to this.
    """

    def __init__(
        self,
        seed: int,
        rate: float,
        kinds: Iterable[Kind] = USUAL_KINDS,
        *,
        on: bytes = b"",
        longest_s: float = 2.0,
    ) -> None:
        self.seed, self.rate, self.kinds = seed, rate, tuple(kinds)
        self.on, self.longest_s = on, longest_s
        self._chances = random.Random(seed)

    def draw(self, command: bytes) -> Fault | None:
        """Return what goes wrong with a command; None for nothing."""
        chances = self._chances
        if not command.startswith(self.on) or chances.random() >= self.rate:
            return None
        kind = chances.choice(self.kinds)
        delay_s = chances.uniform(0.0, self.longest_s)
        return Fault(
            kind,
            on=command,
            delay_s=delay_s / 50.0 if kind in ("dribble", "flood") else delay_s,
            for_s=chances.uniform(0.0, self.longest_s),
            byte=chances.randrange(1000),
            bit=chances.randrange(8),
            # a refusal is said in the family's words
            data=b"" if kind == "deny" else chances.randbytes(chances.randint(1, 6)),
            axis=chances.choice(("ha", "dec")),
        )
