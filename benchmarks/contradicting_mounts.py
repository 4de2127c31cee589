"""Mounts that contradict themselves on a bad line: 100,000 exchanges a family, judged by the truth.

``python -m benchmarks.contradicting_mounts [FAMILY[/DIALECT] ...] [--seeds 200-209] [--honest]``; exit code 1
if an order went out by a wrong belief or a sync was misnamed. Each line names the seed that repeats it. With
``--honest`` the line alone is bad, and the mounts say what they do. Short lives of each are in
`tests/drivers/test_wire_fuzz.py`.
"""

from __future__ import annotations

import argparse
import sys

import pytest

from tests.drivers.test_wire_fuzz import A_LIFE, CONTRADICTING, EVERYTHING, FAMILIES, USUAL_KINDS, lived


def main() -> int:
    """Live all lives; print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("families", nargs="*", metavar="FAMILY[/DIALECT]")
    parser.add_argument("--seeds", default="200-209", metavar="FIRST-LAST")
    parser.add_argument(
        "--honest", action="store_true", help="the line is bad, the mounts contradict nothing"
    )
    asked = parser.parse_args()
    first, _, last = asked.seeds.partition("-")
    wrong = 0
    for protocol, dialect in FAMILIES if asked.honest else CONTRADICTING:
        name = "/".join(filter(None, (protocol, dialect)))
        if asked.families and name not in asked.families:
            continue
        exchanges = 0
        for seed in range(int(first), int(last or first) + 1):
            if asked.honest:
                rate, kinds = (0.05, USUAL_KINDS) if seed % 2 else (0.02, EVERYTHING)
            else:
                rate, kinds = (0.02, USUAL_KINDS) if seed % 2 else (0.01, EVERYTHING)
            with pytest.MonkeyPatch.context() as patched:
                life, _ = lived(
                    patched, protocol, dialect, A_LIFE, seed, rate, kinds, contradicts=not asked.honest
                )
            exchanges += life.exchanges
            wrong += len(life.wrong)
            for what in life.wrong:
                print(f"{name} seed {seed}: {what}", flush=True)
        print(f"{name}: {exchanges} exchanges", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
