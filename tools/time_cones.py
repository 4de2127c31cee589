"""How long cones of the embedded catalog take, warm: the table in docs/reference/catalog.md."""

from __future__ import annotations

import time

import numpy as np

from mountnav.catalog.embedded import embedded_catalog
from mountnav.sky.coordinates import Icrs

CASES = ((0.3, None), (1.0, None), (5.0, None), (20.0, None), (20.0, 10.0), (20.0, 8.0), (180.0, 6.0))
CENTERS = 50


def main() -> None:
    rng = np.random.default_rng(1)
    places = zip(
        rng.uniform(0, 360, CENTERS), np.degrees(np.arcsin(rng.uniform(-1, 1, CENTERS))), strict=True
    )
    centers = [Icrs(float(ra), float(dec)) for ra, dec in places]
    catalog = embedded_catalog()
    print("| radius | limit | stars (median) | ms (median) | ms (worst) |\n|---|---|---|---|---|")
    for radius_deg, limit in CASES:
        seconds, counts = [], []
        for center in centers:
            catalog.cone(center, radius_deg, epoch_yr=2026.9, mag_limit=limit)
            start = time.perf_counter()
            counts.append(len(catalog.cone(center, radius_deg, epoch_yr=2026.9, mag_limit=limit)))
            seconds.append(time.perf_counter() - start)
        row = f"{np.median(counts):.0f} | {np.median(seconds) * 1e3:.2f} | {max(seconds) * 1e3:.2f}"
        print(f"| {radius_deg}° | {'none' if limit is None else limit} | {row} |")


if __name__ == "__main__":
    main()
