"""A real `indiserver` with real drivers, for a test to talk to, to kill and to bring back."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import shutil
import signal
import socket
from collections.abc import Mapping
from pathlib import Path

import pytest

from drivers.indi.client import IndiClient
from drivers.indi.codec import messages
from drivers.indi.device import IndiDevice
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing

TELESCOPE = "Telescope Simulator"
CCD = "CCD Simulator"


def free_port() -> int:
    """A TCP port that nobody has now, of those that the system gives to no connection by itself.

    A port that was asked for as 0 may be the near end of somebody's connection when the server comes to it.
    """
    with contextlib.suppress(OSError):
        lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
        while lowest > 12_000:
            port = random.SystemRandom().randrange(10_000, lowest)
            with contextlib.suppress(OSError), socket.socket() as probe:
                probe.bind(("127.0.0.1", port))
                return port
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class IndiServer:
    """An `indiserver` in a process group of its own, with a home folder of its own.

    Parameters
    ----------
    drivers : tuple of str
        Their programs.
    home : Path
    environment : mapping, optional
        Added to ours.
    restarts : int
        How often it runs a driver again that has ended.
    """

    def __init__(
        self,
        drivers: tuple[str, ...],
        home: Path,
        environment: Mapping[str, str] | None = None,
        *,
        restarts: int = 0,
    ) -> None:
        self.drivers = drivers
        self.home = home
        self.port = free_port()
        self._environment = environment or {}
        self._restarts = restarts
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        """Run it, and wait until it listens."""
        for program in ("indiserver", *self.drivers):
            if shutil.which(program) is None:
                pytest.skip(f"{program} is not installed: it comes with the package indi-bin")
        self.home.mkdir(exist_ok=True)
        log = (self.home / "indiserver.log").open("ab")
        with log:
            self._process = await asyncio.create_subprocess_exec(
                "indiserver",
                # a name of its own: two servers on one machine would quarrel over the usual one
                *("-v", "-r", str(self._restarts), "-p", str(self.port), "-u", str(self.home / "socket")),
                *self.drivers,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "HOME": str(self.home), **self._environment},
                start_new_session=True,
            )
        async with asyncio.timeout(30.0):
            while True:
                assert self._process.returncode is None, (self.home / "indiserver.log").read_text()
                with contextlib.suppress(OSError):
                    _, writer = await asyncio.open_connection("127.0.0.1", self.port)
                    writer.close()
                    return
                await asyncio.sleep(0.05)

    def device(self, name: str) -> IndiDevice:
        """A connection of the test's own, not yet open: another program beside ours."""
        return IndiDevice(IndiClient("127.0.0.1", self.port, name, log=WireLog()), name)

    async def set_numbers(self, device: str, name: str, **numbers: float) -> None:
        """Connect a device and set some of its numbers, as another program would."""
        other = self.device(device)
        async with asyncio.timeout(60.0):
            while True:
                # on a busy machine the server listens long before its driver has introduced itself
                with contextlib.suppress(DeviceMissing):
                    await other.bring_up(may_connect=True, needed=(name,))
                    break
                await asyncio.sleep(0.1)
        await other.ordered(messages.new_numbers(device, name, numbers), asking=name)
        await other.client.close()

    async def kill(self) -> None:
        """End it and its drivers at once, as a power cut would."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()

    def freeze(self) -> None:
        """Have it hang: the connection stays open, and nothing comes any more."""
        assert self._process is not None
        os.killpg(self._process.pid, signal.SIGSTOP)

    def thaw(self) -> None:
        """Have it go on."""
        assert self._process is not None
        os.killpg(self._process.pid, signal.SIGCONT)

    def kill_driver(self, program: str) -> None:
        """End one of its drivers."""
        assert self._process is not None
        for folder in Path("/proc").iterdir():
            if not folder.name.isdecimal():
                continue
            with contextlib.suppress(OSError):
                ours = os.getpgid(int(folder.name)) == self._process.pid
                if ours and (folder / "comm").read_text().strip() == program[:15]:
                    os.kill(int(folder.name), signal.SIGKILL)
