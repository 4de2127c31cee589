"""One piece of work at a time on a telescope, and the orders that need no camera: park, home, track, guide.

Work that is cancelled, or loses its mount, stops the mount.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

from mountnav.devices import Camera, ConnectReport, Direction, MountReading, SlewOutcome, TrackingRate
from mountnav.errors import (
    Busy,
    Cancelled,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceSilent,
    JournalFailed,
    NotReached,
    RefusedButDone,
    TargetNotReached,
)
from mountnav.journal.records import because, cause
from mountnav.mount import CheckedMount
from mountnav.navigation.equipment import Listener

__all__ = ["MountOrders"]


class MountOrders:
    """The orders of one telescope that need no camera; who holds it, and what is wrong with it.

    Parameters
    ----------
    name : str
        The telescope's.
    camera : Camera
        Opened, closed and aborted with the mount.
    listen : callable

    Attributes
    ----------
    activity : str
        What it does: "idle", "looking", "centering", ...
    connected : bool
        Whether its devices are open.
    problem : str or None
        What an operator should know.
    """

    def __init__(self, name: str, mount: CheckedMount, camera: Camera, listen: Listener) -> None:
        self.name = name
        self.mount = mount
        self.camera = camera
        self.activity = "idle"
        self.connected = False
        self.problem: str | None = None
        self._listen = listen
        mount.listen(self._mount_said)

    # -- one at a time -----------------------------------------------------------------------------

    async def open(self) -> None:
        """Open camera and mount. Nothing moves. Raises `DeviceError`."""
        try:
            await self.camera.open()
            await self.mount.open()
        except DeviceError as error:
            self.connected, self.problem = False, str(error)
            raise
        self.connected, self.problem = True, None

    async def close(self) -> None:
        """Release both devices."""
        self.connected = False
        try:
            await self.mount.close()
        finally:
            await self.camera.close()

    async def stop(self) -> None:
        """Stop the mount now, whatever else is going on; then end a running exposure."""
        self._listen("stopping", {})
        try:
            await self.mount.stop()
        finally:
            await self.camera.abort()
        self._listen("stopped", {})

    @asynccontextmanager
    async def work(self, activity: str, *, halts: bool = True) -> AsyncIterator[None]:
        """Hold the telescope for one piece of work; a second one is refused, not queued.

        A piece of work is many orders and looks, say a centering. Each of its orders is held by the mount for
        itself as well (`Admission.held`): orders that don't come by here, as those of the watch over the
        limits, must not cross it either. So neither of the two checks replaces the other.

        Work that is cancelled, or whose mount can't be trusted any more, leaves the mount stopped.

        Parameters
        ----------
        halts : bool
            Whether it is stopped when the work is cancelled: not where that leaves it tracking by itself.

        Raises
        ------
        Busy
        """
        if self.activity != "idle":
            raise Busy(f"busy {self.activity}", device=self.name, advice="wait for it, or stop it")
        self.activity = activity
        try:
            with because(why=cause().why or activity):
                yield
        except asyncio.CancelledError:
            if halts:
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
        """Pass on what the mount announces, and keep what an operator should know."""
        if what == "link-lost":
            self.problem = f"{self.mount.name}: the link was lost: {facts.get('why')}"
        elif what in ("link-back", "trusted"):
            self.problem = None
        if what == "untrusted":
            self.problem = f"{self.mount.name}: its position can't be trusted: {facts.get('why')}"
        self._listen(f"mount-{what}", dict(facts))

    # -- orders ------------------------------------------------------------------------------------

    async def read_mount(self) -> MountReading:
        """Read the mount once, whatever is going on; kept for frames from outside. Raises `DeviceError`."""
        return await self.mount.reading()

    async def park(self) -> SlewOutcome:
        """Go to the park position.

        Raises
        ------
        TargetNotReached
            It came to rest somewhere else: it is not parked, and no roof may close over it.
        Cancelled
            It was stopped on its way.
        DeviceError, OutsideLimits, JournalFailed
        """
        async with self.work("parking"):
            return self._there(await self.mount.park(), "its park position")

    async def unpark(self) -> None:
        """Be ready to move again. Raises `DeviceError`, `JournalFailed`."""
        async with self.work("unparking"):
            await self.mount.unpark()

    async def set_park(self) -> None:
        """Take the present place for the park position. Raises `DeviceError`, `JournalFailed`."""
        async with self.work("setting the park position"):
            await self.mount.set_park()

    async def home(self) -> SlewOutcome:
        """Go home. Raises as `park`."""
        async with self.work("homing"):
            return self._there(await self.mount.home(), "its home")

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow the sky, or rest. Raises `DeviceError`, `JournalFailed`."""
        async with self.work("tracking"):
            await self.mount.set_tracking(on, rate)

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for a moment. Raises `DeviceError`, `JournalFailed`."""
        async with self.work("guiding"):
            await self.mount.guide(direction, duration_s)

    async def set_site_and_time(self) -> ConnectReport:
        """Set the mount's site and clock to ours. Raises `DeviceError`, `JournalFailed`."""
        async with self.work("setting site and time"):
            return await self.mount.set_site_and_time()

    def accept_site_and_time(self) -> str | None:
        """One who may configure accepts that mount and settings differ, until that changes."""
        return self.mount.accept_site_and_time()

    def trust(self) -> None:
        """An operator's word that the mount's position is right."""
        self.mount.trust()
        self.problem = None

    def _there(self, outcome: SlewOutcome, where: str) -> SlewOutcome:
        if outcome is SlewOutcome.STOPPED:
            raise Cancelled(
                f"it was stopped on its way to {where}",
                device=self.mount.name,
                advice="send it again when it is safe",
            )
        if outcome is SlewOutcome.STALLED:
            raise TargetNotReached(
                f"the mount came to rest on its way to {where}",
                device=self.mount.name,
                advice="look at the mount before its next order: is an axis blocked or a clutch open?",
                reason=NotReached.REST,
            )
        return outcome
