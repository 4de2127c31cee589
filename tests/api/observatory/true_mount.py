"""A process: a mount on a pseudo-terminal or a port that tells what its motors truly do, some times a second.

Arguments: its protocol and dialect ("lx200 onstep", if left out), or "alpaca".

The first line is the device, each further one a JSON object; its instant is the machine's monotonic seconds.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from dataclasses import replace

from drivers.fakes.bench import FakeOnPty
from drivers.registry import fake_machine, make_fake
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Machine, Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site
from tests.drivers.alpaca.alpaca_server import AlpacaServer, FakeTelescope

SITE = Site(47.0, 11.0)
DEFAULT = ("lx200", "onstep")
_TELLS_S = 0.05


def main() -> None:
    """Serve until standard input ends."""
    protocol, dialect = (*sys.argv[1:], *DEFAULT[len(sys.argv) - 1 :])[:2]
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
    print(served.url("telescope/0") if isinstance(served, AlpacaServer) else served.address, flush=True)
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


if __name__ == "__main__":
    main()
    sys.exit(0)
