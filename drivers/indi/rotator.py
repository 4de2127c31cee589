"""A rotator behind an `indiserver`, as a language: ABS_ROTATOR_ANGLE of the device, and nothing else is set.

SYNC_ROTATOR_ANGLE would only change what it calls its angle, and is never sent: where north is solves show.
ROTATOR_REVERSE, limits and backlash are the driver's own; whether it counts reversed is read and told.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.generic.rotator import USUAL_STEP_DEG, Told
from drivers.generic.served_device import ServedDevice
from drivers.indi.codec import messages
from drivers.indi.codec.answers import refusal, was_refused
from drivers.indi.codec.messages import State
from drivers.indi.device import IndiDevice
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceRefused, Refusal

ANGLE, ABORT, REVERSE = "ABS_ROTATOR_ANGLE", "ROTATOR_ABORT_MOTION", "ROTATOR_REVERSE"


@dataclass(frozen=True, slots=True, kw_only=True)
class RotatorHabits:
    """What the configuration says of a rotator behind INDI."""

    may_connect: bool = True
    step_deg: float = USUAL_STEP_DEG


class IndiRotatorLanguage(ServedDevice[IndiDevice]):
    """A `drivers.generic.rotator.RotatorLanguage` over one device of an `indiserver`."""

    def __init__(
        self, device: IndiDevice, *, name: str | None = None, habits: RotatorHabits | None = None
    ) -> None:
        super().__init__(device, name=name)
        self._habits = habits or RotatorHabits()

    @property
    def usable(self) -> bool:
        """Whether the connection is up, and the device connected ever since."""
        return self._device.usable

    @property
    def step_deg(self) -> float:
        """Its coarsest step."""
        return self._habits.step_deg

    @property
    def reversed(self) -> bool | None:
        """Whether its driver counts the other way round; None where it doesn't say."""
        switch = self._device.get(REVERSE)
        return None if switch is None else switch.on("INDI_ENABLED")

    async def open(self) -> None:
        """Connect; see `IndiDevice.bring_up`."""
        async with self._or_closed() as device:
            await device.bring_up(may_connect=self._habits.may_connect, needed=(ANGLE,))

    async def read(self) -> Told:
        """Have its driver tell the angle; busy means that it moves."""
        angle = await self._device.told(ANGLE)
        value = angle.number("ANGLE")
        if value is None:
            raise DeviceGarbled(
                f"{ANGLE} has no number ANGLE", device=self._name, advice="is it the right device?"
            )
        return Told(value, angle.state is State.BUSY)

    async def order(self, mechanical_deg: float) -> None:
        """Set the angle; its driver refuses by an alert or loud words."""
        order = messages.new_numbers(self._device.name, ANGLE, {"ANGLE": mechanical_deg})
        heard = await self._device.ordered(order, asking=ANGLE, echo=ANGLE)
        if was_refused(ANGLE, heard):
            raise refusal(f"the turn to {mechanical_deg:.2f}°", heard, self._name)

    async def send_stop(self) -> None:
        """Abort; beside all that waits for an answer."""
        if not self._device.usable:
            raise DeviceMissing("not connected", device=self._name, advice="look at it: it may be turning")
        if self._device.get(ABORT) is None:
            raise DeviceRefused(
                "its driver has no way to stop it", device=self._name, reason=Refusal.UNSUPPORTED
            )
        self._device.client.send(messages.new_switches(self._device.name, ABORT, {"ABORT": True}))
