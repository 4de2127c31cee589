"""A process: a mount on a pseudo-terminal or a port that tells what its motors truly do, some times a second.

Arguments: its protocol and dialect ("lx200 onstep", if left out), or "alpaca", or "indi" and a driver's
program: a real `indiserver` with that driver stands before the fake then.

The first line is the device, each further one a JSON object; its instant is the machine's monotonic seconds.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from drivers.fakes.bench import FakeOnPty
from drivers.registry import fake_machine, make_fake
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Machine, Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site
from tests.drivers.alpaca.alpaca_server import AlpacaServer, FakeTelescope
from tests.drivers.indi.real_server import IndiServer
from tests.drivers.indi.test_language_over_real_drivers import REAL, told_its_line

SITE = Site(47.0, 11.0)
DEFAULT = ("lx200", "onstep")
_TELLS_S = 0.05
INDI = {"indi_eqmod_telescope": ("skywatcher", "eq6"), "indi_ioptronv3_telescope": ("ioptron", "v3")}
"""Drivers of a real `indiserver`, and the fake that each of them drives."""


def main() -> None:
    """Serve until standard input ends."""
    protocol, dialect = (*sys.argv[1:], *DEFAULT[len(sys.argv) - 1 :])[:2]
    driver = ""
    if protocol == "indi":
        driver, (protocol, dialect) = dialect, INDI[dialect]
    machine = fake_machine(protocol) if protocol != "alpaca" else Machine()
    if (protocol, dialect) != DEFAULT:
        machine = replace(machine, mounting="german", slew_rate_deg_s=15.0)
    mechanics = Mechanics(SITE, Air(1010.0), PointingErrors(), machine=machine, clock=utc_now)
    mechanics.tracking = True
    if protocol == "alpaca":
        telescope = FakeTelescope(mechanics)
        telescope.site = [SITE.latitude_deg, SITE.longitude_deg, SITE.height_m]
        served: FakeOnPty | AlpacaServer = AlpacaServer({"telescope/0": telescope}).start()
    else:
        served = FakeOnPty(make_fake(protocol, dialect or None, mechanics)).start()
    address = served.url("telescope/0") if isinstance(served, AlpacaServer) else served.address
    print(f"indi://127.0.0.1:{_behind(driver, address)}" if driver else address, flush=True)
    with contextlib.suppress(BrokenPipeError):
        while True:
            time.sleep(_TELLS_S)
            told = {
                "s": time.monotonic(),
                "beside": mechanics.beside_arcsec_s,
                "tracking": mechanics.tracking,
                "velocity": [mechanics.axis_velocity("ha"), mechanics.axis_velocity("dec")],
            }
            print(json.dumps(told), flush=True)
    served.stop()


def _behind(driver: str, address: str) -> str:
    """Have a real driver serve the fake; the server's port and the device. It dies with this process."""
    folder = Path(tempfile.mkdtemp(prefix="true-mount-"))
    server = IndiServer((driver,), folder)
    subprocess.Popen(
        # a name of its own: two servers on one machine would quarrel over the usual one
        [
            "setpriv",
            "--pdeathsig",
            "KILL",
            "indiserver",
            "-p",
            str(server.port),
            "-u",
            str(folder / "socket"),
            driver,
        ],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "HOME": str(folder)},
    )
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", server.port)):
            break
        time.sleep(0.05)
    asyncio.run(told_its_line(server, REAL[driver], address))
    return f"{server.port}/{quote(REAL[driver].device)}"


if __name__ == "__main__":
    main()
    sys.exit(0)
