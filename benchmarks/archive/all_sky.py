"""All-sky frames through an archive: drawn, listed with hints, solved by `archive work`, held to the truth.

    python -m benchmarks.archive.all_sky [--frames 6] [--first 2]

The frames are the hinted ones of `benchmarks.wide_fields` whose field is 100° or wider: planets, the Moon's
glow, in some a horizon. One more holds noise alone. A solution is false whose median error over the field is
above 5 px; the errors are those of the model that the archive keeps (``wcs`` of ``solutions``).
"""

from __future__ import annotations

import argparse
import csv
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import count, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.wide_fields import UTC_OF_ALL, Wide, drawn_frame, drawn_lens
from mountnav.archive.folder import Folder
from mountnav.archive.tables import read_rows
from mountnav.sky.wcs import places_at_pixels

LEAST_FIELD_DEG = 100.0
FALSE_PX = 5.0
"""A match of other stars is off by hundreds of pixels; doubled, the same would be found false."""


def lenses(first: int) -> Iterator[Wide]:
    """The hinted ones that see so much, from a seed on."""
    for seed in count(first + first % 2, 2):
        wide = drawn_lens(seed)
        if float(wide.name.split()[-1].rstrip("°")) >= LEAST_FIELD_DEG:
            yield wide


def errors_px(wide: Wide, cards: dict[str, object]) -> NDArray[np.float64]:
    """Of a grid over the sky in the frame; NaN where the model says that there is none."""
    x, y = (
        side.ravel()
        for side in np.meshgrid(np.linspace(0, wide.width_px - 1, 21), np.linspace(0, wide.height_px - 1, 21))
    )
    sky = wide.sky(x, y)
    x, y = x[sky], y[sky]
    ra, dec = places_at_pixels(cards, x, y)  # type: ignore[arg-type]
    known = np.isfinite(ra)
    true_x, true_y = wide.pixels(np.where(known, ra, 0.0), np.where(known, dec, 0.0))
    return np.where(known, np.hypot(true_x - x, true_y - y), np.nan)


def write(where: Path, drawn: list[Wide]) -> Path:
    """Frames and their table."""
    from astropy.io import fits

    table = where / "frames.csv"
    with open(table, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(
            ["file", "ra_deg", "dec_deg", "radius_deg", "scale_low_arcsec_px", "scale_high_arcsec_px"]
        )
        for at, wide in enumerate([*drawn, drawn[0]]):
            hint = wide.hint()
            assert hint is not None
            assert hint.center is not None
            pixels = np.asarray(drawn_frame(wide).pixels)
            if at == len(drawn):
                pixels = np.random.default_rng(1).normal(1000.0, 10.0, pixels.shape)
            card = fits.Header({"DATE-OBS": UTC_OF_ALL.strftime("%Y-%m-%dT%H:%M:%S"), "EXPTIME": 0.0})
            fits.PrimaryHDU(np.clip(pixels, 0, 65535).astype(np.uint16), card).writeto(where / f"{at}.fits")
            scales = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
            rows.writerow([f"{at}.fits", hint.center.ra_deg, hint.center.dec_deg, hint.radius_deg, *scales])
    return table


def main() -> None:
    """Draw, solve, judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--first", type=int, default=2)
    told = parser.parse_args()
    drawn = list(islice(lenses(told.first), told.frames))
    with tempfile.TemporaryDirectory() as there:
        table, archive = write(Path(there), drawn), Path(there) / "archive"
        command = [sys.executable, "-m", "api.main", "archive"]
        subprocess.run([*command, "init", archive, "--frames", table, "--no-blind"], check=True)
        began_s = children_s()
        subprocess.run([*command, "work", archive], check=True)
        spent_s = children_s() - began_s
        subprocess.run([*command, "verify", archive], check=True)
        run = Folder.open(archive).run(None)
        solved = {row["number"]: row for row in read_rows(run.chunk(0) / "solutions.parquet")}
        refused = {row["number"]: row for row in read_rows(run.chunk(0) / "refusals.parquet")}
        false = 0
        for at, wide in enumerate(drawn):
            if at not in solved:
                print(f"{wide.name}: {refused[at]['reason']}")
                continue
            errors = errors_px(wide, json.loads(str(solved[at]["wcs"])))
            false += not np.nanmedian(errors) < FALSE_PX
            print(
                f"{wide.name}: {solved[at]['mode']}, {solved[at]['pairs']} pairs, error median "
                f"{np.nanmedian(errors):.2f} px, worst {np.nanmax(errors):.2f} px, "
                f"{100 * np.isfinite(errors).mean():.0f} % of the sky"
            )
        false += len(drawn) in solved  # noise alone
        found = len(set(solved) - {len(drawn)})
        print(
            f"{found} of {len(drawn)} solved, {false} false; {spent_s / (len(drawn) + 1):.1f} CPU s a frame"
        )


def children_s() -> float:
    """CPU time of all that was started here and has ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
