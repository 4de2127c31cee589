"""The shapes that LX200 replies have, as readers: nothing, one character, a text up to `#`, and mixtures.

Nothing in a reply says where it ends [LX200 link and framing], so every command owns its reader. What goes
wrong on a real cable, and how reading copes:

- a reply comes in pieces: a reader says None until it is whole;
- a reply is cut, or a bit flips: whatever does not match wholly and within its range is `Unreadable`;
- a late reply comes after the next question: declinations need their sign, so no right ascension is one;
- a reply is longer than any can be: `Unreadable`, rather than waiting for a `#` that never comes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from drivers.wire.command import Read, Unreadable
from mountnav.errors import Refusal

T = TypeVar("T")
_LONGEST_TEXT = 80
BAR = 0x7F
_COORDINATE = re.compile(r"[+-]?\d{2,3}\D\d{2}([:.'].*)?")


@dataclass(frozen=True, slots=True)
class Answer:
    """What an order was answered.

    Attributes
    ----------
    refusal : str or None
        None when it was taken up, else the mount's own words.
    reason : Refusal
        As far as the words tell.
    """

    refusal: str | None = None
    reason: Refusal = Refusal.OTHER


def nothing(buffer: bytes, final: bool) -> Read[None] | None:
    """No reply at all."""
    return Read(None, 0)


def text(buffer: bytes, final: bool) -> Read[bytes] | None:
    """All up to the next `#`."""
    end = buffer.find(b"#")
    if end < 0:
        if len(buffer) > _LONGEST_TEXT:
            raise Unreadable(f"no end within {_LONGEST_TEXT} bytes: {buffer!r}")
        return None
    if end > _LONGEST_TEXT:
        raise Unreadable(f"longer than {_LONGEST_TEXT} bytes: {buffer!r}")
    return Read(buffer[:end], end + 1)


def of_text(understand: Callable[[bytes], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """A text up to `#`, understood by a function that raises `Unreadable` for what it is not."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        whole = text(buffer, final)
        return None if whole is None else Read(understand(whole.value), whole.length)

    return read


def yes_or_no(buffer: bytes, final: bool) -> Read[bool] | None:
    """A bare `1` or `0`."""
    if not buffer:
        return None
    if buffer[:1] not in (b"0", b"1"):
        raise Unreadable(f"{buffer!r} is neither 0 nor 1")
    return Read(buffer[:1] == b"1", 1)


def words(wire: bytes) -> str:
    """Plain text."""
    if any(byte < 0x20 or byte == BAR for byte in wire):
        raise Unreadable(f"{wire!r} is not plain text")
    return wire.decode("latin-1").strip()


def words_but_no_place(wire: bytes) -> str:
    """Plain text; a coordinate here is the late answer of another question."""
    said = words(wire)
    if _COORDINATE.fullmatch(said):
        raise Unreadable(f"{wire!r} is no answer to a sync")
    return said


def coded(codes: Mapping[str, tuple[str, Refusal]]) -> Callable[[bytes, bool], Read[Answer] | None]:
    """A bare digit: `0` is yes, another one of `codes` a refusal with its words and reason [ONSTEP :MS#]."""

    def read(buffer: bytes, final: bool) -> Read[Answer] | None:
        if not buffer:
            return None
        code = chr(buffer[0])
        if code == "0":
            return Read(Answer(), 1)
        if code not in codes:
            raise Unreadable(f"{buffer!r} is no answer to a slew")
        return Read(Answer(*codes[code]), 1)

    return read
