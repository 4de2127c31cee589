"""A command to a device together with the reader of its reply: codecs make them, exchanges send them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T_co = TypeVar("T_co", covariant=True)


class Unreadable(ValueError):
    """Bytes that are no reply to this command."""


@dataclass(frozen=True, slots=True)
class Read(Generic[T_co]):
    """A whole reply: its value, and how many bytes it takes at the front of the buffer."""

    value: T_co
    length: int


@dataclass(frozen=True, slots=True)
class Command(Generic[T_co]):
    """The bytes of one command, and the reader of its reply.

    A command owns its reader, so that an exchange needs no knowledge of any protocol: replies end by a sign,
    by their length or by silence, and only the command knows which.

    Attributes
    ----------
    meaning : str
        In words, for messages.
    read : callable (buffer, final) -> Read or None
        None while the reply is not complete; raises `Unreadable`. `final` is True when time has run out and
        no more bytes will come.
    repeatable : bool
        Whether sending twice does no more than sending once. Commands that move or sync are not.
    answered : bool
        Whether there is a reply at all.
    """

    sent: bytes
    meaning: str
    read: Callable[[bytes, bool], Read[T_co] | None]
    repeatable: bool = True
    answered: bool = True
