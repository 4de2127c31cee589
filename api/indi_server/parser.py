"""What clients say, read from the wire: questions, orders, and what makes no sense; no I/O, no clock.

`drivers.indi` reads the same stream from the other end; here its elements mean what they mean to a driver.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drivers.indi.codec.messages import Ordered, PingAnswered, Pinged, event_of
from drivers.indi.codec.xml_stream import Element, ElementStream, Malformed

MOST_MESSAGE_BYTES = 65_536
"""No order to a mount is longer."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A client wants to know properties; empty names stand for all.

    Attributes
    ----------
    by_a_server : bool
        Whether an `indiserver` may have asked, for its own clients: it names a device, or says "*".
    """

    device: str
    name: str
    by_a_server: bool = False


@dataclass(frozen=True, slots=True)
class Nonsense:
    """A whole message whose values mean nothing: it is refused, and the connection goes on.

    Attributes
    ----------
    device, name : str
        What it was about, as far as it says.
    """

    device: str
    name: str
    why: str


@dataclass(frozen=True, slots=True)
class Broken:
    """Something that came is not INDI: what was lost can't be known, so the connection ends after it."""

    why: str


Heard = Asked | Ordered | Pinged | PingAnswered | Nonsense | Broken


class Hearing:
    """Bytes in, what a client means out."""

    def __init__(self) -> None:
        self._stream = ElementStream(MOST_MESSAGE_BYTES)

    def feed(self, data: bytes) -> list[Heard]:
        """Take bytes, and return what they complete."""
        return [heard for part in self.parts(data) for heard in part]

    def parts(self, data: bytes) -> Iterator[list[Heard]]:
        """Take bytes, and yield what they complete; see `ElementStream.parts`."""
        for part in self._stream.parts(data):
            understood = (
                Broken(piece.why) if isinstance(piece, Malformed) else meant(piece) for piece in part
            )
            yield [heard for heard in understood if heard is not None]


def meant(element: Element) -> Heard | None:
    """Say what a client means by an element; None: nothing that concerns a mount."""
    if element.tag == "getProperties":
        device, name = element.attributes.get("device", ""), element.attributes.get("name", "")
        # an indiserver that chains all devices of another one asks for "*"
        return Asked("" if device == "*" else device, name, by_a_server=device != "")
    event = event_of(element)
    match event:
        case Ordered() | Pinged() | PingAnswered():
            return event
        case Malformed():
            device, name = element.attributes.get("device", ""), element.attributes.get("name", "")
            return Nonsense(device, name, event.why)
    # enableBLOB, and what other drivers say that a server passes on: nothing for us
    return None


__all__ = ["MOST_MESSAGE_BYTES", "Asked", "Broken", "Heard", "Hearing", "Nonsense", "meant"]
