"""What a client says to an `indiserver` [INDI white paper 1.7]; no I/O, no clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal
from xml.sax.saxutils import quoteattr

VERSION = "1.7"
BlobMode = Literal["Never", "Also", "Only"]


def get_properties(device: str = "", name: str = "") -> bytes:
    """Ask for all properties, those of a device, or one; the driver defines them anew, with its values."""
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
