"""What a device shows, as values, and as INDI writes it [INDI white paper 1.7]; no I/O, no clock.

A vector is all that a client knows of one property. Two that are equal need not be told twice.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal
from xml.sax.saxutils import escape, quoteattr

from drivers.indi.codec.messages import State

Kind = Literal["Text", "Number", "Switch", "Light"]
Perm = Literal["ro", "rw", "wo"]
Rule = Literal["OneOfMany", "AtMostOne", "AnyOfMany"]

_MOST_WORDS = 240
"""Old clients keep a message in 255 bytes."""
_UNSPEAKABLE = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff\ufffe\uffff]+")


@dataclass(frozen=True, slots=True)
class Member:
    """One element of a vector.

    Attributes
    ----------
    value : float, bool or str
        By the vector's kind: number, switch, text.
    form : str
        Of a number: how a client shows it, as INDI's ``%m`` or printf have it.
    least, most : float
        Of a number.
    """

    name: str
    label: str
    value: float | bool | str
    form: str = ""
    least: float = 0.0
    most: float = 0.0


@dataclass(frozen=True, slots=True)
class Vector:
    """One property with its state.

    Attributes
    ----------
    rule : str
        Of switches.
    timeout_s : float
        How long an order may take before a client should worry.
    """

    name: str
    label: str
    group: str
    kind: Kind
    perm: Perm
    state: State
    members: tuple[Member, ...]
    rule: Rule = "OneOfMany"
    timeout_s: float = 60.0

    def with_state(self, state: State) -> Vector:
        """Return the same with another state."""
        return replace(self, state=state)

    def on(self) -> str | None:
        """The switch that is on; None if there is none."""
        return next((member.name for member in self.members if member.value is True), None)


def number(
    name: str, label: str, value: float, *, form: str = "%.2f", least: float = 0.0, most: float = 0.0
) -> Member:
    """An element that is a number."""
    return Member(name, label, value, form, least, most)


def switches(on: str | None, **labels: str) -> tuple[Member, ...]:
    """Elements that are switches, the one named `on` turned on."""
    return tuple(Member(name, label, name == on) for name, label in labels.items())


def numbers(name: str, label: str, group: str, state: State, *members: Member, perm: Perm = "ro") -> Vector:
    """A vector of numbers."""
    return Vector(name, label, group, "Number", perm, state, members)


def texts(
    name: str, label: str, group: str, told: dict[str, tuple[str, str]], state: State = State.IDLE
) -> Vector:
    """A vector of texts that can only be read: of each element its label and what it says."""
    members = tuple(Member(key, *shown) for key, shown in told.items())
    return Vector(name, label, group, "Text", "ro", state, members)


def definition(device: str, vector: Vector, utc: datetime) -> bytes:
    """Write that a device has a property, with its values."""
    attributes = {
        "device": device,
        "name": vector.name,
        "label": vector.label,
        "group": vector.group,
        "state": str(vector.state),
        "perm": vector.perm,
    }
    if vector.kind == "Switch":
        attributes["rule"] = vector.rule
    attributes["timeout"] = f"{vector.timeout_s:g}"
    attributes["timestamp"] = timestamp(utc)
    inside = "".join(_defined(vector.kind, member) for member in vector.members)
    tag = f"def{vector.kind}Vector"
    return f"<{tag}{_written(attributes)}>\n{inside}</{tag}>\n".encode()


def setting(device: str, vector: Vector, utc: datetime, words: str = "") -> bytes:
    """Write what a property is now, perhaps with a message."""
    attributes = {
        "device": device,
        "name": vector.name,
        "state": str(vector.state),
        "timeout": f"{vector.timeout_s:g}",
        "timestamp": timestamp(utc),
    }
    if words:
        attributes["message"] = speakable(words)
    inside = "".join(
        f"  <one{vector.kind} name={quoteattr(member.name)}>{_value(member)}</one{vector.kind}>\n"
        for member in vector.members
    )
    tag = f"set{vector.kind}Vector"
    return f"<{tag}{_written(attributes)}>\n{inside}</{tag}>\n".encode()


def deletion(device: str, name: str, utc: datetime) -> bytes:
    """Write that a property is gone; without a name the whole device."""
    attributes = {"device": device} | ({"name": name} if name else {})
    return f"<delProperty{_written(attributes | {'timestamp': timestamp(utc)})}/>\n".encode()


def saying(device: str, words: str, utc: datetime) -> bytes:
    """Write a message; an empty device is the server itself."""
    attributes = {"device": device} if device else {}
    attributes |= {"timestamp": timestamp(utc), "message": speakable(words)}
    return f"<message{_written(attributes)}/>\n".encode()


def timestamp(utc: datetime) -> str:
    """A moment as INDI writes it: UTC, without a zone."""
    return utc.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def speakable(words: str) -> str:
    """Words in one line, without what XML can't hold, no longer than clients keep."""
    text = " ".join(_UNSPEAKABLE.sub(" ", words).split())
    while len(text.encode()) > _MOST_WORDS:
        text = text[: -max(2, (len(text.encode()) - _MOST_WORDS) // 4 + 2)].rstrip() + "…"
    return text


def _defined(kind: Kind, one: Member) -> str:
    attributes = {"name": one.name, "label": one.label}
    if kind == "Number":
        attributes |= {"format": one.form, "min": f"{one.least:g}", "max": f"{one.most:g}", "step": "0"}
    return f"  <def{kind}{_written(attributes)}>{_value(one)}</def{kind}>\n"


def _value(one: Member) -> str:
    value = one.value
    if isinstance(value, bool):
        return "On" if value else "Off"
    if isinstance(value, str):
        return escape(_UNSPEAKABLE.sub(" ", value))
    # 1e-10 h is 5 µas: nothing that is known is lost
    return f"{value:.10f}"


def _written(attributes: dict[str, str]) -> str:
    return "".join(f" {key}={quoteattr(_UNSPEAKABLE.sub(' ', value))}" for key, value in attributes.items())


__all__ = [
    "Kind",
    "Member",
    "Vector",
    "definition",
    "deletion",
    "number",
    "numbers",
    "saying",
    "setting",
    "speakable",
    "switches",
    "texts",
    "timestamp",
]
