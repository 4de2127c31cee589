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
from mountnav.navigation.rotator import CheckedRotator

__all__ = ["MountOrders"]


ROTATOR_STOPS_S = 1.0
"""So long a stop waits for a rotator that we don't turn, s: another program may. Doubled, the stop of a mount
whose rotator is switched off is answered a second later."""


class MountOrders:
    """The orders of one telescope that need no camera; who holds it, and what is wrong with it.

    Parameters
    ----------
    name : str
        The telescope's.
    camera : Camera
        Opened, closed and aborted with the mount.
    listen : callable
        Hears what happens, for the event stream.
    rotator : CheckedRotator, optional
        Opened, closed and stopped with the mount: it moves as well.

    Attributes
    ----------
    activity : str
        What it does: "idle", "looking", "centering", ...
    connected : bool
        Whether its devices are open.
    problem : str or None
        What an operator should know.
    """

    def __init__(
        self,
        name: str,
        mount: CheckedMount,
        camera: Camera,
        listen: Listener,
        rotator: CheckedRotator | None = None,
    ) -> None:
        self.name = name
        self.mount = mount
        self.camera = camera
        self.rotator = rotator
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
            await self._open_rotator()
        except DeviceError as error:
            self.connected, self.problem = False, str(error)
            raise
        self.connected, self.problem = True, None

    async def _open_rotator(self) -> None:
        """One that is missing is tried again when it is needed: without it everything else works."""
        if self.rotator is None:
            return
        try:
            await self.rotator.open()
        except DeviceError as error:
            self._listen("rotator-missing", {"problem": str(error)})

    async def close(self) -> None:
        """Release all devices."""
        self.connected = False
        try:
            await self.mount.close()
        finally:
            if self.rotator is not None:
                await self.rotator.close()
            await self.camera.close()

    async def stop(self) -> None:
        """Stop the mount now, whatever else is going on, and what else moves; then end a running exposure.

        Raises
        ------
        DeviceError
            One of them could not be stopped; the others were.
        """
        self._listen("stopping", {})
        try:
            if self.rotator is None:
                await self.mount.stop()
            else:
                await self._stop_both(self.rotator)
        finally:
            await self.camera.abort()
        self._listen("stopped", {})

    async def _stop_both(self, rotator: CheckedRotator) -> None:
        """Stop mount and rotator at once; one that we don't turn and that can't be reached is no trouble."""
        turning = rotator.turning

        async def stop_rotator() -> None:
            async with asyncio.timeout(None if turning else ROTATOR_STOPS_S):
                await rotator.stop()

        both = await asyncio.gather(self.mount.stop(), stop_rotator(), return_exceptions=True)
        for trouble in both[: 2 if turning else 1]:
            if isinstance(trouble, BaseException):
                raise trouble
        if both[1] is not None:
            self._listen("rotator-stop-failed", {"problem": str(both[1]) or type(both[1]).__name__})

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
                f"the mount stopped on its way to {where}",
                device=self.mount.name,
                advice="look at the mount before its next order: is an axis blocked, or a clutch open?",
                reason=NotReached.REST,
            )
        return outcome
