"""What a driver's messages after an order mean: taken up, refused and why, or spoiled by others; no I/O.

INDI has no answer that says "no". A driver that refuses sets a property to Alert, or leaves it as it was, and
says a sentence; its words become the refusal's.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from drivers.generic.refusal_words import ADVICE, OF_HORIZON, OF_LIMITS, OF_PARKING
from drivers.indi.codec.messages import Changed, Event, State, message_of
from mountnav.errors import DeviceRefused, Refusal

_REASONS = (
    OF_HORIZON,
    OF_PARKING,
    OF_LIMITS,
    (re.compile(r"align|star sync|initiali[sz]e", re.I), Refusal.NOT_ALIGNED),
    (re.compile(r"not tracking|enable tracking|in standby", re.I), Refusal.NOT_TRACKING),
    (re.compile(r"busy|in progress|already slewing|is slewing|while slewing", re.I), Refusal.BUSY),
    (re.compile(r"not support|unsupported|cannot be used", re.I), Refusal.UNSUPPORTED),
)
_LOUD = ("[ERROR]", "[WARNING]")


def plain(words: str) -> str:
    """A driver's words without the level in front, white space made single."""
    text = " ".join(words.split())
    return text.partition("] ")[2] if text.startswith("[") and "] " in text else text


def spoken(events: Sequence[Event]) -> str:
    """What was said among events: errors and warnings if there are some, else all of it."""
    texts = [text for event in events if (text := message_of(event))]
    loud = [text for text in texts if text.startswith(_LOUD)]
    return "; ".join(dict.fromkeys(map(plain, loud or texts)))


def reason_of(words: str) -> Refusal:
    """Which refusal a driver's words mean, as far as they say."""
    return next((reason for pattern, reason in _REASONS if pattern.search(words)), Refusal.OTHER)


def refusal(what: str, heard: Sequence[Event], device: str) -> DeviceRefused:
    """Make the refusal of what was said."""
    words = spoken(heard)
    reason = reason_of(words)
    return DeviceRefused(
        f"refused {what}: {words or 'its driver does not say why'}",
        device=device,
        advice=ADVICE.get(reason, "see what its driver says"),
        reason=reason,
    )


def parked_refusal(what: str, device: str) -> DeviceRefused:
    """Make the refusal that needs no asking."""
    return DeviceRefused(
        f"refused {what}: it is parked",
        device=device,
        advice=ADVICE[Refusal.PARKED],
        reason=Refusal.PARKED,
    )


def states_of(name: str, heard: Sequence[Event]) -> list[State]:
    """The states that a property was set to."""
    return [
        event.state
        for event in heard
        if isinstance(event, Changed) and event.name == name and event.state is not None
    ]


def is_loud(heard: Sequence[Event]) -> bool:
    """Whether an error or a warning was said."""
    return any(message_of(event).startswith(_LOUD) for event in heard)


def was_refused(name: str, heard: Sequence[Event]) -> bool:
    """Whether an order to a property was refused: Alert, or loud words and no sign of content."""
    states = states_of(name, heard)
    content = State.OK in states or State.BUSY in states
    return State.ALERT in states or (is_loud(heard) and not content)


def slew_was_refused(name: str, heard: Sequence[Event]) -> bool:
    """Whether coordinates were refused: Ok is sent of them at every poll, so only Busy is a sign."""
    states = states_of(name, heard)
    return State.ALERT in states or (is_loud(heard) and State.BUSY not in states)


def was_turned(mode: str, name: str, heard: Sequence[Event]) -> bool:
    """Whether ON_COORD_SET was changed by another program before a driver took up our coordinates.

    Parameters
    ----------
    mode : str
        Which switch of it we set.
    name : str
        Of the coordinates.
    heard : sequence of Event
        Since we set it, in order.
    """
    ours = True
    for event in heard:
        if not isinstance(event, Changed):
            continue
        if event.name == "ON_COORD_SET":
            ours = event.values.get(mode) is True
        elif event.name == name:
            if not ours:
                return True
            if event.state is State.BUSY:
                return False
    return False
