"""Print what it costs to give up: lists of the rendered frames that match nothing, under hints of some kinds.

Run: python -m benchmarks.giving_up [A01,B02,C00,E00,D01]

Each frame is measured in full and its y are dealt out again, so that brightnesses, crowding and flags stay
while no arrangement does. CPU seconds of identification alone, with the index of the whole sky.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.frames import read, rendered, shared_folder
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadFrame
from mountnav.frames import Hint
from mountnav.identification.blind.cache import cached_index
from mountnav.identification.search import Reach, identify
from mountnav.measuring.measure import measure

SEED = 5
EPOCH_YR = 2020.0


def hints(given: Hint) -> dict[str, tuple[Hint, Reach]]:
    """What is asked, and how far."""
    after, only = Reach(cached_index(embedded_catalog())), Reach(cached_index(embedded_catalog()), "only")
    plain = replace(given, alternatives=())
    unknown = replace(plain, radius_deg=1.0, scale_low_arcsec_px=None, scale_high_arcsec_px=None)
    return {
        "1°, scale ±5 %": (replace(plain, radius_deg=1.0), after),
        "5°, scale ±5 %": (replace(plain, radius_deg=5.0), after),
        "1°, no scale": (unknown, after),
        "blind": (Hint(), only),
    }


def main() -> None:
    names = sys.argv[1].split(",") if len(sys.argv) > 1 else ["A01", "B02", "C00", "E00", "D01"]
    print("| list | sources | hint | CPU s | hypotheses |\n|---|---|---|---|---|")
    for known in rendered(shared_folder()):
        frame = read(known)
        if known.path.name[:3] not in names or isinstance(frame, BadFrame):
            continue
        measured = measure(frame)
        measured = replace(measured, y_px=np.random.default_rng(SEED).permutation(measured.y_px))
        for how, (hint, reach) in hints(known.hint).items():
            before_s = time.process_time()
            found = identify(measured, embedded_catalog(), hint, epoch_yr=EPOCH_YR, reach=reach)
            spent_s = time.process_time() - before_s
            wrong = "" if found.reference is None else " WRONG"
            print(
                f"| {known.path.name[:3]} | {len(measured)} | {how} | {spent_s:.2f}{wrong} | {found.tried} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
