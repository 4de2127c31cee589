"""kill -9 of the service while its mount follows, or an axis is moved: nothing outlives it, in any family.

Run: python -m benchmarks.guards [--family NAME] [--times 1]

Each family's fake lives in a process of its own, on a pseudo-terminal or a port. The service, a real one,
slews it, has it go on by itself and is killed. What the fake's motors truly do is watched until they run as
for a star, or rest; then no guard may be left. Exit code 1 when a report says anything but "ended". Some 15 s
of one core each.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tests.api.observatory.test_dead_man import FAMILIES, killed_and_ended


def main() -> int:
    """Go through the families."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--family", choices=sorted(FAMILIES))
    parser.add_argument("--times", type=int, default=1)
    asked = parser.parse_args()
    wrong = 0
    for family in [asked.family] if asked.family else FAMILIES:
        for what in FAMILIES[family][2] * asked.times:
            began_s = time.monotonic()
            with tempfile.TemporaryDirectory() as folder:
                report = killed_and_ended(family, what, Path(folder))
            wrong += not report["outcome"].startswith("ended")
            took_s = time.monotonic() - began_s
            print(
                f"{family:14} {what:6} {report['outcome']} (tries: {report['tries']}), {took_s:.0f} s in all"
            )
    print(f"{wrong} outlived their service")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
