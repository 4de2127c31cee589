"""What can go wrong on the wire, as a list that a test or a demonstration scripts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(slots=True)
class Fault:
    """One thing that goes wrong with the answers to some command.

    Attributes
    ----------
    kind : str
        ``lose``: carried out, no answer. ``late``: the answer (and all after it) comes `delay_s` later.
        ``garble``: one bit of the answer flips. ``cut``: only the first half of the answer comes.
        ``deaf``: answered, but not carried out.
    on : bytes
        Commands that begin so; empty means all.
    skip : int
        How many of them go well before; counted down.
    times : int
        How many go wrong then; counted down.
    delay_s : float
        For ``late``.
    byte, bit : int
        For ``garble``: which bit of which byte.
    """

    kind: Literal["lose", "late", "garble", "cut", "deaf"]
    on: bytes = b""
    skip: int = 0
    times: int = 1
    delay_s: float = 0.0
    byte: int = 0
    bit: int = 6

    def strikes(self, command: bytes) -> bool:
        """Count one command; True when it is one that goes wrong."""
        if not command.startswith(self.on) or self.times <= 0:
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        self.times -= 1
        return True

    def spoil(self, reply: bytes) -> bytes:
        """Return what is left of an answer."""
        if self.kind == "lose":
            return b""
        if self.kind == "cut":
            return reply[: len(reply) // 2]
        if self.kind == "garble":
            place = min(self.byte, len(reply) - 1)
            return reply[:place] + bytes([reply[place] ^ (1 << self.bit)]) + reply[place + 1 :]
        return reply
