"""Small zone files of UCAC4 near the poles, with as many stars as the catalog has there, at random places."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mountnav.catalog.readers.ucac4.reader import STARS_IN_ZONE
from mountnav.catalog.readers.ucac4.record import RECORD

SMALL = (1, 2, 898, 899, 900)
"""206, 660, 834, 512 and 171 stars."""


def write_zones(folder: Path, zones: tuple[int, ...] = SMALL, *, seed: int = 7) -> Path:
    """Write some zone files; the same bytes each time."""
    folder.mkdir(parents=True, exist_ok=True)
    for zone in zones:
        rng, count = np.random.default_rng((seed, zone)), STARS_IN_ZONE[zone - 1]
        stars = np.zeros(count, dtype=RECORD)
        stars["ra"] = np.sort(rng.integers(0, 360 * 3_600_000, count))
        stars["spd"] = rng.integers((zone - 1) * 720_000, zone * 720_000, count)
        stars["fit_mag"] = stars["aperture_mag"] = rng.integers(8000, 16500, count)
        stars["mag_sigma"] = 5
        stars["sigma_ra"] = stars["sigma_dec"] = rng.integers(10, 60, count) - 128
        stars["images"] = stars["images_used"] = 4
        stars["epoch_ra"] = stars["epoch_dec"] = 10_200
        stars["pm_ra"], stars["pm_dec"] = rng.integers(-300, 300, (2, count))
        stars["sigma_pm_ra"] = stars["sigma_pm_dec"] = rng.integers(10, 60, count) - 128
        stars["twomass_key"] = 1000 + np.arange(count)
        stars["jhk_mag"] = 12_000
        stars["apass_mag"] = 20_000
        stars["apass_mag"][::3] = 12_500
        stars["apass_sigma"] = 3
        stars["star_id"] = zone * 1_000_000 + np.arange(count)
        (folder / f"z{zone:03d}").write_bytes(stars.tobytes())
    return folder


def star_count(zones: tuple[int, ...] = SMALL) -> int:
    """How many stars the zones hold."""
    return sum(STARS_IN_ZONE[zone - 1] for zone in zones)
