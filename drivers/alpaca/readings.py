"""Readings of a telescope: its state in one question where it can, and the failure of a motion kept.

A motion that fails on its way is reported in one place only: the next question for Slewing raises [Alpaca
§5]. Any question for it may get that answer, and none after it may; so it is kept for the one that follows
the motion.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from drivers.alpaca.client import understood
from drivers.alpaca.codec import base, state
from drivers.alpaca.codec.base import AlpacaRefused, Malformed
from drivers.alpaca.device import AlpacaDevice
from drivers.generic.language import Readout
from mountnav.clock import utc_now
from mountnav.devices import Epoch
from mountnav.errors import DeviceSilent
from mountnav.tasks import both, together

_STATES = ("tracking", "atpark", "athome", "sideofpier")
_NEEDED = ("rightascension", "declination")
_TELLS_STATE = 4
"""From this version of the interface on it has DeviceState [Alpaca §4]."""


class MountReader:
    """Makes the readouts of one telescope."""

    def __init__(self, device: AlpacaDevice) -> None:
        self._device = device
        self.epoch: Epoch = "apparent"
        self.implemented: frozenset[str] = frozenset()
        """Members that can be read at all."""
        self._by_state = False
        self._orders = 0
        self._failed = ""

    async def begin(self, version: int, members: tuple[str, ...]) -> None:
        """See which members can be read: the device is up again."""
        self._failed, self._orders = "", self._orders + 1
        asked = [*_STATES, "slewing", *members]
        if version >= _TELLS_STATE:
            asked.append("devicestate")
        found = await together(*(self._device.has(member) for member in asked))
        there = {member for member, has in zip(asked, found, strict=True) if has}
        self.implemented = frozenset(there - {"devicestate"})
        self._by_state = "devicestate" in there

    def ordered(self) -> int:
        """An order to move goes out: what failed before it is over. Gives its number."""
        self._failed, self._orders = "", self._orders + 1
        return self._orders

    def fail(self, order: int, words: str) -> None:
        """Take note that an order to move has failed, unless a later one went out."""
        if order == self._orders and not self._failed:
            self._failed = words
            self._device.client.log.note("event", meaning=f"the motion failed: {words}")

    async def readout(self) -> Readout:
        """Ask where it is and what it does.

        Raises
        ------
        DeviceSilent
            If no answer comes, or its driver can't read the mount.
        DeviceGarbled
            If an answer makes no sense.
        DeviceMissing
            If the server is gone or its driver is not connected.
        """
        # all at once: one after the other, over a slow line, they would be of times that lie seconds apart
        (told, utc, span), slewing = await both(self._placed(), self._slewing())
        try:
            place = state.place(told["rightascension"], told["declination"], self.epoch, utc)
            by_state = state.maybe_truth(told, "slewing")
            return Readout(
                place,
                utc,
                span_s=span.total_seconds(),
                slewing=slewing if by_state is None or slewing is None else slewing or by_state,
                tracking=state.maybe_truth(told, "tracking"),
                parked=state.maybe_truth(told, "atpark"),
                at_home=state.maybe_truth(told, "athome"),
                pier_side=state.pier_side(told.get("sideofpier")),
                failed=self._failed,
            )
        except Malformed as fault:
            raise understood("state", fault, self._device.address) from fault

    async def _placed(self) -> tuple[dict[str, Any], datetime, timedelta]:
        """Place and state, when (the middle between question and answer), and how long that took."""
        told: dict[str, Any] = {}
        before = utc_now()
        if self._by_state:
            told = await self._state()
        missing = [member for member in _NEEDED if told.get(member) is None]
        if missing:
            before = utc_now()
        answered = before

        async def read(member: str) -> object:
            nonlocal answered
            value = await self._read(member)
            answered = max(answered, utc_now())
            return value

        rest = () if self._by_state else _STATES
        values = await together(*map(read, missing), *map(self._maybe, rest))
        span = (answered if missing else utc_now()) - before
        told |= dict(zip((*missing, *rest), values, strict=True))
        return told, before + span / 2, span

    async def _slewing(self) -> bool | None:
        if "slewing" not in self.implemented:
            return None
        order = self._orders
        try:
            return await self._device.value("slewing", base.truth)
        except AlpacaRefused as refused:
            self.fail(order, refused.words or refused.what)
            return None

    async def _state(self) -> dict[str, Any]:
        if not self._by_state:
            return {}
        try:
            return await self._device.value("devicestate", base.named_values)
        except AlpacaRefused as refused:
            raise self._unread(refused) from refused

    async def _read(self, member: str) -> object:
        try:
            return await self._device.client.get(member)
        except AlpacaRefused as refused:
            raise self._unread(refused) from refused

    async def _maybe(self, member: str) -> object:
        if member not in self.implemented:
            return None
        try:
            return await self._device.client.get(member)
        except AlpacaRefused:
            # it has it, and can't say just now
            return None

    def _unread(self, refused: AlpacaRefused) -> DeviceSilent:
        return DeviceSilent(
            f"its driver can't read the mount: {refused.words or refused.what}",
            device=self._device.address,
            advice="see whether the mount is on and its cable is in",
        )
