"""Answers over INDI carry no number: an order's echo tells whose they are, and no question is for ever."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise

import pytest

from drivers.indi import client
from drivers.indi.client import IndiClient
from drivers.indi.codec.messages import State
from drivers.indi.codec.xml_stream import Element, ElementStream
from drivers.indi.device import IndiDevice
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceRefused, DeviceSilent

Reply = Callable[["Wire", Element], None]
KEYS = ("TRACK", "SYNC")


def told(on: str, *, tag: str = "def", state: str = "Ok") -> bytes:
    """ON_COORD_SET as a driver defines or sets it."""
    kind = "def" if tag == "def" else "one"
    values = {key: "On" if key == on else "Off" for key in KEYS}
    inside = "".join(f"<{kind}Switch name='{key}'>{value}</{kind}Switch>" for key, value in values.items())
    attributes = f"device='east' name='ON_COORD_SET' state='{state}'"
    return f"<{tag}SwitchVector {attributes}>{inside}</{tag}SwitchVector>".encode()


def ordered(element: Element) -> str | None:
    """Which switch an order turns on."""
    if element.tag != "newSwitchVector":
        return None
    return next(one.attributes["name"] for one in element.children if one.text.strip() == b"On")


class Wire:
    """A server whose driver answers as the test says."""

    def __init__(self, reply: Reply) -> None:
        self.heard: list[Element] = []
        self.on = "TRACK"
        self._reply = reply
        self._writer: asyncio.StreamWriter | None = None

    def tell(self, message: bytes) -> None:
        assert self._writer is not None
        self._writer.write(message)

    def whole_questions(self) -> int:
        return sum(one.tag == "getProperties" and "name" not in one.attributes for one in self.heard)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        stream = ElementStream()
        while data := await reader.read(65536):
            for element in stream.feed(data):
                assert isinstance(element, Element)
                self.heard.append(element)
                self._reply(self, element)
        writer.close()


@asynccontextmanager
async def device_of(reply: Reply, deadline_s: float = 20.0) -> AsyncIterator[tuple[Wire, IndiDevice]]:
    wire = Wire(reply)
    server = await asyncio.start_server(wire.serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    device = IndiDevice(IndiClient("127.0.0.1", port, "east", log=WireLog()), "east", deadline_s=deadline_s)
    await device.client.open()
    try:
        assert await device.client.until(lambda: device.get("ON_COORD_SET") is not None, 20.0)
        yield wire, device
    finally:
        await device.client.close()
        server.close()
        await server.wait_closed()


def honest(wire: Wire, element: Element) -> None:
    """As INDI's base classes do."""
    if (on := ordered(element)) is not None:
        wire.on = on
        wire.tell(told(on, tag="set"))
    elif element.tag == "getProperties":
        wire.tell(told(wire.on))


async def test_an_answer_to_somebody_elses_question_is_not_that_to_an_order() -> None:
    def crowded(wire: Wire, element: Element) -> None:
        if ordered(element) is not None:
            # the server hands everybody what another program asked for just before; the driver is slow
            wire.tell(told(wire.on))
        wait_s = 0.0 if element.tag == "getProperties" and "name" not in element.attributes else 0.2
        asyncio.get_running_loop().call_later(wait_s, honest, wire, element)

    async with device_of(crowded) as (_, device):
        switch = await device.set_switches("ON_COORD_SET", {"TRACK": False, "SYNC": True})
        assert switch.on("SYNC") is True


async def test_an_answer_that_comes_too_late_is_not_that_to_the_next_order() -> None:
    held: list[Element] = []
    busy = True

    def waiting(wire: Wire, element: Element) -> None:
        if not busy:
            honest(wire, element)
        else:
            if element.tag == "getProperties" and "name" not in element.attributes:
                honest(wire, element)
            held.append(element)

    async with device_of(waiting, deadline_s=0.2) as (wire, device):
        with pytest.raises(DeviceSilent):
            await device.told("ON_COORD_SET")
        device.deadline_s = 20.0
        turning = asyncio.create_task(device.set_switches("ON_COORD_SET", {"TRACK": False, "SYNC": True}))
        async with asyncio.timeout(20.0):
            while not any(ordered(one) for one in held):
                await asyncio.sleep(0.01)
        # it has its mount again, and takes up one after the other: first the question of before
        first = next(one for one in held if one.attributes.get("name") == "ON_COORD_SET")
        honest(wire, first)
        seen = device.get("ON_COORD_SET")
        assert await device.client.until(lambda: device.get("ON_COORD_SET") is not seen, 20.0)
        busy = False
        for element in held[held.index(first) + 1 :]:
            honest(wire, element)
        assert (await turning).on("SYNC") is True


async def test_a_driver_that_echoes_nothing_is_believed_after_a_second_question() -> None:
    def mute(wire: Wire, element: Element) -> None:
        if (on := ordered(element)) is not None:
            wire.on = on
        elif element.tag == "getProperties":
            wire.tell(told(wire.on))

    async with device_of(mute) as (wire, device):
        await device.set_switches("ON_COORD_SET", {"TRACK": False, "SYNC": True})
        assert sum(one.attributes.get("name") == "ON_COORD_SET" for one in wire.heard) == 3


async def test_a_switch_that_is_refused_is_told_at_once() -> None:
    def refusing(wire: Wire, element: Element) -> None:
        if ordered(element) is not None:
            wire.tell(told("TRACK", tag="set", state="Alert"))
        elif element.tag == "getProperties":
            wire.tell(told("TRACK", state="Alert"))

    async with device_of(refusing) as (wire, device):
        with pytest.raises(DeviceRefused):
            await device.set_switches("ON_COORD_SET", {"TRACK": False, "SYNC": True})
        # one question was enough
        assert sum(one.tag == "getProperties" and "name" in one.attributes for one in wire.heard) == 1


async def test_a_property_of_no_device_is_passed_over() -> None:
    """indi_lx200_OnStep 1.9.9 defines one with each answer; it was asked without end."""

    def nameless(wire: Wire, element: Element) -> None:
        wire.tell(b"<defNumberVector device='' name='' state='Idle' perm='ro'/>")
        honest(wire, element)

    async with device_of(nameless) as (wire, device):
        for _ in range(20):
            await device.told("ON_COORD_SET")
        assert wire.whole_questions() == 1
        assert device.client.troubles == 0


async def test_a_driver_whose_every_answer_is_broken_is_not_asked_without_end() -> None:
    broken = b"<defNumberVector device='east' name='X' state='Bad'/>"

    def breaking(wire: Wire, element: Element) -> None:
        wire.tell(broken)
        honest(wire, element)

    async with device_of(breaking) as (wire, device):
        for _ in range(50):
            await device.told("ON_COORD_SET")
        # when it was opened, and once since: the wait before the next grows
        assert 2 <= wire.whole_questions() <= 4


def test_the_waits_for_the_next_retelling_grow_and_end() -> None:
    retelling = client._Retelling()
    asked = []
    for tenth in range(3000):
        retelling.want()
        if retelling.due(tenth / 10):
            asked.append(tenth / 10)
    waits = [b - a for a, b in pairwise(asked)]
    assert waits[:7] == pytest.approx([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0], abs=0.11)
    # much later it is another matter
    retelling.want()
    assert retelling.due(1e6)
    retelling.want()
    assert not retelling.due(1e6 + 0.9)
    assert retelling.due(1e6 + 1.0)


async def test_what_was_lost_is_told_anew_though_nothing_comes_any_more() -> None:
    """The second broken message within a second: its turn comes by the clock, not by the next message."""
    tick = 0

    def silent(wire: Wire, element: Element) -> None:
        nonlocal tick
        if element.tag == "getProperties" and "name" not in element.attributes:
            tick += 1
            if tick <= 3:
                wire.tell(told(wire.on) + b"<setSwitchVector device='east' name='ON_COORD_SET' state='?'/>")
            else:
                wire.tell(told("SYNC", state=State.IDLE))

    async with device_of(silent) as (_, device):
        assert await device.client.until(
            lambda: (now := device.get("ON_COORD_SET")) is not None and now.on("SYNC") is True, 30.0
        )
