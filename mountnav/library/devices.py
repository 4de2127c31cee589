"""Mounts, cameras and fake mounts by their URLs, for scripts.

The core knows no driver. What opens them is found by name among the installed entry points of the group
``mountnav.devices``, where the drivers that come with mountnav are registered.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from importlib.metadata import entry_points
from typing import Any

from mountnav.devices import Camera, Mount
from mountnav.errors import BadSettings
from mountnav.mount.sending import stopped_if_broken_off
from mountnav.sky.coordinates import Site

GROUP = "mountnav.devices"
"""The group of entry points; a package of its own may register other drivers under other names."""


def _registered(name: str) -> Callable[..., Any]:
    found = entry_points(group=GROUP, name=name)
    if not found:
        raise BadSettings(
            f"no installed package registers {name} in {GROUP}", advice="install mountnav with its drivers"
        )
    opened: Callable[..., Any] = next(iter(found)).load()
    return opened


@asynccontextmanager
async def open_mount(url: str, *, name: str | None = None, site: Site | None = None) -> AsyncIterator[Mount]:
    """Connect a mount for the length of an ``async with``; an error that leaves it stops the mount.

    Parameters
    ----------
    url : str
        As in the settings: ``lx200+serial:///dev/ttyUSB0``, ``indi://localhost:7624/EQMod Mount``, ...
    name : str, optional
        For messages.
    site : Site, optional
        For mounts that know none.

    Yields
    ------
    Mount
        Connected. No limits are checked on this way: that is what a `Navigator`, or the service, is for.

    Raises
    ------
    BadSettings
        The URL makes no sense.
    DeviceError
        Nothing answers there, or not as such a mount does.
    """
    mount: Mount = _registered("mount")(url, name=name, site=site)
    await mount.open()
    try:
        # a script that breaks off, or Ctrl-C, must not leave a slew behind that nobody watches
        async with stopped_if_broken_off(mount):
            yield mount
    finally:
        await mount.close()


@asynccontextmanager
async def open_camera(url: str, *, name: str | None = None) -> AsyncIterator[Camera]:
    """Connect a camera for the length of an ``async with``: INDI or Alpaca, by its URL. As `open_mount`."""
    camera: Camera = _registered("camera")(url, name=name)
    await camera.open()
    try:
        yield camera
    finally:
        await camera.close()


def fake_mount(protocol: str = "lx200", dialect: str | None = None, *, site: Site | None = None) -> Any:
    """Serve a fake mount on a pseudo-terminal for the length of a ``with``.

    Parameters
    ----------
    protocol : str
        lx200, nexstar, synscan, ioptron or skywatcher.
    dialect : str, optional
        As ``mountnav fake-mount --list`` names them.
    site : Site, optional
        Where it stands.

    Returns
    -------
    context manager
        Gives the URL to open it by.

    Raises
    ------
    BadRequest
        There is no such protocol or dialect.
    """
    return _registered("fake")(protocol, dialect, site=site)
