"""A process: an OnStep mount on a pseudo-terminal that tells what its motors truly do, some times a second.

The first line is the device, each further one a JSON object; its instant is the machine's monotonic seconds.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time

from drivers.fakes.bench import FakeOnPty
from drivers.registry import fake_machine, make_fake
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site

SITE = Site(47.0, 11.0)
_TELLS_S = 0.05


def main() -> None:
    """Serve until standard input ends."""
    machine = fake_machine("lx200")
    mechanics = Mechanics(SITE, Air(1010.0), PointingErrors(), machine=machine, clock=utc_now)
    mechanics.tracking = True
    bench = FakeOnPty(make_fake("lx200", "onstep", mechanics)).start()
    print(bench.address, flush=True)
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
    bench.stop()


if __name__ == "__main__":
    main()
    sys.exit(0)
