"""Readings of a mount behind INDI: the place asked for again, and no poll of a driver counted twice.

A driver reads its mount once in a while and reports what has changed; asked, it reports what it read last. So
while the mount may be moving a reading waits for the driver's next look: two readings are two looks.
"""

from __future__ import annotations

import asyncio
import math

from drivers.generic.language import Readout
from drivers.indi.codec import state
from drivers.indi.codec.answers import plain
from drivers.indi.codec.messages import State
from drivers.indi.codec.state import COORDINATES, Property
from drivers.indi.device import IndiDevice
from mountnav.clock import utc_now
from mountnav.devices import Epoch
from mountnav.errors import DeviceGarbled, DeviceSilent

_RESTLESS_S = 20.0
"""For how long after an order or a doubtful reading the mount counts as moving, so that each reading waits
for the driver's next look at it. Chosen by hand; doubled, readings stay slow for longer."""
_NONSENSE_S = 5.0
"""How long a place that makes no sense is asked for again before it is an error. Chosen by hand: several
polls of a driver that polls once a second."""


class MountReader:
    """Makes the readouts of one device."""

    def __init__(self, device: IndiDevice) -> None:
        self._device = device
        self.epoch: Epoch = "apparent"
        self._restless_until_s = 0.0
        self._last_look_s = -math.inf
        self._unread = False
        self._doubted = False

    @property
    def poll_s(self) -> float:
        """How often its driver looks at the mount."""
        return state.poll_s(self._device.get)

    def begin(self, *, unread: bool) -> None:
        """Forget what was: the device is up again; `unread` if its driver has just been connected."""
        self._unread, self._last_look_s = unread, -math.inf
        self.be_restless()

    def be_restless(self) -> None:
        """Take the mount for moving, for a while."""
        self._restless_until_s = asyncio.get_running_loop().time() + _RESTLESS_S

    def doubt(self) -> None:
        """Have the next reading confirmed by another."""
        self._doubted = True

    async def readout(self, *, homed: bool) -> Readout:
        """Have the driver send the place again, and what it claims of the rest.

        Parameters
        ----------
        homed : bool
            Whether homing was the last order to move.

        Raises
        ------
        DeviceSilent
            If the driver doesn't answer, says that it can't read the mount, or has not read it yet.
        DeviceGarbled
            If the place makes no sense.
        """
        name, get = COORDINATES[self.epoch], self._device.get
        loop = asyncio.get_running_loop()
        until_s = loop.time() + _NONSENSE_S
        while True:
            await self._next_look(name)
            before = utc_now()
            now = await self._device.told(name)
            if now.state is State.ALERT:
                now = await self._without_alert(name)
            utc = before + (utc_now() - before) / 2
            self._last_look_s = loop.time()
            place = state.place(now, self.epoch, utc)
            if place is not None:
                break
            # nonsense is never passed on, but it may pass
            self._doubted = True
            self.be_restless()
            if loop.time() > until_s:
                raise DeviceGarbled(
                    f"right ascension {now.number('RA')} h, declination {now.number('DEC')}° are no place",
                    device=self._device.address,
                    advice="see what its driver says",
                )
        doubted, self._doubted = self._doubted, False
        slewing = state.slewing(now, get)
        if slewing:
            self.be_restless()
        return Readout(
            place,
            utc,
            span_s=self.poll_s if slewing else 0.0,
            slewing=slewing,
            tracking=state.tracking(get),
            parked=state.parked(get),
            at_home=state.at_home(get, homed),
            pier_side=state.pier_side(get),
            # Celestron's driver says zeros when an answer was spoiled
            doubtful=doubted or not state.is_real(now),
        )

    async def _next_look(self, name: str) -> None:
        if self._unread:
            await self._first_look(name)
            return
        loop = asyncio.get_running_loop()
        left_s = self._last_look_s + 1.2 * self.poll_s - loop.time()
        if loop.time() > self._restless_until_s or left_s <= 0.0:
            return
        last_s = self._last_look_s

        def newer() -> bool:
            now = self._device.get(name)
            return now is None or (now.pushed is not None and now.told_s > last_s)

        await self._device.client.until(newer, left_s)

    async def _first_look(self, name: str) -> None:
        """Wait until a driver that has just been connected has read its mount: it defines places before."""

        def read() -> bool:
            now = self._device.get(name)
            return now is None or (now.pushed is not None and state.is_real(now))

        if not await self._device.client.until(read, 3.0 * self.poll_s + 1.0):
            now = self._device.get(name)
            if not state.is_real(now):
                raise DeviceSilent("its driver has not read the mount yet", device=self._device.address)
        self._unread = False

    async def _without_alert(self, name: str) -> Property:
        """Alert is also what a refused order leaves behind until the next look: what stays is trouble."""
        count = self._device.client.properties.count

        def gone() -> bool:
            now = self._device.get(name)
            return now is None or now.state is not State.ALERT

        changed = await self._device.client.until(gone, 1.5 * self.poll_s + 0.2)
        now = self._device.get(name)
        if not changed or now is None:
            words = "; ".join(map(plain, self._device.words_since(count)[-3:]))
            raise DeviceSilent(
                f"its driver says that it can't read the mount{': ' if words else ''}{words}",
                device=self._device.address,
                advice="check cable and power between the driver and the mount",
            )
        return now
