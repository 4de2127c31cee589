"""Orders that need no camera: park, home, track, guide; each one holds the telescope while it runs."""

from __future__ import annotations

from mountnav.devices import ConnectReport, Direction, MountReading, SlewOutcome, TrackingRate
from mountnav.errors import Cancelled, NotReached, TargetNotReached
from mountnav.mount import CheckedMount
from mountnav.navigation.one_at_a_time import OneAtATime


class MountOrders:
    """What is ordered of a mount alone.

    Parameters
    ----------
    mount : CheckedMount
    work : OneAtATime
    """

    def __init__(self, mount: CheckedMount, work: OneAtATime) -> None:
        self.mount = mount
        self._work = work

    @property
    def activity(self) -> str:
        """What it does: "idle", "looking", "centering", ..."""
        return self._work.activity

    async def open(self) -> None:
        """Open camera and mount. Nothing moves. Raises `DeviceError`."""
        await self._work.open()

    async def close(self) -> None:
        """Release both devices."""
        await self._work.close()

    async def stop(self) -> None:
        """Stop the mount now, whatever is going on; then end a running exposure. Raises `DeviceError`."""
        await self._work.stop()

    async def glance(self) -> MountReading:
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
        async with self._work.work("parking"):
            return self._there(await self.mount.park(), "its park position")

    async def unpark(self) -> None:
        """Be ready to move again. Raises `DeviceError`, `JournalFailed`."""
        async with self._work.work("unparking"):
            await self.mount.unpark()

    async def set_park(self) -> None:
        """Take the present place for the park position. Raises `DeviceError`, `JournalFailed`."""
        async with self._work.work("setting the park position"):
            await self.mount.set_park()

    async def home(self) -> SlewOutcome:
        """Go home. Raises as `park`."""
        async with self._work.work("homing"):
            return self._there(await self.mount.home(), "its home")

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow the sky, or rest. Raises `DeviceError`, `JournalFailed`."""
        async with self._work.work("tracking"):
            await self.mount.set_tracking(on, rate)

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for a moment. Raises `DeviceError`, `JournalFailed`."""
        async with self._work.work("guiding"):
            await self.mount.guide(direction, duration_s)

    async def set_site_and_time(self) -> ConnectReport:
        """Set the mount's site and clock to ours. Raises `DeviceError`, `JournalFailed`."""
        async with self._work.work("setting site and time"):
            return await self.mount.set_site_and_time()

    def accept_site_and_time(self) -> str | None:
        """One who may configure accepts that mount and settings differ, until that changes."""
        return self.mount.accept_site_and_time()

    def trust(self) -> None:
        """An operator's word that the mount's position is right."""
        self.mount.trust()
        self._work.problem = None

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


__all__ = ["MountOrders"]
