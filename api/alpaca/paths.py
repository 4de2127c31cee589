"""What an Alpaca path asks for. Case counts, and so does each slash. No I/O [Alpaca §1, §6]."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from api.alpaca.parameters import LARGEST_ID

_DEVICE = re.compile(r"/api/v1/telescope/([0-9]{1,10})/([a-z0-9]+)")
_SETUP = re.compile(r"/setup/v1/telescope/([0-9]{1,10})/setup")

Page = Literal["apiversions", "description", "configureddevices"]
_PAGES: dict[str, Page] = {
    "/management/apiversions": "apiversions",
    "/management/v1/description": "description",
    "/management/v1/configureddevices": "configureddevices",
}


@dataclass(frozen=True, slots=True)
class DevicePath:
    """A member of a telescope."""

    number: int
    command: str


@dataclass(frozen=True, slots=True)
class ManagementPath:
    """One of the management's three answers."""

    page: Page


@dataclass(frozen=True, slots=True)
class SetupPath:
    """A page for people: the server's (None) or a telescope's."""

    number: int | None


def read_path(path: str) -> DevicePath | ManagementPath | SetupPath | None:
    """What a path asks for; None if it is none of ours."""
    if (page := _PAGES.get(path)) is not None:
        return ManagementPath(page)
    if path in ("/setup", "/setup/"):
        return SetupPath(None)
    if (found := _DEVICE.fullmatch(path)) is not None and int(found[1]) <= LARGEST_ID:
        return DevicePath(int(found[1]), found[2])
    if (found := _SETUP.fullmatch(path)) is not None and int(found[1]) <= LARGEST_ID:
        return SetupPath(int(found[1]))
    return None


__all__ = ["DevicePath", "ManagementPath", "Page", "SetupPath", "read_path"]
