"""An Alpaca rotator, as a language: IRotatorV2 to V4, by its mechanical angle where it has one.

From IRotatorV3 on MechanicalPosition and MoveMechanical know no sync; older drivers have Position and
MoveAbsolute alone. Sync and Reverse are never sent: where north is solves show.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from drivers.alpaca.client import require_known
from drivers.alpaca.codec import base
from drivers.alpaca.codec.base import AlpacaRefused, Malformed
from drivers.alpaca.device import AlpacaDevice
from drivers.generic.rotator import MOST_DEG, USUAL_STEP_DEG, Told
from drivers.generic.served_device import ServedDevice
from mountnav.errors import DeviceError, DeviceMissing, DeviceRefused, Refusal

_MECHANICAL = 3
"""From this version on the interface knows the mechanism's own angle."""
_COARSEST_DEG = 30.0
"""A larger step is nonsense. Doubled, a damaged number makes turns end anywhere within 90°."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RotatorHabits:
    """What the configuration says of an Alpaca rotator."""

    may_connect: bool = True


class AlpacaRotatorLanguage(ServedDevice[AlpacaDevice]):
    """A `drivers.generic.rotator.RotatorLanguage` over one rotator of an Alpaca server."""

    def __init__(
        self, device: AlpacaDevice, *, name: str | None = None, habits: RotatorHabits | None = None
    ) -> None:
        super().__init__(device, name=name)
        self._habits = habits or RotatorHabits()
        self._open = False
        self._member, self._order = "mechanicalposition", "movemechanical"
        self._step_deg = USUAL_STEP_DEG
        self._reversed: bool | None = None

    @property
    def usable(self) -> bool:
        """Whether its server could be reached, and its driver was connected, whenever it was asked."""
        return self._device.client.usable and self._open

    @property
    def step_deg(self) -> float:
        """Its coarsest step."""
        return self._step_deg

    @property
    def reversed(self) -> bool | None:
        """Whether its driver counts the other way round, by the last reading; None where it doesn't say."""
        return self._reversed

    async def open(self) -> None:
        """Connect, and find out by which angle it is turned."""
        self._open = False
        async with self._or_closed() as device:
            try:
                found = await device.bring_up(may_connect=self._habits.may_connect)
                if found.version >= _MECHANICAL and await device.has("mechanicalposition"):
                    self._member, self._order = "mechanicalposition", "movemechanical"
                else:
                    self._member, self._order = "position", "moveabsolute"
                self._step_deg = await self._step() or USUAL_STEP_DEG
                # one that can't tell its angle is no rotator
                await self._angle()
                self._open = True
            except AlpacaRefused as refused:
                raise DeviceRefused(
                    f"it doesn't give its angle: {refused.words}",
                    device=self._name,
                    advice="is it a rotator?",
                    reason=Refusal.UNSUPPORTED,
                ) from refused

    async def _step(self) -> float | None:
        with suppress(AlpacaRefused, Malformed):
            return base.number(await self._device.client.get("stepsize"), 0.0, _COARSEST_DEG) or None
        return None

    async def _angle(self) -> float:
        return await self._device.value(self._member, lambda value: base.number(value, -MOST_DEG, MOST_DEG))

    async def close(self) -> None:
        """Release the connection; the rotator stays connected, for others."""
        self._open = False
        await super().close()

    async def read(self) -> Told:
        """Ask for the angle, whether it moves, and which way round it counts."""
        device = self._device
        # first whether it moves: an angle read before the end would be taken for the end
        moving = await device.maybe("ismoving", base.truth)
        angle_deg = await self._angle()
        self._reversed = await device.maybe("reverse", base.truth)
        return Told(angle_deg, moving)

    async def order(self, mechanical_deg: float) -> None:
        """Order the turn; the answer comes at once, the turn goes on."""
        await self._device.client.put(self._order, {"Position": mechanical_deg})

    async def send_stop(self) -> None:
        """Halt, past all other orders."""
        if not self._open:
            raise DeviceMissing("not connected", device=self._name, advice="look at it: it may be turning")
        try:
            await self._device.client.put_past_all("halt")
        except AlpacaRefused as refused:
            require_known(refused)
            raise DeviceRefused(
                "its driver has no way to stop it", device=self._name, reason=Refusal.UNSUPPORTED
            ) from refused
        except DeviceError:
            self.log.note("event", meaning="the halt was not answered")
            raise
