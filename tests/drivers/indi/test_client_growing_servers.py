"""INDI servers that define and set without end: the client's memory is bounded, and the reason is told."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from datetime import UTC, datetime

import pytest

from drivers.indi.client import IndiClient
from drivers.indi.codec.messages import Reader
from drivers.indi.codec.state import Properties
from drivers.wire.wire_log import WireLog

UTC_0 = datetime(2026, 11, 23, tzinfo=UTC)


def defined(name: str, *elements: tuple[str, str], device: str = "east") -> bytes:
    inside = "".join(f"<defText name='{one}'>{text}</defText>" for one, text in elements)
    return f"<defTextVector device='{device}' name='{name}' state='Ok'>{inside}</defTextVector>".encode()


def set_to(name: str, *elements: tuple[str, str]) -> bytes:
    inside = "".join(f"<oneText name='{one}'>{text}</oneText>" for one, text in elements)
    return f"<setTextVector device='east' name='{name}'>{inside}</setTextVector>".encode()


def taken(properties: Properties, *messages: bytes) -> None:
    for event in Reader().feed(b"".join(messages)):
        properties.take(event, UTC_0, 0.0)


def test_elements_that_were_never_defined_are_passed_over() -> None:
    properties = Properties()
    taken(properties, defined("A", ("a", "1")))
    for number in range(50):
        taken(properties, set_to("A", ("a", f"{number}"), *((f"x{number}-{one}", "x") for one in range(100))))
    one = properties.get("east", "A")
    assert one is not None
    assert one.values == {"a": "49"}


def test_what_properties_take_is_counted_as_they_come_change_and_go() -> None:
    properties = Properties()
    taken(properties, defined("A", ("a", "1" * 1000)), defined("B", ("b", "1")))
    both = properties.size_bytes
    assert 1000 < both < 3000
    taken(properties, set_to("A", ("a", "1" * 500)))
    assert properties.size_bytes == both - 500
    taken(properties, defined("A", ("a", "1" * 1000)))
    assert (properties.size_bytes, len(properties)) == (both, 2)
    taken(properties, b"<delProperty device='east' name='A'/><delProperty device='east' name='C'/>")
    assert (len(properties), list(properties.of("east"))) == (1, ["B"])
    taken(properties, b"<delProperty device='west'/><delProperty device='east'/>")
    assert (len(properties), properties.size_bytes, properties.devices()) == (0, 0, [])


GROWING: dict[str, tuple[Callable[[int], bytes], str]] = {
    "properties": (lambda number: defined(f"P{number}"), "more than 5000 properties"),
    "devices": (lambda number: defined("P", device=f"d{number}"), "more than 5000 properties"),
    "long texts": (lambda number: defined(f"P{number}", ("a", "x" * 500_000)), "more than 16 MB"),
    "elements": (
        lambda number: defined(f"P{number}", *((f"{one}", "") for one in range(1900))),
        "more than 16 MB",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", GROWING)
async def test_a_server_that_would_have_us_grow_is_lost_and_read_no_more(kind: str) -> None:
    made, why = GROWING[kind]

    hung_up = asyncio.Event()

    async def grow(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        number = 0
        # it doesn't end by itself
        while not writer.transport.is_closing():
            writer.write(made(number) + b"<pingRequest uid='1'/>")
            number += 1
            try:
                await writer.drain()
            except OSError:
                break
        hung_up.set()
        writer.close()

    server = await asyncio.start_server(grow, "127.0.0.1", 0, family=socket.AF_INET)
    async with server:
        client = IndiClient("127.0.0.1", server.sockets[0].getsockname()[1], log=WireLog(kept=10))
        await client.open()
        async with asyncio.timeout(60):
            told = await client.lost()
        assert why in told
        reading = next(task for task in client._tasks if task.get_name() == "indi-hear")
        async with asyncio.timeout(60):
            # not by a fault: a ping that comes after the loss isn't answered
            await reading
        assert len(client.properties) == 0
        await client.close()
        await hung_up.wait()
