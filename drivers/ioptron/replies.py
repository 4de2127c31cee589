"""Readers of iOptron's replies: bare characters, and texts of a fixed length up to `#`. No wire, no clock.

What goes wrong on a cable, and how reading copes:

- a reply comes in pieces: a reader says None until it is whole;
- a reply is cut, or a bit flips: texts match wholly, in length, sign and range, or are `Unreadable`;
- `:Q#` is answered `1`, and a stop goes out between another question and its answer, or right after it:
  ones around a text that begins with a sign are nobody's and are taken with it;
- a bare `1` says nothing about its question: who needs certainty asks for a text first.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

from drivers.wire.command import Command, Read, Unreadable

T = TypeVar("T")
Reader = Callable[[bytes, bool], Read[T] | None]
_MOST_STOPS = 12
"""Three commands to a stop, and some stops between a question and its answer."""


def nothing(buffer: bytes, final: bool) -> Read[None] | None:
    """No reply: for commands that are not waited for."""
    return Read(None, 0)


def yes_or_no(buffer: bytes, final: bool) -> Read[bool] | None:
    """`1` or `0`, without a `#`."""
    if not buffer:
        return None
    if buffer[:1] not in (b"0", b"1"):
        raise Unreadable(f"{buffer!r} is neither 0 nor 1")
    return Read(buffer[:1] == b"1", 1)


def model(buffer: bytes, final: bool) -> Read[str] | None:
    """Four digits, without a `#`."""
    if not re.fullmatch(rb"[0-9]*", buffer[:4]):
        raise Unreadable(f"{buffer!r} is no model number")
    return Read(buffer[:4].decode("ascii"), 4) if len(buffer) >= 4 else None


def text(lengths: tuple[int, ...], understand: Callable[[bytes], T]) -> Reader[T]:
    """Read one of these numbers of characters and a `#`; understanding is told nothing of another length."""
    longest = max(lengths)
    wanted = " or ".join(str(length) for length in lengths)

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        end = buffer.find(b"#")
        if end > longest or (end < 0 and len(buffer) > longest):
            raise Unreadable(f"{buffer!r} is longer than {wanted} characters and #")
        if end < 0:
            return None
        if end not in lengths:
            raise Unreadable(f"{buffer!r} is not {wanted} characters and #")
        return Read(understand(buffer[:end]), end + 1)

    return read


def signed_text(lengths: tuple[int, ...], understand: Callable[[bytes], T]) -> Reader[T]:
    """Read as `text`, behind and before the answers of stops that went out meanwhile."""
    read_text = text(lengths, understand)

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        stops = len(buffer) - len(buffer.lstrip(b"1"))
        if stops > _MOST_STOPS:
            raise Unreadable(f"{buffer!r} has more ones before its sign than stops were sent")
        if buffer[stops:] and buffer[stops : stops + 1] not in (b"+", b"-"):
            raise Unreadable(f"{buffer!r} has no sign")
        found = read_text(buffer[stops:], final)
        if found is None:
            return None
        length = stops + found.length
        return Read(found.value, length if buffer[length:].strip(b"1") else len(buffer))

    return read


def digits(words: bytes) -> str:
    """ASCII digits alone; raises `Unreadable` where they are none."""
    if re.fullmatch(rb"[0-9]+", words) is None:
        raise Unreadable(f"{words!r} are no digits")
    return words.decode("ascii")


def order(words: bytes, meaning: str, *, repeatable: bool = True) -> Command[bool]:
    """Make a command that is answered `1` or `0`."""
    return Command(b":" + words + b"#", meaning, yes_or_no, repeatable)
