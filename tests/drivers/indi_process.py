"""A real INDI driver, run by its standard input and output: the judge of a fake mount."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from xml.etree import ElementTree

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Apparent


class Indi:
    """An INDI driver run by its standard input and output: the latest value of each element."""

    def __init__(self, process: asyncio.subprocess.Process, device: str) -> None:
        self._process = process
        self.device = device
        self.values: dict[tuple[str, str], str] = {}
        self.states: dict[str, str] = {}
        self.said: list[str] = []
        self._news = asyncio.Event()

    async def listen(self) -> None:
        parser: Any = ElementTree.XMLPullParser(["start", "end"])
        parser.feed("<indi>")
        assert self._process.stdout is not None
        depth = 1
        while line := await self._process.stdout.readline():
            # a declaration before each message is no XML
            parser.feed(line.replace(b"<?xml version='1.0'?>", b""))
            for event, element in parser.read_events():
                depth += 1 if event == "start" else -1
                if event == "end" and depth == 2:
                    self._take(element)
            self._news.set()

    def _take(self, vector: ElementTree.Element) -> None:
        name = vector.get("name", "")
        if vector.get("message"):
            self.said.append(vector.get("message", ""))
        if vector.get("state"):
            self.states[name] = vector.get("state", "")
        for element in vector:
            self.values[name, element.get("name", "")] = (element.text or "").strip()

    async def give(self, kind: str, name: str, **elements: str) -> None:
        inside = "".join(f"<one{kind} name='{key}'>{value}</one{kind}>" for key, value in elements.items())
        await self.say(f"<new{kind}Vector device='{self.device}' name='{name}'>{inside}</new{kind}Vector>")

    async def say(self, xml: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(xml.encode())
        await self._process.stdin.drain()

    async def until(self, true: Callable[[], bool], what: str) -> None:
        try:
            async with asyncio.timeout(30.0):
                while not true():
                    self._news.clear()
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(0.1):
                            await self._news.wait()
        except TimeoutError:
            pytest.fail(f"not {what}; the driver said {self.said}")

    def place(self) -> Apparent:
        ra_h, dec_deg = (float(self.values["EQUATORIAL_EOD_COORD", axis]) for axis in ("RA", "DEC"))
        return Apparent(ra_h * 15.0, dec_deg, utc_now())

    async def aim(self, what: str, place: Apparent) -> None:
        await self.give("Switch", "ON_COORD_SET", **{what: "On"})
        ra_h, dec_deg = f"{place.ra_deg / 15.0:.9f}", f"{place.dec_deg:.9f}"
        await self.give("Number", "EQUATORIAL_EOD_COORD", RA=ra_h, DEC=dec_deg)

    async def connect(self, bench: FakeOnPty | FakeOnTcp) -> None:
        """Connect to a fake on its wire and wait until the mount's properties are there."""
        await self.until(lambda: "CONNECTION" in self.states, "introduced")
        if isinstance(bench, FakeOnTcp):
            await self.give("Switch", "CONNECTION_MODE", CONNECTION_TCP="On")
            parts = urlsplit(bench.address)
            await self.until(lambda: "DEVICE_ADDRESS" in self.states, "asking for an address")
            await self.give("Text", "DEVICE_ADDRESS", ADDRESS=str(parts.hostname), PORT=str(parts.port))
        else:
            if "DEVICE_AUTO_SEARCH" in self.states:
                # or a driver that fails goes on to every other port of the machine
                await self.give("Switch", "DEVICE_AUTO_SEARCH", INDI_DISABLED="On")
            await self.give("Text", "DEVICE_PORT", PORT=bench.address)
        await self.give("Switch", "CONNECTION", CONNECT="On")
        await self.until(lambda: "TELESCOPE_ABORT_MOTION" in self.states, "connected")


@asynccontextmanager
async def running(driver: str, device: str, home: Path, *, package: str = "indi-bin") -> AsyncIterator[Indi]:
    """Run a driver with a home folder of its own; skips where it is not installed."""
    path = shutil.which(driver)
    if path is None:
        pytest.skip(f"{driver} is not installed: it comes with the package {package}")
    process = await asyncio.create_subprocess_exec(
        path,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, "HOME": str(home)},
    )
    indi = Indi(process, device)
    listening = asyncio.create_task(indi.listen())
    try:
        await indi.say("<getProperties version='1.7'/>")
        yield indi
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        await listening
