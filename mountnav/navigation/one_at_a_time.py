"""One piece of work at a time on a telescope; one that is cancelled, or loses its mount, stops the mount."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

from mountnav.devices import Camera
from mountnav.errors import (
    Busy,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceSilent,
    JournalFailed,
    RefusedButDone,
)
from mountnav.journal.records import because, cause
from mountnav.mount import CheckedMount
from mountnav.navigation.equipment import Listener


class OneAtATime:
    """Who holds a telescope, and what is wrong with it.

    Parameters
    ----------
    name : str
        The telescope's.
    mount : CheckedMount
    camera : Camera
    listen : callable

    Attributes
    ----------
    activity : str
        What it does: "idle", "looking", ...
    connected : bool
        Whether its devices are open.
    problem : str or None
        What an operator should know.
    """

    def __init__(self, name: str, mount: CheckedMount, camera: Camera, listen: Listener) -> None:
        self.activity = "idle"
        self.connected = False
        self.problem: str | None = None
        self._name = name
        self._mount = mount
        self._camera = camera
        self._listen = listen
        mount.listen(self._mount_said)

    async def open(self) -> None:
        """Open camera and mount. Nothing moves. Raises `DeviceError`."""
        try:
            await self._camera.open()
            await self._mount.open()
        except DeviceError as error:
            self.connected, self.problem = False, str(error)
            raise
        self.connected, self.problem = True, None

    async def close(self) -> None:
        """Release both devices."""
        self.connected = False
        try:
            await self._mount.close()
        finally:
            await self._camera.close()

    async def stop(self) -> None:
        """Stop the mount now, whatever else is going on; then end a running exposure."""
        self._listen("stopping", {})
        try:
            await self._mount.stop()
        finally:
            await self._camera.abort()
        self._listen("stopped", {})

    @asynccontextmanager
    async def work(self, activity: str) -> AsyncIterator[None]:
        """Hold the telescope for one piece of work; a second one is refused, not queued.

        Work that is cancelled, or whose mount can't be trusted any more, leaves the mount stopped.

        Raises
        ------
        Busy
        """
        if self.activity != "idle":
            raise Busy(f"busy {self.activity}", device=self._name, advice="wait for it, or stop it")
        self.activity = activity
        try:
            with because(why=cause().why or activity):
                yield
        except asyncio.CancelledError:
            await asyncio.shield(self.halt())
            raise
        except (DeviceSilent, DeviceGarbled, DeviceMissing, RefusedButDone):
            await self.halt()
            raise
        finally:
            self.activity = "idle"

    async def halt(self) -> None:
        """Stop on the way out of trouble; the trouble itself is what the caller hears of."""
        try:
            await self.stop()
        except (DeviceError, JournalFailed) as error:
            self.problem = f"could not be stopped: {error}"
            self._listen("stop-failed", {"problem": str(error)})

    def _mount_said(self, what: str, facts: Mapping[str, object]) -> None:
        """Pass on what the mount tells unasked, and keep what an operator should know."""
        if what == "link-lost":
            self.problem = f"{self._mount.name}: the link was lost: {facts.get('why')}"
        elif what in ("link-back", "trusted"):
            self.problem = None
        if what == "untrusted":
            self.problem = f"{self._mount.name}: its position can't be trusted: {facts.get('why')}"
        self._listen(f"mount-{what}", dict(facts))


__all__ = ["OneAtATime"]
