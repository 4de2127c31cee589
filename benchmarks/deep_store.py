"""A packed store as large as UCAC4: import rate, size, time to open, cones warm and cold, peak memory.

The stars are made up: denser towards the galactic plane, ever more of them the fainter, with errors, proper
motions (5000 of 0.5 to 10 arcsec/yr among them), colors and flags, in declination bands as a catalog's files
have them. Everything goes through `Spool`, as an import does. One run of all stages::

    python benchmarks/deep_store.py                       # 113 million stars: 7 GB of disk, some minutes
    python benchmarks/deep_store.py --stars 3000000
    python benchmarks/deep_store.py --folder F import     # one stage: import, finish or cones

CPU seconds, except where cold: there the clock counts.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.packed.spool import PackedFacts, Spool
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

STARS = 113_000_000
STARS_OF_A_PART = 500_000
FACTS = PackedFacts("made up", "V", 2000.0, "B-V", "benchmarks/deep_store.py")
LIMIT_MAG = 16.0
SLOPE_DEX_MAG = 0.35
FAST_STARS = 5000
EPOCH_YR = 2026.9
GALACTIC_POLE = (192.859, 27.128)
STAGES = ("import", "finish", "cones")
CONES: tuple[tuple[float, float | None], ...] = (
    (0.1, None),
    (0.3, None),
    (0.3, 14.0),
    (1.0, None),
    (1.0, 12.0),
    (5.0, None),
    (5.0, 12.0),
    (20.0, 12.0),
    (20.0, 10.0),
    (20.0, 8.0),
    (180.0, 6.0),
)
WARM, COLD = 40, 15
LARGE_DEG = 5.0


def density(ra_deg: Array, dec_deg: Array) -> Array:
    """Stars per square degree, relative: ten times as many in the galactic plane as at the poles."""
    pole_ra, pole_dec = np.radians(GALACTIC_POLE)
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    sin_b = np.sin(dec) * np.sin(pole_dec) + np.cos(dec) * np.cos(pole_dec) * np.cos(ra - pole_ra)
    return 1.0 + 9.0 * np.exp(-np.degrees(np.arcsin(np.abs(np.clip(sin_b, -1, 1)))) / 12.0)


def band(rng: np.random.Generator, south: float, north: float, count: int) -> CatalogColumns:
    """Stars of a band of declination, given by the sines of its borders."""
    cell_ra, cell_z = np.meshgrid(np.arange(0.5, 720) / 2, south + (north - south) * np.arange(0.5, 8) / 8)
    weight = density(cell_ra.ravel(), np.degrees(np.arcsin(cell_z.ravel())))
    cell = np.repeat(np.arange(weight.size), rng.multinomial(count, weight / weight.sum()))
    ra = cell_ra.ravel()[cell] + rng.uniform(-0.25, 0.25, count)
    z = cell_z.ravel()[cell] + rng.uniform(-0.5, 0.5, count) * (north - south) / 8
    pm = rng.normal(0, 12, (2, count))
    pm[:, rng.random(count) < 0.01] = np.nan
    fast = np.flatnonzero(rng.random(count) < FAST_STARS / STARS)
    speed, angle = rng.pareto(1.6, fast.size) * 500 + 500, rng.uniform(0, 2 * np.pi, fast.size)
    pm[:, fast] = np.minimum(speed, 10_300) * np.array([np.cos(angle), np.sin(angle)])
    mag = np.maximum(LIMIT_MAG + np.log10(1.0 - rng.random(count)) / SLOPE_DEX_MAG, -1.4)
    # UCAC4: some 20 mas at its epoch for bright stars, five times that for faint ones
    sigma = 15.0 + rng.lognormal(3.0, 0.5, count) * 10.0 ** (0.2 * (mag - LIMIT_MAG))
    sigma_pm = rng.lognormal(1.2, 0.6, count)
    epoch = rng.uniform(1975.0, 2002.0, count)
    return CatalogColumns(
        ra % 360.0,
        np.degrees(np.arcsin(np.clip(z, -1, 1))),
        *pm.round(1),
        mag,
        error_curve((sigma, sigma), (sigma_pm, sigma_pm), (epoch, epoch)),
        rng.normal(0.9, 0.4, count),
        rng.integers(0, 8, count).astype(np.uint8) & 0b110,
    )


def make(folder: Path, stars: int) -> None:
    spool = Spool.open(folder / "spool", FACTS)
    parts = max(1, round(stars / STARS_OF_A_PART))
    edges = np.linspace(-1.0, 1.0, parts + 1)
    # as many stars in a band as its part of the galaxy holds
    middle = np.degrees(np.arcsin((edges[1:] + edges[:-1]) / 2))
    ra = np.arange(0.0, 360.0, 3.0)
    weight = np.array([density(ra, np.full(ra.size, dec)).mean() for dec in middle])
    counts = np.random.default_rng(0).multinomial(stars, weight / weight.sum())
    cpu_s = 0.0
    for number, count in enumerate(counts):
        name = f"band {number:04d}"
        if name in spool.done:
            continue
        columns = band(np.random.default_rng([1, number]), edges[number], edges[number + 1], int(count))
        start = time.process_time()
        spool.add(name, [columns])
        cpu_s += time.process_time() - start
    size = sum(file.stat().st_size for file in (folder / "spool").iterdir())
    print(f"add: {spool.count:,} stars, {size / 1e9:.2f} GB of spool, {cpu_s:.1f} s of CPU", end=", ")
    print(f"{spool.count / max(cpu_s, 1e-9) / 1e6:.2f} million stars a second; {memory()}")


def finish(folder: Path) -> None:
    spool = Spool.open(folder / "spool", FACTS)
    start, clock = time.process_time(), time.perf_counter()
    header = spool.finish(folder / "store.mnc")
    cpu_s, wall_s = time.process_time() - start, time.perf_counter() - clock
    size = (folder / "store.mnc").stat().st_size
    print(f"finish: {cpu_s:.1f} s of CPU, {wall_s:.1f} s by the clock, {size / 1e9:.3f} GB", end=", ")
    print(f"nside {header.nside}, {header.fast_count} fast stars; {memory()}")
    spool.discard()


def centers(count: int, seed: int) -> list[Icrs]:
    rng = np.random.default_rng(seed)
    dec = np.degrees(np.arcsin(rng.uniform(-1, 1, count)))
    return [Icrs(float(a), float(d)) for a, d in zip(rng.uniform(0, 360, count), dec, strict=True)]


def forget(path: Path) -> None:
    """Have the system drop the file from its memory; pages that are mapped would stay."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def cones(folder: Path) -> None:
    path = folder / "store.mnc"
    PackedStore(path).cone(Icrs(1, 1), 0.3, epoch_yr=EPOCH_YR)  # imports what it needs
    opened = []
    for _ in range(7):
        start = time.perf_counter()
        PackedStore(path)
        opened.append(time.perf_counter() - start)
    forget(path)
    start = time.perf_counter()
    store = PackedStore(path)
    cold_s = time.perf_counter() - start
    print(f"open: {np.median(opened) * 1e3:.2f} ms warm, {cold_s * 1e3:.2f} ms cold; {memory()}")
    before = resident()
    for center in centers(300, 9):
        store.cone(center, 0.3, epoch_yr=EPOCH_YR)
    print(f"after 300 cones of 0.3°: {memory()}; anonymous {before[0]:.1f} -> {resident()[0]:.1f} MB")
    start = time.perf_counter()
    share = store.sky_share()
    print(f"sky_share: {share:.4f} in {(time.perf_counter() - start) * 1e3:.2f} ms")
    print("| radius | limit | stars (median) | warm ms (median) | warm ms (worst) | cold ms (median) |")
    print("|---|---|---|---|---|---|")
    for radius_deg, limit in CONES:
        warm, cold, counts = [], [], []
        for center in centers(WARM if radius_deg < LARGE_DEG else WARM // 4, 1):
            store.cone(center, radius_deg, epoch_yr=EPOCH_YR, mag_limit=limit)
            start = time.process_time()
            counts.append(len(store.cone(center, radius_deg, epoch_yr=EPOCH_YR, mag_limit=limit)))
            warm.append((time.process_time() - start) * 1e3)
        store = None  # what is mapped can't be forgotten
        for center in centers(COLD if radius_deg < LARGE_DEG else 3, 2):
            forget(path)
            store = PackedStore(path)
            start = time.perf_counter()
            store.cone(center, radius_deg, epoch_yr=EPOCH_YR, mag_limit=limit)
            cold.append((time.perf_counter() - start) * 1e3)
            store = None
        store = PackedStore(path)
        row = f"{np.median(counts):.0f} | {np.median(warm):.2f} | {max(warm):.2f} | {np.median(cold):.1f}"
        print(f"| {radius_deg}° | {'none' if limit is None else limit} | {row} |", flush=True)


def resident() -> tuple[float, float]:
    """Memory of this process that is its own, and that is files', in MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    told = {line.split(":")[0]: line.split()[1] for line in lines if line.startswith("Rss")}
    return int(told["RssAnon"]) / 1024, int(told["RssFile"]) / 1024


def memory() -> str:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    own, files = resident()
    return f"memory {own:.0f} MB own + {files:.0f} MB files, peak {peak:.0f} MB"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("stage", nargs="?", choices=STAGES, help="all, if none is named")
    parser.add_argument("--stars", type=int, default=STARS)
    parser.add_argument("--folder", type=Path, help="where store and spool go, and stay")
    arguments = parser.parse_args()
    if arguments.stage:
        if arguments.folder is None:
            parser.error("a single stage needs --folder")
        arguments.folder.mkdir(parents=True, exist_ok=True)
        stage = arguments.stage
        if stage == "import":
            make(arguments.folder, arguments.stars)
        elif stage == "finish":
            finish(arguments.folder)
        else:
            cones(arguments.folder)
        return
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        for stage in STAGES:  # a process each, so that each has a peak of its own
            command = [sys.executable, __file__, stage, "--stars", str(arguments.stars), "--folder", folder]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
