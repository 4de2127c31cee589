"""One device behind a connection: introduced, connected, and given orders whose effect is seen.

INDI has no answers, so each order is followed by a question, in one write: a driver takes up one message
after the other, and when it reports the property asked for, all that it has to say to the order was heard.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping

from drivers.indi.client import IndiClient
from drivers.indi.codec import messages as orders
from drivers.indi.codec.answers import plain, spoken
from drivers.indi.codec.messages import Changed, Defined, Deleted, Event, State
from drivers.indi.codec.state import Property
from mountnav.errors import DeviceMissing, DeviceRefused, DeviceSilent, Refusal

_INTRODUCTION_S = 2.0
"""How long a driver has to define its CONNECTION property after the server was asked. Chosen by hand; one
that starts with the server needs longer, and is then found at the next try to connect."""
_ECHO_S = 2.0
"""A driver that answers without having echoed the order is asked once more after so long, in seconds, and
believed then: some echo nothing. Real drivers echo within 0.1 s, and while they wait for their mount they
don't answer either. Twice as long makes each order to a driver without echoes slower by 2 s."""


class IndiDevice:
    """A device on an open or closed connection.

    Parameters
    ----------
    name : str
        Of the device, as the server has it.
    deadline_s : float
        For the effect of an order to show.
    connect_s : float
        For its driver to connect to the hardware.
    """

    def __init__(
        self, client: IndiClient, name: str, *, deadline_s: float = 8.0, connect_s: float = 30.0
    ) -> None:
        self.client = client
        self.name = name
        self.deadline_s = deadline_s
        self._connect_s = connect_s
        self._turn = asyncio.Lock()
        self._heard: list[Event] | None = None
        self._asked_s: float | None = None
        self._overdue: Counter[str] = Counter()
        self._gone: str | None = None
        self._was_connected = False
        client.listen(self._on_event)

    @property
    def address(self) -> str:
        """Server and name, for messages."""
        return f"{self.client.address}/{self.name}"

    @property
    def usable(self) -> bool:
        """Whether the connection is up, and the device on it connected since it was brought up."""
        return self.client.usable and self._gone is None

    def unanswered_s(self) -> float:
        """Since when the present question waits; 0 when there is none."""
        return 0.0 if self._asked_s is None else asyncio.get_running_loop().time() - self._asked_s

    async def lost(self) -> str:
        """Wait until the connection or the device on it is lost, and return why."""
        try:
            while self.usable:
                await self.client.until(lambda: self._gone is not None, 3600.0)
        except DeviceMissing:
            return await self.client.lost()
        return self._gone or await self.client.lost()

    def get(self, name: str) -> Property | None:
        """One of its properties, or None."""
        return self.client.properties.get(self.name, name)

    def words_since(self, count: int) -> list[str]:
        """What its driver said after so many messages."""
        return self.client.said_since(count, self.name)

    @property
    def driver(self) -> str:
        """Program and version of its driver, as it says."""
        info = self.get("DRIVER_INFO")
        told = () if info is None else (info.text("DRIVER_EXEC"), info.text("DRIVER_VERSION"))
        return " ".join(filter(None, told)) or "unknown driver"

    # -- bringing it up --------------------------------------------------------------------------

    async def bring_up(self, *, may_connect: bool, needed: tuple[str, ...]) -> bool:
        """Connect to the server, find the device, and have its driver connect unless it is.

        Parameters
        ----------
        may_connect : bool
            Whether a device that is not connected may be ordered to.
        needed : tuple of str
            It is up when one of these properties is there.

        Returns
        -------
        bool
            Whether it had to be connected.

        Raises
        ------
        DeviceMissing
            If there is no server, no such device, or it can't be connected.
        DeviceRefused
            If it is not connected and may not be.
        DeviceSilent
            If its driver doesn't answer.
        """
        self._gone, self._heard, self._asked_s = None, None, None
        self._overdue.clear()
        self._was_connected = False
        client = self.client
        await client.open()
        if not await client.until(lambda: self.get("CONNECTION") is not None, _INTRODUCTION_S):
            raise await self._unknown()
        ours = await self._connect(may_connect)
        if not await client.until(lambda: any(self.get(name) for name in needed), self.deadline_s):
            raise DeviceRefused(
                f"has none of the properties {', '.join(needed)}",
                device=self.address,
                advice="is it the right device?",
                reason=Refusal.UNSUPPORTED,
            )
        # definitions come in one go: when this is sent again, all of them are there
        await self.told("CONNECTION")
        return ours

    async def _connect(self, may_connect: bool) -> bool:
        connection = self.get("CONNECTION")
        if connection is not None and connection.on("CONNECT") and connection.state is not State.BUSY:
            return False
        if not may_connect:
            raise DeviceRefused(
                "it is not connected, and the configuration leaves that to others",
                device=self.address,
                advice="connect it in its own program, or allow it with connect=yes",
            )
        count = self.client.properties.count
        self.client.send(orders.new_switches(self.name, "CONNECTION", {"CONNECT": True, "DISCONNECT": False}))

        def answered() -> bool:
            now = self.get("CONNECTION")
            return now is not None and now.count > count and now.state is not State.BUSY

        def settled() -> bool:
            # a definition that was on its way before our order says "not connected" and is no answer to it
            now = self.get("CONNECTION")
            return answered() and now is not None and (now.on("CONNECT") is True or now.state is State.ALERT)

        if not await self.client.until(settled, self._connect_s) and not answered():
            raise DeviceSilent(
                f"not connected after {self._connect_s:.0f} s",
                device=self.address,
                advice="see what its driver says of its port",
            )
        now = self.get("CONNECTION")
        if now is None or not now.on("CONNECT"):
            words = "; ".join(map(plain, self.words_since(count))) or "it doesn't say why"
            raise DeviceMissing(
                f"its driver can't connect: {words}", device=self.address, advice="check port and power"
            )
        return True

    async def _unknown(self) -> DeviceMissing:
        there = ", ".join(await self.client.devices_there()) or "none"
        return DeviceMissing(
            f"the server has no device {self.name!r}", device=self.client.address, advice=f"it has: {there}"
        )

    # -- orders ----------------------------------------------------------------------------------

    async def told(self, name: str, *, deadline_s: float | None = None) -> Property:
        """Have its driver send a property again.

        Raises
        ------
        DeviceSilent
            If it doesn't in time.
        DeviceMissing
            If the property, the device or the connection is gone.
        """
        await self.ordered(asking=name, deadline_s=deadline_s)
        now = self.get(name)
        if now is None:
            raise DeviceMissing(f"has no {name} any more", device=self.address, advice="connect again")
        return now

    async def ordered(
        self, *messages: bytes, asking: str, echo: str = "", deadline_s: float | None = None
    ) -> list[Event]:
        """Send orders, then a question for a property, in one write; return all that came until its answer.

        Parameters
        ----------
        asking : str
            A property that the device has.
        echo : str
            The property that its driver sets, be it to what it was, when it has taken up the orders: an
            answer that comes before belongs to another question. Empty if any answer will do.
        deadline_s : float, optional
            Instead of its own.

        Raises
        ------
        DeviceSilent
            If no answer came in time; the orders may have been carried out.
        DeviceMissing
            If there is no such property, or the connection is lost.
        """
        async with self._turn:
            return await self._ordered(messages, asking, echo, deadline_s or self.deadline_s)

    async def _ordered(
        self, messages: tuple[bytes, ...], asking: str, echo: str, deadline_s: float
    ) -> list[Event]:
        if self.usable and self.get(asking) is None:
            raise DeviceMissing(f"has no {asking}", device=self.address, advice="is it still connected?")
        heard: list[Event] = []
        self._heard, self._asked_s = heard, asyncio.get_running_loop().time()
        try:
            self.client.send(*messages, orders.get_properties(self.name, asking))
            in_time = await self._answered(_Answer(heard, asking, echo), deadline_s)
        finally:
            self._heard = self._asked_s = None
        if self._gone is not None:
            raise DeviceMissing(self._gone, device=self.address, advice="connect again")
        if not in_time:
            self._overdue[asking] += 1
            raise DeviceSilent(
                f"its driver said nothing to {'an order' if messages else 'a question'} for {asking} "
                f"within {deadline_s:.1f} s",
                device=self.address,
                advice="is the driver waiting for its hardware?",
            )
        return heard

    async def _answered(self, answer: _Answer, deadline_s: float) -> bool:
        """Wait for an answer, and return whether it came in time."""
        loop, until = asyncio.get_running_loop(), self.client.until
        deadline_at_s = loop.time() + deadline_s

        def left_s() -> float:
            return max(0.0, deadline_at_s - loop.time())

        # while older answers are owed, any of them could be taken for this one: then the echo alone counts
        if answer.echo and not self._overdue.total():
            if not await until(lambda: self._gone is not None or answer.came() or answer.told, left_s()):
                return False
            if await until(lambda: self._gone is not None or answer.came(), min(_ECHO_S, left_s())):
                return True
            self.client.send(orders.get_properties(self.name, answer.asking))
            answer.take_any()
        return await until(lambda: self._gone is not None or answer.came(), left_s())

    async def set_switches(self, name: str, values: Mapping[str, bool]) -> Property:
        """Set switches, and see them set.

        Raises
        ------
        DeviceRefused
            If its driver says no, or they stay as they were.
        DeviceSilent, DeviceMissing
            As of `ordered`.
        """
        heard = await self.ordered(orders.new_switches(self.name, name, values), asking=name, echo=name)
        now = self.get(name)
        if (
            now is None
            or now.state is State.ALERT
            or any(now.on(key) is not on for key, on in values.items())
        ):
            raise DeviceRefused(
                f"{name} is not as ordered: {spoken(heard) or 'its driver does not say why'}",
                device=self.address,
            )
        return now

    def _on_event(self, event: Event, now: Property | None) -> None:
        if getattr(event, "device", "") != self.name:
            return
        if isinstance(event, Defined) and self._overdue[event.name] > 0:
            self._overdue[event.name] -= 1
        if self._heard is not None:
            self._heard.append(event)
        if isinstance(event, Deleted) and event.name in ("", "CONNECTION"):
            self._gone = "its driver is gone"
        elif (
            # a driver that was started again defines it again
            isinstance(event, Changed | Defined)
            and event.name == "CONNECTION"
            and now is not None
            and now.on("CONNECT") is False
            and now.state is not State.BUSY
            and self._was_connected
        ):
            self._gone = "its driver was disconnected from it"
        if now is not None and now.name == "CONNECTION":
            self._was_connected = now.on("CONNECT") is True


class _Answer:
    """Whether the answer to a question is among what was heard.

    Parameters
    ----------
    heard : list of Event
        Grows while it is waited for.
    asking, echo : str
        See `IndiDevice.ordered`.
    """

    def __init__(self, heard: list[Event], asking: str, echo: str) -> None:
        self.asking = asking
        self.echo = echo
        self.told = False
        """Whether the property was sent since, be it to us or to others."""
        self._heard = heard
        self._seen = 0
        self._echoed = not echo
        self._came = False

    def take_any(self) -> None:
        """Be content from now on with an answer before which there was no echo."""
        self._echoed = True

    def came(self) -> bool:
        """Look at what was heard since the last look: a driver may say thousands of things meanwhile."""
        fresh, self._seen = self._heard[self._seen :], len(self._heard)
        for event in fresh:
            if isinstance(event, Changed) and event.name == self.echo:
                self._echoed = True
            elif isinstance(event, Defined) and event.name == self.asking:
                self.told = True
                self._came = self._came or self._echoed
        return self._came
