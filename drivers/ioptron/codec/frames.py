"""The frames of iOptron's replies and orders, read from either end; no wire, no clock.

What goes wrong on a cable, and how reading copes:

- a reply comes in pieces: a reader says None until it is whole;
- a reply is cut, or a bit flips: texts match wholly, in length, sign and range, or are `Unreadable`;
- `:Q#` is answered `1`, and a stop goes out between another question and its answer, or right after it:
  ones around a text that begins with a sign belong to no question and are taken with it;
- a bare `1` says nothing about its question: for certainty a text is asked for first.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
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
        raise Unreadable(f"{buffer!r} is not a model number")
    return Read(buffer[:4].decode("ascii"), 4) if len(buffer) >= 4 else None


def text(lengths: tuple[int, ...], understand: Callable[[bytes], T]) -> Reader[T]:
    """Read one of these numbers of characters and a `#`; text of another length is not passed on."""
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
        raise Unreadable(f"{words!r} are not digits")
    return words.decode("ascii")


def order(words: bytes, meaning: str, *, repeatable: bool = True) -> Command[bool]:
    """Make a command that is answered `1` or `0`."""
    return Command(b":" + words + b"#", meaning, yes_or_no, repeatable)


# of both sets
_BARE = "MountInfo|FW1|FW2|GLS|AG|GMT|GAC|GPC|GAL|GPE|GSR|CM|MP0|MP1|MH|MSH|Q|qR|qD|mn|ms|me|mw"
_WITH_TEXT = (
    r"(?:SPA)(?P<turn>[0-9]{9})|(?:Sd)(?P<angle>[+-][0-9]{8})|SPH(?P<altitude>[0-9]{8})"
    r"|SG(?P<offset>[+-][0-9]{3})|(?:SDS|SHE|ST)(?P<switch>[01])|RT(?P<rate>[0-4])|RG(?P<guide>[0-9]{4})"
    r"|SR(?P<speed>[1-9])|SMT(?P<meridian>[0-9]{3})|SAL(?P<limit>[+-][0-8][0-9])"
    r"|RR(?P<custom>[0-9]{5})"
)
_V3 = (
    r"GEP|GUT|GTR|QAP|MS1|MS2"
    r"|SRA(?P<ra>[0-9]{9})|(?:SLO|SLA)(?P<site>[+-][0-9]{8})|SUT(?P<time>[0-9]{13})"
    # `:M…` is deprecated [IOPTRON310], INDI's later drivers and 1.9.9 guide by `:Z…`
    r"|(?:M[nsew]|Z[SQEC])(?P<pulse>[0-9]{5})"
)
_V2 = (
    # `:GAS#`, `:Gg#`, `:Gt#` are of older firmware, whose driver is indi_ieqlegacy_telescope
    r"V|GEC|GEA|GLT|GAS|Gg|Gt|MS|q"
    r"|Sr(?P<ra>[0-9]{8})|S[gt](?P<site>[+-][0-9]{6})|S[CL](?P<time>[0-9]{6})|M[nsew](?P<pulse>[0-9]{5})"
)
_ORDERS = {
    name: re.compile(f":(?:{_BARE}|{_WITH_TEXT}|{own})#".encode("ascii"))
    for name, own in (("v3", _V3), ("v2", _V2))
}


@dataclass(frozen=True, slots=True)
class Order:
    """One order or question: its letters, and the digits that follow them (empty where none do)."""

    name: str
    text: bytes


def order_from_text(command: bytes, dialect: str = "v3") -> Order | None:
    """Take a whole command apart; None when a mount of this set doesn't know it."""
    match = _ORDERS[dialect].fullmatch(command)
    if match is None:
        return None
    words = command[1:-1]
    texts = [text for text in match.groups() if text is not None]
    text = texts[0] if texts else b""
    return Order(words[: len(words) - len(text)].decode("ascii"), text)
