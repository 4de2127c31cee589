"""INDI's messages, read from the wire and written to it [INDI white paper 1.7]; no I/O, no clock.

Bytes in, events out. A message that is whole and makes no sense becomes `Malformed` like one that is broken:
a change may be lost with it, and the client asks for the properties again, unless it names another
device, or none.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal
from xml.sax.saxutils import quoteattr

from drivers.indi.codec.xml_stream import MOST_MESSAGE_BYTES, Element, ElementStream, Malformed, plain_text

Kind = Literal["Text", "Number", "Switch", "Light", "BLOB"]

_SEXAGESIMAL = re.compile(
    r"([+-]?)(\d+(?:\.\d*)?|\.\d+)(?:[:; ]+(\d+(?:\.\d*)?))?(?:[:; ]+(\d+(?:\.\d*)?))?$",
    re.ASCII,  # other scripts' digits are no order to a mount
)
_LENGTH = re.compile(r"[0-9]{1,15}", re.ASCII)
"""Of a file, in bytes. Python refuses to read numbers of more than 4,300 digits."""
_MOST_NUMBER_CHARACTERS = 400
"""The longest double that C writes with ``%f`` has 317; what is longer is no number of any driver."""


class State(StrEnum):
    """What a driver claims of a property."""

    IDLE = "Idle"
    OK = "Ok"
    BUSY = "Busy"
    ALERT = "Alert"


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """A file as it came: still in base64, maybe compressed; `drivers.indi.codec.exposure` unwraps it.

    Attributes
    ----------
    format : str
        ".fits", ".fits.z", ".fits.fz", ...
    size : int
        What the driver says of its length when unwrapped.
    length : int or None
        What it says of its length before base64.
    encoded : tuple of bytes
        In the pieces it came in; two are the same if these make the same.
    """

    format: str
    size: int
    length: int | None
    encoded: tuple[bytes, ...]

    def __eq__(self, other: object) -> bool:
        """Whether it is the same file, in whatever pieces."""
        return isinstance(other, Blob) and self._whole() == other._whole()

    def __hash__(self) -> int:
        return hash(self._whole())

    def _whole(self) -> tuple[str, int, int | None, bytes]:
        return self.format, self.size, self.length, b"".join(self.encoded)

    @property
    def is_empty(self) -> bool:
        """Whether it holds nothing: drivers say so of a file that there isn't."""
        return not any(map(bytes.strip, self.encoded))


Value = str | float | bool | State | Blob


@dataclass(frozen=True, slots=True)
class Defined:
    """A device has this property.

    Attributes
    ----------
    perm : str
        "ro", "wo", "rw"; lights have none.
    rule : str
        Of switches: "OneOfMany", "AtMostOne", "AnyOfMany".
    values : dict
        By element; BLOBs have none yet.
    raw : bytes
        As it came, abbreviated.
    """

    device: str
    name: str
    kind: Kind
    state: State
    perm: str
    rule: str
    label: str
    group: str
    values: dict[str, Value]
    message: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Changed:
    """A property has changed; elements that are not sent stay, and so does the state if it is None."""

    device: str
    name: str
    kind: Kind
    state: State | None
    values: dict[str, Value]
    message: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Ordered:
    """Another client has ordered this: servers pass on what clients order to the others."""

    device: str
    name: str
    kind: Kind
    values: dict[str, Value]
    raw: bytes


@dataclass(frozen=True, slots=True)
class Deleted:
    """A property is no longer there, or with an empty name the whole device."""

    device: str
    name: str
    message: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Said:
    """A driver says something; with an empty device the server does."""

    device: str
    message: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Pinged:
    """The other end wants a ping answered."""

    uid: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class PingAnswered:
    """Our ping came back."""

    uid: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Other:
    """Whole, and nothing a client listens to: another client's question, an unknown element."""

    tag: str
    raw: bytes


Event = Defined | Changed | Ordered | Deleted | Said | Pinged | PingAnswered | Other | Malformed


def message_of(event: Event) -> str:
    """What a driver says in words with an event; empty if nothing."""
    return event.message if isinstance(event, Defined | Changed | Deleted | Said) else ""


class Reader:
    """Bytes in, events out.

    Parameters
    ----------
    most_bytes : int
        A longer message counts as broken.
    """

    def __init__(self, most_bytes: int = MOST_MESSAGE_BYTES) -> None:
        self._stream = ElementStream(most_bytes)

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes, and return what they complete."""
        return [event for part in self.parts(data) for event in part]

    def parts(self, data: bytes) -> Iterator[list[Event]]:
        """Take bytes, and yield what they complete; see `ElementStream.parts`."""
        for part in self._stream.parts(data):
            yield [found if isinstance(found, Malformed) else event_of(found) for found in part]


class _Nonsense(ValueError):
    """A whole element that means nothing."""


def event_of(element: Element) -> Event:
    """Say what an element means."""
    try:
        return _meant(element)
    except _Nonsense as fault:
        return Malformed(str(fault), element.raw[:80], element.attributes.get("device", ""))


def _meant(element: Element) -> Event:
    tag, given = element.tag, element.attributes
    match tag[:3], tag[3:].removesuffix("Vector") if tag.endswith("Vector") else "":
        case "def", ("Text" | "Number" | "Switch" | "Light" | "BLOB") as kind:
            return Defined(
                device=_needed(element, "device"),
                name=_needed(element, "name"),
                kind=kind,
                state=_state(given.get("state", "")),
                perm=given.get("perm", ""),
                rule=given.get("rule", ""),
                label=given.get("label", ""),
                group=given.get("group", ""),
                values={} if kind == "BLOB" else _values(element, f"def{kind}"),
                message=given.get("message", ""),
                raw=element.raw,
            )
        case "set", ("Text" | "Number" | "Switch" | "Light" | "BLOB") as kind:
            state = given.get("state", "")
            return Changed(
                device=_needed(element, "device"),
                name=_needed(element, "name"),
                kind=kind,
                state=_state(state) if state else None,
                values=_values(element, f"one{kind}"),
                message=given.get("message", ""),
                raw=element.raw,
            )
        case "new", ("Text" | "Number" | "Switch" | "BLOB") as kind:
            return Ordered(
                device=_needed(element, "device"),
                name=_needed(element, "name"),
                kind=kind,
                values=_values(element, f"one{kind}"),
                raw=element.raw,
            )
    match tag:
        case "delProperty":
            return Deleted(
                _needed(element, "device"), given.get("name", ""), given.get("message", ""), element.raw
            )
        case "message":
            return Said(given.get("device", ""), given.get("message", ""), element.raw)
        case "pingRequest":
            return Pinged(given.get("uid", ""), element.raw)
        case "pingReply":
            return PingAnswered(given.get("uid", ""), element.raw)
    return Other(tag, element.raw)


def shortened(text: str) -> str:
    """A stranger's text as it stands in our messages: quoted, and no longer than a line."""
    return repr(text if len(text) <= 60 else f"{text[:60]}...")


def _needed(element: Element, attribute: str) -> str:
    value = element.attributes.get(attribute, "")
    if not value:
        raise _Nonsense(f"a {shortened(element.tag)} without its {attribute}")
    return value


def _state(text: str) -> State:
    try:
        return State(text)
    except ValueError:
        raise _Nonsense(f"{shortened(text)} is not a state") from None


def _values(element: Element, tag: str) -> dict[str, Value]:
    values: dict[str, Value] = {}
    for child in element.children:
        if child.tag != tag:
            raise _Nonsense(f"a {shortened(child.tag)} in a {element.tag}")
        values[_needed(child, "name")] = _value(child, tag[3:])
    return values


def _value(element: Element, kind: str) -> Value:
    if kind == "BLOB":
        length = element.attributes.get("len", "")
        return Blob(
            format=element.attributes.get("format", ""),
            size=_count(element.attributes.get("size", "")),
            length=_count(length) if length else None,
            encoded=element.pieces,
        )
    text = plain_text(element.text).strip()
    match kind:
        case "Number":
            return number(text)
        case "Switch":
            if text not in ("On", "Off"):
                raise _Nonsense(f"{shortened(text)} is not a switch")
            return text == "On"
        case "Light":
            return _state(text)
    return text


def _count(text: str) -> int:
    if not _LENGTH.fullmatch(text.strip()):
        raise _Nonsense(f"{shortened(text)} is not a length")
    return int(text)


def number(text: str) -> float:
    """Read a number: plain, with an exponent, or sexagesimal ("-8:01:26.04", "8 1 26", "8:01.5").

    Raises
    ------
    ValueError
        If it is none. "nan" and "inf" are numbers: drivers say so of what they don't know.
    """
    if len(text) > _MOST_NUMBER_CHARACTERS:
        raise _Nonsense(f"{shortened(text)} is not a number")
    match = _SEXAGESIMAL.match(text)
    if match is None:
        try:
            if "_" in text or not text.isascii():
                raise ValueError
            return float(text)
        except ValueError:
            raise _Nonsense(f"{text!r} is not a number") from None
    whole, minutes, seconds = (float(match[part] or 0.0) for part in (2, 3, 4))
    if minutes >= 60.0 or seconds >= 60.0 + 1e-9:
        raise _Nonsense(f"{text!r} is not a number")
    # the sign stands before the whole: "-0:30" is half a unit below zero
    return math.copysign(whole + minutes / 60.0 + seconds / 3600.0, -1.0 if match[1] == "-" else 1.0)


VERSION = "1.7"
BlobMode = Literal["Never", "Also", "Only"]


def get_properties(device: str = "", name: str = "") -> bytes:
    """Ask for all properties, those of a device, or one; the driver defines them again, with its values."""
    return _alone("getProperties", {"version": VERSION, "device": device, "name": name})


def enable_blob(device: str, mode: BlobMode, name: str = "") -> bytes:
    """Say whether this connection wants a device's BLOBs; a new one gets none."""
    return f"<enableBLOB{_attributes({'device': device, 'name': name})}>{mode}</enableBLOB>\n".encode()


def new_numbers(device: str, name: str, values: Mapping[str, float]) -> bytes:
    """Order numbers; drivers want all elements of a vector.

    Raises
    ------
    ValueError
        If one is not finite.
    """
    if not all(map(math.isfinite, values.values())):
        raise ValueError(f"{dict(values)} for {name}")
    return _order("Number", device, name, {key: f"{value:.12f}" for key, value in values.items()})


def new_switches(device: str, name: str, values: Mapping[str, bool]) -> bytes:
    """Order switches."""
    return _order("Switch", device, name, {key: "On" if on else "Off" for key, on in values.items()})


def new_texts(device: str, name: str, values: Mapping[str, str]) -> bytes:
    """Order texts."""
    return _order("Text", device, name, values)


def ping_request(uid: str) -> bytes:
    """Ask the server whether it lives; indiserver 1.9.8 and later answers, without a driver's help."""
    return _alone("pingRequest", {"uid": uid})


def ping_reply(uid: str) -> bytes:
    """Answer a ping: a server that flows BLOBs by pings waits for it."""
    return _alone("pingReply", {"uid": uid})


def _order(kind: str, device: str, name: str, values: Mapping[str, str]) -> bytes:
    inside = "".join(
        f"<one{kind}{_attributes({'name': key})}>{_escaped(value)}</one{kind}>"
        for key, value in values.items()
    )
    vector = f"new{kind}Vector"
    return f"<{vector}{_attributes({'device': device, 'name': name})}>{inside}</{vector}>\n".encode()


def _alone(tag: str, attributes: Mapping[str, str]) -> bytes:
    return f"<{tag}{_attributes(attributes)}/>\n".encode()


def _attributes(attributes: Mapping[str, str]) -> str:
    return "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items() if value)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
