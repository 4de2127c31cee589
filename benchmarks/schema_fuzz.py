"""Run schemathesis over the whole `/v1` schema, against a running service with a fake mount and with a key.

Wanted: no server error and no violation of the schema. Its phases: examples, coverage (each bound of each
parameter and body), fuzzing; with data that fit the schema and data that don't. All its checks but two:
`positive_data_acceptance` (an order that fits the schema may well be refused, by the horizon for one) and
`ignored_auth` (it takes a wrong `Authorization` beside the right `X-API-Key` for a fault; either is enough).
The event streams never end, and schemathesis waits for an end: `tests/api/http/test_schema_fuzz.py` asks
them.

Run: python -m benchmarks.schema_fuzz [--examples 50] [--seed N] [further options of `schemathesis run`]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.latency import Served, ready

TOKEN = "a key of this run alone"
STREAMS = r"/events$"
SETTINGS = f"""
[service]
port = 0
api_token_sha256 = "{hashlib.sha256(TOKEN.encode()).hexdigest()}"
rate_limit_per_s = 0
[site]
latitude_deg = 48.93
longitude_deg = 22.27
[[telescope]]
id = "east"
exposure_s = 0.2
scale_arcsec_px = 6.0
mount = {{ url = "fake+lx200://?dialect=onstep", mounting = "german", slew_rate_deg_s = 60.0 }}
camera = {{ kind = "simulated", width_px = 640, height_px = 480, scale_arcsec_px = 6.0 }}
night = {{ enabled = true }}
"""

RULES = """
[checks.negative_data_rejection]
# schemathesis' own list, and 413: a text far longer than its `maxLength` makes a body that isn't read at all
expected-statuses = [400, 401, 403, 404, 405, 406, 409, 413, 415, 422, 428, 429, "5xx"]
"""


@contextmanager
def serving(folder: Path) -> Iterator[Served]:
    """A service in a process of its own, that asks for the key `TOKEN`; its log is the file `log`."""
    settings = folder / "observatory.toml"
    settings.write_text(SETTINGS)
    environment = {**os.environ, "MOUNTNAV_JOURNAL": str(folder / "journal.sqlite")}
    with (
        (folder / "log").open("w+b") as log,
        subprocess.Popen(
            [sys.executable, "-m", "api.main", "serve", "--config", str(settings)],
            stdout=log,
            stderr=log,
            env=environment,
        ) as process,
    ):
        try:
            yield ready(process, folder / "log")
        finally:
            process.send_signal(signal.SIGINT)


def fuzz(port: int, folder: Path, options: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run schemathesis; its report is the standard output, its exit code 0 only if nothing was found."""
    rules = folder / "schemathesis.toml"
    rules.write_text(RULES)
    command = [
        *(str(Path(sys.executable).parent / "schemathesis"), "--config-file", str(rules)),
        *("run", f"http://127.0.0.1:{port}/openapi.json"),
        *("--header", f"X-API-Key:{TOKEN}", "--phases", "examples,coverage,fuzzing"),
        *("--exclude-path-regex", STREAMS, "--exclude-checks", "positive_data_acceptance,ignored_auth"),
        *("--continue-on-failure", "--no-shrink", "--request-timeout", "60", "--output-truncate", "false"),
        *("--suppress-health-check", "all"),
        *options,
    ]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def server_errors(folder: Path) -> list[str]:
    """What the service's log tells of errors that nobody foresaw."""
    log = (folder / "log").read_text(encoding="utf-8", errors="replace")
    return [
        line for line in log.splitlines() if "unforeseen" in line or "Traceback" in line or '" 500' in line
    ]


def main() -> int:
    """Fuzz, print the report, and return 0 only if nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--examples", type=int, default=50, help="of each operation, while fuzzing")
    asked, further = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with serving(folder) as served:
            done = fuzz(served.port, folder, ["--max-examples", str(asked.examples), *further])
        errors = server_errors(folder)
    print(done.stdout, done.stderr, sep="\n")
    print(f"{len(errors)} unforeseen errors in the service's log", *errors[:20], sep="\n")
    return 1 if errors else done.returncode


if __name__ == "__main__":
    sys.exit(main())
