"""One thing to say to a device, together with the reader of its reply: what codecs give and exchanges use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T_co = TypeVar("T_co", covariant=True)


class Unreadable(ValueError):
    """Bytes that match nothing the question allows."""


@dataclass(frozen=True, slots=True)
class Read(Generic[T_co]):
    """A whole reply: its value, and how many bytes it took from the front of the buffer."""

    value: T_co
    length: int


@dataclass(frozen=True, slots=True)
class Command(Generic[T_co]):
    """One thing to say to the device, and how to understand what it answers.

    Attributes
    ----------
    sent : bytes
        What goes out.
    meaning : str
        In words, for messages.
    read : callable (buffer, final) -> Read or None
        None while the reply is not whole yet; raises `Unreadable`. `final` is True when time has run
        out and no more bytes will come.
    repeatable : bool
        Whether asking twice does no more than asking once. Commands that move or sync are not.
    answered : bool
        Whether there is a reply at all.
    """

    sent: bytes
    meaning: str
    read: Callable[[bytes, bool], Read[T_co] | None]
    repeatable: bool = True
    answered: bool = True
