"""What the command line costs before and beside the solving: CPU and memory of whole processes.

Run: python -m benchmarks.start_up [FRAME OPTIONS...]

Each command runs several times in a process of its own; printed are median CPU seconds (user and system), the
least, and the peak of resident memory. Bytecode is kept in a folder of its own and warm, as in an installed
environment. The last column is the ratio to the smallest program that imports numpy and the parts of
scipy which every solver needs: machines differ and are shared, ratios hold.

With a frame and the options of `mountnav solve` the table has that solve, too, and what the modules of each
package take of its imports.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict

ROUNDS = 9
FLOOR = "import numpy, scipy.ndimage, scipy.spatial"
Command = list[str]


def cost(command: Command, environment: dict[str, str]) -> tuple[list[float], float]:
    """CPU seconds of each round, and the greatest resident memory [MB]."""
    seconds, peak_mb = [], 0.0
    for _ in range(ROUNDS):
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        seconds.append(used.ru_utime + used.ru_stime)
        peak_mb = max(peak_mb, used.ru_maxrss / 1024.0)
    return seconds, peak_mb


def commands(asked: list[str]) -> dict[str, Command]:
    """What is measured, by what it is called; the floor comes first."""
    python, mountnav = [sys.executable, "-c"], [sys.executable, "-m", "api.main"]
    found = {
        "numpy, scipy.ndimage, scipy.spatial": [*python, FLOOR],
        "python": [*python, "pass"],
        "numpy": [*python, "import numpy"],
        "import mountnav.reading": [*python, "import mountnav.reading"],
        "import mountnav.solving.solve": [*python, "import mountnav.solving.solve"],
        "import api.http.app": [*python, "import api.http.app"],
        "import astropy.io.fits": [*python, "import astropy.io.fits"],
        "import astropy_healpix": [*python, "import astropy_healpix"],
        "mountnav --version": [*mountnav, "--version"],
        "mountnav --help": [*mountnav, "--help"],
    }
    if asked:
        found["mountnav solve --json"] = [*mountnav, "solve", *asked, "--json"]
        found["mountnav solve"] = [*mountnav, "solve", *asked]
    return found


def import_shares(command: Command, environment: dict[str, str]) -> dict[str, float]:
    """Milliseconds that the modules of each package take to import, without those they import."""
    told = subprocess.run(
        [command[0], "-X", "importtime", *command[1:]], env=environment, capture_output=True, text=True
    )
    shares: dict[str, float] = defaultdict(float)
    for line in told.stderr.splitlines():
        fields = line.removeprefix("import time:").split("|")
        if len(fields) == 3 and fields[0].strip().isdigit():
            shares[fields[2].strip().partition(".")[0]] += int(fields[0]) / 1000.0
    return shares


def main() -> None:
    with tempfile.TemporaryDirectory() as bytecode:
        environment = os.environ | {
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "PYTHONPYCACHEPREFIX": bytecode,
        }
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        found = commands(sys.argv[1:])
        print("| command | CPU median | least | peak memory | ratio |\n|---|---|---|---|---|")
        floor_s = 0.0
        for name, command in found.items():
            subprocess.run(command, env=environment, capture_output=True)  # fills the bytecode's folder
            seconds, peak_mb = cost(command, environment)
            median_s = statistics.median(seconds)
            floor_s = floor_s or median_s
            print(
                f"| {name} | {median_s:.3f} s | {min(seconds):.3f} s | {peak_mb:.0f} MB "
                f"| {median_s / floor_s:.2f} |",
                flush=True,
            )
        last = list(found)[-2] if sys.argv[1:] else "import mountnav.solving.solve"
        print(f"\nimports of `{last}`, ms of each package's own modules:")
        shares = import_shares(found[last], environment)
        for package, share_ms in sorted(shares.items(), key=lambda one: -one[1])[:12]:
            print(f"- {package}: {share_ms:.0f}")


if __name__ == "__main__":
    main()
