"""Rates of a mount behind INDI: tracking at rates of one's own, and axes moved by buttons.

A rate that is written while the mode is another one is only kept for later; some drivers send it to their
mount when the mode becomes custom, some only when it is written in that mode. So it is written before and
after. A driver that refuses goes on saying what it was told: that is taken back.

Which way a button moves an axis is what the driver believes of its mount; it is seen in the readings once.
"""

from __future__ import annotations

import contextlib

from drivers.generic.language import Sent, Wanted
from drivers.indi.codec import messages, rates, state
from drivers.indi.codec.answers import refusal, was_refused
from drivers.indi.device import IndiDevice
from drivers.indi.readings import MountReader
from mountnav.devices import STARS_RATES, MountAxis, OffsetRates, PierSide
from mountnav.errors import DeviceError, DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent, Refusal


class RateOrders:
    """Orders offset rates of one device."""

    def __init__(self, device: IndiDevice) -> None:
        self._device = device

    async def order(self, wanted: OffsetRates) -> None:
        """Track at rates beside the sidereal one, or as for a star.

        Raises
        ------
        DeviceRefused, DeviceSilent, DeviceMissing
        """
        if wanted.none:
            await self._mode(rates.SIDEREAL)
            # whoever turns to custom next finds a star's rate
            await self._write(rates.said(STARS_RATES))
            return
        said, was_custom = rates.said(wanted), self._custom()
        before = rates.told(self._device.get(rates.RATE))
        try:
            if was_custom and rates.reverses(self._device.get(rates.RATE), said):
                await self._mode(rates.SIDEREAL)
            if not self._custom():
                await self._write(said)
                await self._mode(rates.CUSTOM)
            await self._write(said)
        except DeviceRefused:
            await self._take_back(before if was_custom else None)
            raise

    async def _take_back(self, before: OffsetRates | None) -> None:
        """Say again what it was told before: after a refusal its driver goes on saying the new."""
        with contextlib.suppress(DeviceError):
            await self._mode(rates.SIDEREAL)
            await self._write(rates.said(before or STARS_RATES))
            if before is not None:
                await self._mode(rates.CUSTOM)
                await self._write(rates.said(before))

    def _custom(self) -> bool:
        mode = self._device.get(rates.MODE)
        return mode is not None and mode.on(rates.CUSTOM) is True

    async def _mode(self, on: str) -> None:
        mode = self._device.get(rates.MODE)
        if mode is not None and mode.on(on) is not True:
            await self._device.set_switches(rates.MODE, {key: key == on for key in mode.values})

    async def _write(self, said: dict[str, float]) -> None:
        device = self._device
        order = messages.new_numbers(device.name, rates.RATE, said)
        heard = await device.ordered(order, asking=rates.RATE, echo=rates.RATE)
        if was_refused(rates.RATE, heard):
            raise refusal("the offset rates", heard, device.address)

    async def read(self) -> OffsetRates | None:
        """What its driver says it was told; None in a mode that is neither a star's nor custom.

        Raises
        ------
        DeviceSilent, DeviceMissing, DeviceGarbled
        """
        device = self._device
        mode = await device.told(rates.MODE)
        if mode.on(rates.SIDEREAL):
            return STARS_RATES
        if not mode.on(rates.CUSTOM):
            return None
        told = rates.told(await device.told(rates.RATE))
        if told is None:
            raise DeviceGarbled("its track rates are not numbers", device=device.address)
        return told


class AxisOrders:
    """Moves the axes of one device by its buttons; one speed is selected for both.

    Parameters
    ----------
    reader : MountReader
        Of the same device.
    """

    def __init__(self, device: IndiDevice, reader: MountReader) -> None:
        self._device = device
        self._reader = reader
        self._moved: dict[MountAxis, float] = {}
        self._turned: dict[tuple[MountAxis, PierSide | None], bool] = {}
        """Which axes were seen to go the other way than their buttons say, by the side of the pier."""
        self.speeds_deg_s: tuple[float, ...] = ()
        """By the switches of TELESCOPE_SLEW_RATE; empty where they aren't known."""

    @property
    def speeds(self) -> dict[str, float]:
        """By the names of the switches."""
        return rates.speeds(self._device.get, self.speeds_deg_s)

    def unsure(self, axis: MountAxis) -> bool:
        """Whether nobody has seen yet which way this axis goes."""
        return (axis, self._side()) not in self._turned

    def seen(self, axis: MountAxis, *, rightly: bool) -> None:
        """It was seen to move as ordered, or the other way."""
        self._turned[axis, self._side()] = self._is_turned(axis) is rightly

    def _is_turned(self, axis: MountAxis) -> bool:
        return self._turned.get((axis, self._side()), False)

    def _side(self) -> PierSide | None:
        return state.pier_side(self._device.get)

    def stopped(self) -> None:
        """A stop has ended all of it."""
        self._moved.clear()

    async def order(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Hold a button, or let it go. Raises `DeviceRefused`, `DeviceMissing`."""
        device = self._device
        name, upwards, downwards = rates.MOTIONS[axis]
        if device.get(name) is None:
            raise DeviceRefused(
                "has no buttons to move by", device=device.address, reason=Refusal.UNSUPPORTED
            )
        if rate_deg_s:
            await self._select(axis, abs(rate_deg_s))
        if not wanted():
            return Sent(wire=False)
        if rate_deg_s:
            self._moved[axis] = abs(rate_deg_s)
        else:
            self._moved.pop(axis, None)
        self._reader.be_restless()
        if self._is_turned(axis):
            upwards, downwards = downwards, upwards
        switches = {upwards: rate_deg_s > 0.0, downwards: rate_deg_s < 0.0}
        order = messages.new_switches(device.name, name, switches)
        try:
            heard = await device.ordered(order, asking=name, echo=name)
        except (DeviceSilent, DeviceMissing) as failure:
            return Sent(lost=failure)
        if was_refused(name, heard):
            raise refusal("moving an axis" if rate_deg_s else "ending a motion", heard, device.address)
        return Sent()

    async def _select(self, axis: MountAxis, speed_deg_s: float) -> None:
        device, speeds = self._device, self.speeds
        other = {one: speed for one, speed in self._moved.items() if one != axis}
        if any(speed != speed_deg_s for speed in other.values()):
            raise DeviceRefused(
                "can't move its axes at two speeds at once",
                device=device.address,
                advice="end the other motion, or take its speed",
                reason=Refusal.BUSY,
            )
        name = min(speeds, key=lambda one: abs(speeds[one] - speed_deg_s))
        rate = device.get(rates.SPEEDS)
        if rate is not None and rate.on(name) is not True:
            await device.set_switches(rates.SPEEDS, {key: key == name for key in rate.values})
