"""Draw an archive: star lists of known places as text, 1 % of them poison, and a table of hints and truth.

    python -m benchmarks.archive.drawn FOLDER [--lists 1000] [--seed 1]

writes FOLDER/lists/*.xy and FOLDER/frames.csv. Of its columns `mountnav archive init --frames` takes
``file``, ``ra_deg``, ``dec_deg``, ``radius_deg``, ``scale_arcsec_px``; ``true_ra_deg``, ``true_dec_deg`` and
``poison`` are for a judge.
"""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path

import numpy as np

from mountnav.catalog.embedded import embedded_catalog
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

WIDTH, HEIGHT, SCALE_ARCSEC_PX = 1600, 1200, 6.0
"""A field of 2.7° by 2°: 30 to 100 stars of the embedded catalog."""
NOISE_PX = 0.1
"""One-sigma error of a place, per coordinate."""
POISON_EACH = 100
"""Of so many frames one is poison: random stars, no stars, cut short, no list at all, no file."""


def draw(folder: Path, count: int, seed: int) -> Path:
    """Draw the lists; the table of them."""
    lists = folder / "lists"
    lists.mkdir(parents=True, exist_ok=True)
    rng, catalog = np.random.default_rng(seed), embedded_catalog()
    table = folder / "frames.csv"
    with open(table, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(
            [
                "file",
                "ra_deg",
                "dec_deg",
                "radius_deg",
                "scale_arcsec_px",
                "true_ra_deg",
                "true_dec_deg",
                "poison",
            ]
        )
        for number in range(count):
            center = Icrs(float(rng.uniform(0, 360)), math.degrees(math.asin(rng.uniform(-1, 1))))
            poison = number % POISON_EACH == POISON_EACH // 2
            name = f"lists/{number:06d}.xy"
            text = _poison(number, rng) if poison else _list(center, catalog, rng)
            if text is not None:
                (folder / name).write_text(text)
            off = rng.uniform(-0.3, 0.3, 2)
            dec = float(np.clip(center.dec_deg + off[1], -90, 90))
            ra = (center.ra_deg + off[0] / max(math.cos(math.radians(dec)), 0.01)) % 360.0
            rows.writerow(
                [
                    *(name, f"{ra:.4f}", f"{dec:.4f}", 2, SCALE_ARCSEC_PX),
                    *(f"{center.ra_deg:.6f}", f"{center.dec_deg:.6f}", int(poison)),
                ]
            )
    return table


def _list(center: Icrs, catalog: object, rng: np.random.Generator) -> str:
    radius = math.hypot(WIDTH, HEIGHT) / 2 * SCALE_ARCSEC_PX / 3600.0
    stars = catalog.cone(center, radius, epoch_yr=2026.0)  # type: ignore[attr-defined]
    ra, dec = np.radians(stars.ra_deg - center.ra_deg), np.radians(stars.dec_deg)
    dec0 = math.radians(center.dec_deg)
    cosine = np.sin(dec0) * np.sin(dec) + np.cos(dec0) * np.cos(dec) * np.cos(ra)
    xi = np.cos(dec) * np.sin(ra) / cosine
    eta = (np.cos(dec0) * np.sin(dec) - np.sin(dec0) * np.cos(dec) * np.cos(ra)) / cosine
    turn = rng.uniform(0, 2 * math.pi)
    to_px = 206264.806 / SCALE_ARCSEC_PX
    x = WIDTH / 2 + to_px * (-xi * math.cos(turn) + eta * math.sin(turn)) + rng.normal(0, NOISE_PX, xi.size)
    y = HEIGHT / 2 + to_px * (xi * math.sin(turn) + eta * math.cos(turn)) + rng.normal(0, NOISE_PX, xi.size)
    inside = (x > 0) & (x < WIDTH - 1) & (y > 0) & (y < HEIGHT - 1)
    flux = 10 ** (-0.4 * (stars.mag - 15.0)) * rng.normal(1.0, 0.05, xi.size)
    return _text(x[inside], y[inside], flux[inside])


def _text(x: np.ndarray, y: np.ndarray, flux: np.ndarray) -> str:
    # the corners are told, so that the frame's middle is where it was
    lines = [f"{a:.3f},{b:.3f},{c:.4f}" for a, b, c in zip(x, y, flux, strict=True)]
    lines += ["0,0,0.0001", f"{WIDTH - 1},{HEIGHT - 1},0.0001"]
    return "x,y,flux\n" + "\n".join(lines) + "\n"


def _poison(number: int, rng: np.random.Generator) -> str | None:
    kind = (number // POISON_EACH) % 5
    if kind == 0:
        size = 60
        return _text(rng.uniform(0, WIDTH, size), rng.uniform(0, HEIGHT, size), rng.exponential(1.0, size))
    return ["x,y,flux\n", "x,y,flux\n12.0,", "these are my notes\n", None][kind - 1]


def judged(rows: list[dict[str, object]], table: Path) -> dict[str, int]:
    """Count solved, refused, false and poison that was solved.

    Parameters
    ----------
    rows : list of dict
        ``number``, ``solved``, ``ra_deg``, ``dec_deg``, in the order of the table.
    """
    found = {"frames": 0, "solved": 0, "refused": 0, "false": 0, "poison": 0, "poison solved": 0}
    with open(table) as file:
        for row, truth in zip(rows, csv.DictReader(file), strict=True):
            found["frames"] += 1
            found["solved" if row["solved"] else "refused"] += 1
            found["poison"] += truth["poison"] == "1"
            if row["solved"]:
                true = Icrs(float(truth["true_ra_deg"]), float(truth["true_dec_deg"]))
                miss = separation_arcsec(Icrs(float(row["ra_deg"]), float(row["dec_deg"])), true)  # type: ignore[arg-type]
                found["false"] += miss > 5 * SCALE_ARCSEC_PX
                found["poison solved"] += truth["poison"] == "1"
    return found


def main() -> None:
    """Draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lists", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print(draw(asked.folder, asked.lists, asked.seed))


if __name__ == "__main__":
    main()
