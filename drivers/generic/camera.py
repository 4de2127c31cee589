"""A whole camera made of any protocol's language: reopened when lost, one exposure at a time, abortable."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol, TypeVar

from drivers.wire.wire_log import WireLog
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceSilent,
    MountnavError,
)
from mountnav.frames import Frame
from mountnav.tasks import waited_for

T = TypeVar("T")


class Shot:
    """One exposure that was ordered, until it is done or aborted.

    Parameters
    ----------
    device : str
        For messages.
    """

    def __init__(self, exposure_s: float, device: str) -> None:
        self.exposure_s = exposure_s
        self.device = device
        self._aborted = asyncio.Event()

    @property
    def aborted(self) -> bool:
        """Whether it was aborted."""
        return self._aborted.is_set()

    def abort(self) -> None:
        """Abort it: everything that waits for it raises `Cancelled`."""
        self._aborted.set()

    def require_wanted(self) -> None:
        """Raise `Cancelled` if it was aborted."""
        if self.aborted:
            raise Cancelled("the exposure was aborted", device=self.device)

    async def pause(self, for_s: float) -> None:
        """Wait; raises `Cancelled` as soon as the exposure is aborted."""
        with suppress(TimeoutError):
            async with asyncio.timeout(for_s):
                await self._aborted.wait()
        self.require_wanted()

    async def outlast(self, work: Awaitable[T]) -> T:
        """Wait for `work`; cancels it and raises `Cancelled` as soon as the exposure is aborted."""
        working = waited_for(work)
        waiting = waited_for(self._aborted.wait())
        try:
            await asyncio.wait({working, waiting}, return_when=asyncio.FIRST_COMPLETED)
            self.require_wanted()
            return await working
        finally:
            for task in (working, waiting):
                task.cancel()
            with suppress(asyncio.CancelledError, MountnavError):
                await working


class ExposureLock:
    """One exposure at a time.

    Parameters
    ----------
    device : str
        For messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._shot: Shot | None = None

    @contextmanager
    def hold(self, exposure_s: float) -> Iterator[Shot]:
        """A context in which one shot runs.

        Raises
        ------
        BadRequest
            If the exposure is not positive.
        Busy
            If one runs.
        """
        if not 0.0 < exposure_s < math.inf:
            raise BadRequest(f"an exposure of {exposure_s} s", device=self._device, advice="longer than 0 s")
        if self._shot is not None:
            raise Busy("an exposure is running", device=self._device, advice="wait for it, or abort it")
        self._shot = Shot(exposure_s, self._device)
        try:
            yield self._shot
        finally:
            self._shot = None

    def abort(self) -> bool:
        """Abort the shot that runs; return whether there was one."""
        if self._shot is None:
            return False
        self._shot.abort()
        return True


class CameraLanguage(Protocol):
    """What a protocol must offer for one camera; `GenericCamera` makes a whole camera of it.

    No two methods are called at once, except `send_abort`.
    """

    done: tuple[str, ...]
    """What was set at the last opening, or before the last exposure, in words."""

    @property
    def name(self) -> str:
        """Name, for messages."""
        ...

    @property
    def log(self) -> WireLog:
        """The latest messages; images are abbreviated."""
        ...

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        ...

    async def open(self) -> None:
        """Connect, again if the connection was lost, and set up; a failure leaves no connection behind."""
        ...

    async def close(self) -> None:
        """Release the connection; the camera stays connected, for others."""
        ...

    async def wait_until_idle(self, shot: Shot) -> None:
        """Wait a moment until no exposure runs, for example one that was just aborted.

        Raises
        ------
        BadRequest
            If the camera takes no such exposure.
        Busy
            If an exposure of another program runs.
        """
        ...

    async def set_up(self) -> None:
        """Set binning and the full frame again: another program may have changed them."""
        ...

    async def take(self, shot: Shot) -> Frame:
        """Order the exposure and wait for its image; raises `Cancelled` when it is aborted."""
        ...

    def send_abort(self) -> None:
        """Send an abort past all other orders, without waiting for its outcome; raises nothing."""
        ...


class GenericCamera:
    """A `mountnav.devices.Camera`."""

    def __init__(self, language: CameraLanguage) -> None:
        self._language = language
        self._wanted_open = False
        self._opening = asyncio.Lock()
        self._exposing = ExposureLock(language.name)
        self._ordered = False

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._language.name

    @property
    def wire_log(self) -> WireLog:
        """The latest messages; images are abbreviated."""
        return self._language.log

    @property
    def done(self) -> tuple[str, ...]:
        """What was set at the last opening, or before the last exposure, in words."""
        return self._language.done

    async def open(self) -> None:
        """Connect, and set the camera as the settings say.

        Raises
        ------
        DeviceMissing, DeviceSilent, DeviceGarbled
            If there is no server, no such camera, or it can't be connected.
        DeviceRefused
            If it is not connected and must not be connected, is no camera, or refuses its settings.
        """
        async with self._opening:
            await self._language.open()
        self._wanted_open = True

    async def close(self) -> None:
        """Release the connection; a running `expose` ends as after `abort`. The camera stays connected."""
        self._wanted_open = False
        with suppress(DeviceError):
            await self.abort()
        await self._language.close()

    async def expose(self, exposure_s: float) -> Frame:
        """Take one frame.

        Returns
        -------
        Frame
            With `mid_exposure_utc` by the camera's own time where that agrees with our clock, else by ours;
            `source` says by which.

        Raises
        ------
        BadRequest
            If the exposure is not positive, or outside the camera's limits.
        Busy
            If an exposure runs, ours or another program's.
        Cancelled
            After `abort`.
        DeviceRefused
            If the driver refuses, fails, or another program ended the exposure.
        DeviceSilent
            If no image came in time.
        DeviceGarbled, BadFrame
            If the image can't be read, or is not as it was set.
        DeviceMissing
            If server, driver or camera is gone.
        """
        with self._exposing.hold(exposure_s) as shot:
            return await self._expose(shot)

    async def _expose(self, shot: Shot) -> Frame:
        try:
            opened = await self._ready()
            await self._language.wait_until_idle(shot)
            if not opened:
                await self._language.set_up()
            shot.require_wanted()
            self._ordered = True
            return await self._language.take(shot)
        except (asyncio.CancelledError, DeviceSilent, DeviceGarbled):
            # an exposure that nobody waits for must not occupy the camera
            self._end_ours()
            raise
        finally:
            self._ordered = False

    async def abort(self) -> None:
        """End a running exposure; its `expose` raises `Cancelled`. Without one, nothing happens."""
        if self._exposing.abort():
            self._end_ours()

    def _end_ours(self) -> None:
        # before ours is ordered, an exposure that runs is another program's
        if self._ordered and self._language.usable:
            self._language.send_abort()

    async def _ready(self) -> bool:
        """Open a connection again that was lost since `open`; return whether it was."""
        if self._language.usable:
            return False
        if not self._wanted_open:
            raise DeviceMissing("not connected", device=self.name, advice="open the camera first")
        async with self._opening:
            await self._language.open()
        return True
