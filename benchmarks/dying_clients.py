"""Clients die while the mount goes on by their order: nothing outlives its end, at any face.

Run: python -m benchmarks.dying_clients [--face NAME] [--death NAME]

A real service on real ports, a mount in a process of its own, and a client as a process, for each face, what
goes on there, and death: it is killed; its connection is reset; the line goes silent and stays open; it is
suspended; every packet is dropped ("cut": as root in `unshare -n`, with lo up). What the fake's motors truly
do is watched until they run as for a star. Exit code 1 when something outlived its end. Some 10 s each.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.api.all_faces.deaths import DEATHS, KINDS, allowed_s, can_cut, observed, outlives_s


def main() -> int:
    """Go through all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--face", choices=sorted({face for face, _ in KINDS}))
    parser.add_argument("--death", choices=(*DEATHS, "cut"))
    asked = parser.parse_args()
    deaths = (asked.death,) if asked.death else DEATHS + (("cut",) if can_cut() else ())
    wrong = count = 0
    with tempfile.TemporaryDirectory() as folder, observed(Path(folder)) as at:
        for face, what in KINDS:
            for death in deaths:
                if asked.face not in (None, face):
                    continue
                at.rested()
                try:
                    took_s = outlives_s(at, face, what, death)
                except AssertionError as fault:
                    print(f"{face:12} {what:6} {death:10} FAILED {fault}", flush=True)
                    wrong += 1
                    continue
                most_s = allowed_s(face, what, death)
                good = took_s is not None and took_s <= most_s
                count, wrong = count + 1, wrong + (not good)
                took = "outlived the watch" if took_s is None else f"ended after {took_s:.1f} s"
                print(
                    f"{face:12} {what:6} {death:10} {took}, {most_s:.0f} s allowed {'' if good else 'WRONG'}",
                    flush=True,
                )
    print(f"{count} deaths, {wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
