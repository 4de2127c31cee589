"""One device of an Alpaca server: found, identified, and connected to its hardware unless it is."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from drivers.alpaca.client import AlpacaClient, require_known, understood
from drivers.alpaca.codec import base
from drivers.alpaca.codec.base import NOT_CONNECTED, AlpacaRefused, Malformed, Parameters
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent
from mountnav.tasks import together

T = TypeVar("T")
_CONNECTS_ASYNC = 4
"""From this version on an interface has Connect and Connecting [Alpaca §4]."""
_GLANCE_S = 0.2
"""Pause between questions whether it has connected. Chosen by hand."""
_NEWEST = 100
"""Interface versions above this are refused as nonsense; there were 4 in 2026. Chosen by hand."""


@dataclass(frozen=True, slots=True)
class Found:
    """What bringing a device up found.

    Attributes
    ----------
    name : str
        What it calls itself.
    driver : str
        Its driver and that one's version, in words.
    version : int
        Of the interface.
    connected_by_us : bool
        Whether it had to be connected.
    """

    name: str
    driver: str
    version: int
    connected_by_us: bool


class AlpacaDevice:
    """A device on a server; what it is asked and ordered beyond its connection is its users' business.

    Parameters
    ----------
    connect_s : float
        For its driver to connect to the hardware.
    """

    def __init__(self, client: AlpacaClient, *, connect_s: float = 30.0) -> None:
        self.client = client
        self._connect_s = connect_s

    @property
    def address(self) -> str:
        """Server and device, for messages."""
        return self.client.address

    async def bring_up(self, *, may_connect: bool) -> Found:
        """Find the device and have its driver connect unless it is. Moves and sets nothing.

        Parameters
        ----------
        may_connect : bool
            Whether a device that is not connected may be ordered to.

        Raises
        ------
        DeviceMissing
            If there is no server, no such device, or it can't be connected.
        DeviceRefused
            If it is not connected and may not be.
        DeviceSilent, DeviceGarbled
            If its answers don't come or make no sense.
        """
        await self.client.open()
        version = await self._version()
        ours = False
        if not await self.value("connected", base.truth):
            if not may_connect:
                raise DeviceRefused(
                    "it is not connected, and the configuration leaves that to others",
                    device=self.address,
                    advice="connect it in its own program, or allow it with connect=yes",
                )
            await self._connect(version or 1)
            ours = True
        self.client.connected = True
        version = version or await self._version() or 1
        words = await self.asked_all(("name", "driverinfo", "driverversion"), base.text)
        name = words.get("name") or "unnamed"
        told = (words.get("driverinfo"), words.get("driverversion"))
        driver = " ".join(" ".join(filter(None, told)).split()) or "unknown driver"
        return Found(name, driver, version, ours)

    async def _version(self) -> int:
        """Of the interface; 0 where an old driver doesn't say before it is connected."""
        try:
            return await self.value("interfaceversion", lambda value: base.integer(value, 1, _NEWEST))
        except AlpacaRefused as refused:
            if refused.number == NOT_CONNECTED:
                return 0
            if refused.number:
                # members of the first version were not numbered yet
                require_known(refused)
                return 1
            there = ", ".join(await self.client.described()) or "it doesn't say which"
            where = self.client.where
            raise DeviceMissing(
                f"the server has no {where.kind} {where.number} ({refused.words})",
                device=self.address,
                advice=f"it has: {there}",
            ) from refused

    async def _connect(self, version: int) -> None:
        loop = asyncio.get_running_loop()
        until_s = loop.time() + self._connect_s
        try:
            if not (version >= _CONNECTS_ASYNC and await self._told_to_connect()):
                await self.client.put("connected", {"Connected": True}, deadline_s=self._connect_s)
        except AlpacaRefused as refused:
            raise self._not_connecting(refused.words) from refused
        except (DeviceSilent, DeviceGarbled):
            # it may connect all the same: seen below
            self.client.log.note("event", meaning="no good answer to the order to connect")
        while True:
            try:
                busy = version >= _CONNECTS_ASYNC and await self.maybe("connecting", base.truth)
            except AlpacaRefused as refused:
                raise self._not_connecting(refused.words) from refused
            if not busy and await self.value("connected", base.truth):
                return
            if loop.time() > until_s:
                raise self._not_connecting(f"it is not after {self._connect_s:.0f} s")
            await asyncio.sleep(_GLANCE_S)

    async def _told_to_connect(self) -> bool:
        try:
            await self.client.put("connect")
        except AlpacaRefused as refused:
            require_known(refused)
            return False
        return True

    def _not_connecting(self, words: str) -> DeviceMissing:
        return DeviceMissing(
            f"its driver can't connect: {words or 'it does not say why'}",
            device=self.address,
            advice="check port and power of the hardware",
        )

    # -- values ----------------------------------------------------------------------------------

    async def value(
        self, member: str, read: Callable[[object], T], parameters: Parameters | None = None
    ) -> T:
        """Ask for a value and read it. Raises as `Asking.get`, and `DeviceGarbled` if it is none."""
        told = await self.client.get(member, parameters)
        try:
            return read(told)
        except Malformed as fault:
            raise understood(member, fault, self.address) from fault

    async def maybe(
        self, member: str, read: Callable[[object], T], parameters: Parameters | None = None
    ) -> T | None:
        """As `value`; None where the device has no such member."""
        try:
            return await self.value(member, read, parameters)
        except AlpacaRefused as refused:
            require_known(refused)
            return None

    async def asked_all(self, members: Iterable[str], read: Callable[[object], T]) -> dict[str, T]:
        """Ask for several values; those the device has no member for are left out."""
        wanted = list(members)
        told = await together(*(self.maybe(member, read) for member in wanted))
        return {member: value for member, value in zip(wanted, told, strict=True) if value is not None}

    async def has(self, member: str, parameters: Parameters | None = None) -> bool:
        """Whether a member can be read; one that has no value just now counts."""
        try:
            await self.client.get(member, parameters)
        except AlpacaRefused as refused:
            return not refused.unsupported
        return True
