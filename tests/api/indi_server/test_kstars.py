"""KStars under Xvfb, told over D-Bus to connect to our INDI server and to slew; where it is installed."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from mountnav.clock import utc_now
from mountnav.sky.coordinates import Apparent
from tests.api.indi_server.face_rig import apart_arcsec, indi_observatory, mechanics_of
from tests.waiting import until

PROGRAMS = {"kstars": "kstars", "Xvfb": "xvfb", "dbus-daemon": "dbus-daemon", "dbus-send": "dbus-bin"}
INDI = "org.kde.kstars.INDI"


@asynccontextmanager
async def process(environment: dict[str, str], *command: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """A program in a group of its own, ended with all that it has started."""
    started = await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
    )
    try:
        yield started
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
        await started.communicate()


class KStars:
    """A running KStars, by its D-Bus."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._environment = environment

    async def call(self, method: str, *arguments: str) -> str:
        """What a method of its INDI object answers; empty while it isn't there."""
        told = await asyncio.create_subprocess_exec(
            *("dbus-send", "--session", "--print-reply=literal", "--reply-timeout=20000"),
            *("--dest=org.kde.kstars", "/KStars/INDI", f"{INDI}.{method}", *arguments),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            env=self._environment,
        )
        said, _ = await told.communicate()
        return said.decode().strip()

    async def number(self, name: str, element: str) -> float:
        """One number of a property."""
        told = await self.call("getNumber", "string:east", f"string:{name}", f"string:{element}")
        return float(told.removeprefix("double "))

    async def state(self, name: str) -> str:
        """The state of a property."""
        return await self.call("getPropertyState", "string:east", f"string:{name}")

    async def set_switch(self, name: str, element: str) -> None:
        """Turn one switch on."""
        await self.call("setSwitch", "string:east", f"string:{name}", f"string:{element}", "string:On")
        await self.call("sendProperty", "string:east", f"string:{name}")

    async def until_state(self, name: str, *states: str) -> None:
        """Wait until a property is in one of some states."""
        async with asyncio.timeout(60.0):
            while await self.state(name) not in states:
                await asyncio.sleep(0.1)


@asynccontextmanager
async def kstars(home: Path) -> AsyncIterator[KStars]:
    """Run it without a screen, on a session bus of its own."""
    for program, package in PROGRAMS.items():
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed: it comes with the package {package}")
    (home / ".config").mkdir(parents=True)
    (home / ".config" / "kstarsrc").write_text("[General]\nrunStartupWizard=false\n")
    (home / "run").mkdir(mode=0o700)
    environment = {
        **os.environ,
        "HOME": str(home),
        "XDG_RUNTIME_DIR": str(home / "run"),
        "QT_QPA_PLATFORM": "xcb",
        "LIBGL_ALWAYS_SOFTWARE": "1",
    }
    screen = ("Xvfb", "-displayfd", "1", "-screen", "0", "1280x900x24", "-nolisten", "tcp")
    async with process(environment, *screen) as xvfb:
        assert xvfb.stdout is not None
        async with asyncio.timeout(60.0):
            environment["DISPLAY"] = ":" + (await xvfb.stdout.readline()).decode().strip()
        async with process(environment, "dbus-daemon", "--session", "--nofork", "--print-address") as bus:
            assert bus.stdout is not None
            async with asyncio.timeout(60.0):
                environment["DBUS_SESSION_BUS_ADDRESS"] = (await bus.stdout.readline()).decode().strip()
            async with process(environment, "kstars"):
                found = KStars(environment)
                async with asyncio.timeout(120.0):
                    while not await found.call("getDevices"):
                        await asyncio.sleep(0.5)
                yield found


@pytest.mark.long
async def test_kstars_finds_the_device_reads_it_slews_and_stops_it(tmp_path: Path) -> None:
    async with kstars(tmp_path / "home") as program, indi_observatory(tmp_path) as (service, server):
        host, port = server.address
        assert await program.call("connect", f"string:{host}", f"int32:{port}") == "boolean true"
        async with asyncio.timeout(60.0):
            while not re.search(r"\beast\b", await program.call("getDevices")):
                await asyncio.sleep(0.2)
        await program.until_state("EQUATORIAL_EOD_COORD", "Ok")
        mechanics = mechanics_of(service)
        here = Apparent(
            15.0 * await program.number("EQUATORIAL_EOD_COORD", "RA"),
            await program.number("EQUATORIAL_EOD_COORD", "DEC"),
            utc_now(),
        )
        assert apart_arcsec(here, mechanics.reported(utc_now())) < 10.0
        assert await program.number("GEOGRAPHIC_COORD", "LAT") == pytest.approx(47.0)
        # its own way to slew: the switch, then the coordinates
        await program.set_switch("ON_COORD_SET", "TRACK")
        name = ("string:east", "string:EQUATORIAL_EOD_COORD")
        await program.call("setNumber", *name, "string:DEC", f"double:{here.dec_deg - 2.0}")
        await program.call("sendProperty", *name)
        await until(lambda: len(service.jobs.all()) == 1, "ordered")
        job = service.jobs.all()[0]
        await asyncio.wait_for(job.ended.wait(), 60.0)
        assert (job.kind, job.state) == ("slew", "succeeded"), job.problem
        await program.until_state("EQUATORIAL_EOD_COORD", "Ok")
        assert mechanics.reported(utc_now()).dec_deg == pytest.approx(here.dec_deg - 2.0, abs=0.01)
        # below the horizon: refused, and nothing moves
        await program.call("setNumber", *name, "string:DEC", "double:-75")
        await program.call("sendProperty", *name)
        # a stop that comes behind it is answered after it
        await program.set_switch("TELESCOPE_ABORT_MOTION", "ABORT")
        await program.until_state("TELESCOPE_ABORT_MOTION", "Ok", "Idle")
        assert len(service.jobs.all()) == 1
        assert mechanics.reported(utc_now()).dec_deg == pytest.approx(here.dec_deg - 2.0, abs=0.01)
