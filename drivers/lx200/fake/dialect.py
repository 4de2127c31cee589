"""How a fake of one dialect differs from the classic: its greeting, its own words, and the words it lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from drivers.lx200.fake.base import FakeLx200

MATCHED = b"Coordinates     matched.        #"
Say = Callable[[str], bytes | None]


class Speaker(Protocol):
    """What a dialect says itself, with the state that it keeps for it; one for each fake."""

    def say(self, text: str) -> bytes | None:
        """Answer a command without its `:` and `#` (ACK is one too), b"" in silence; None: not its own."""
        ...

    def reboot(self) -> None:
        """Forget what a real one forgets."""
        ...


@dataclass(frozen=True, slots=True)
class FakeDialect:
    """One dialect from the other side of the cable.

    Attributes
    ----------
    name : str
        As in ``--dialect``.
    ack : bytes
        Answer to ACK; empty for silence.
    product : mapping of str to bytes
        Answers to ``:GVx#`` by letter, without their `#`.
    speaker : callable (FakeLx200) -> Speaker, optional
        Asked first, before the classic's words.
    classic_too : callable (text) -> bool
        Which of the classic's words it knows.
    matched : bytes
        Answer to a sync.
    busy, idle : bytes
        Answers to ``:D#``.
    pulses : bool
        Whether it times guide pulses (``:Mg#``).
    unparks_by_itself : bool
        Whether an order to move ends parking, for there is no other that does.
    denials : mapping of str to bytes
        How it says no to an order; those that are missing it can't refuse.
    """

    name: str
    ack: bytes = b"P"
    product: Mapping[str, bytes] = field(default_factory=dict)
    speaker: Callable[[FakeLx200], Speaker] | None = None
    classic_too: Callable[[str], bool] = lambda text: True
    matched: bytes = MATCHED
    busy: bytes = b"\x7f#"
    idle: bytes = b"#"
    pulses: bool = True
    unparks_by_itself: bool = True
    denials: Mapping[str, bytes] = field(default_factory=lambda: {"MS": b"1Object below horizon.#"})
