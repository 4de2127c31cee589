"""Frames of the telescopes of [S23 §3.1] from an invented deep sky: how many are solved, and how well.

Run: python -m benchmarks.narrow_fields [--preset vihorlat-vnt] [--frames 200] [--catalog gaia] [--seed 1]
     python -m benchmarks.narrow_fields --preset prompt-8 --seed 1 --only 17      # one frame again

The sky is Tycho-2's, and below it an invented one with as many stars as the Galaxy has
(mountnav/simulation/deep_sky.py). The solver gets what a catalog would state of it: "gaia", "ucac4" and
"usno-b1" with their errors, gaps and false stars, packed round the frames; "tycho-2" is the embedded catalog.
Places are even over the sky, some at the poles and at RA 0; rotation, parity, seeing and scale vary, and the
mount errs by some arcminutes. The output is Markdown.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from datetime import datetime
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.narrow_frames import TELESCOPES, Field, Result, chosen_field, instant, result_of, store_for
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.stars import Catalog
from mountnav.identification.accuracy import accuracy_table, deviations, pooled
from mountnav.identification.settings import IdentificationSettings
from mountnav.simulation.sky_kinds import KINDS
from mountnav.solving.settings import SolveSettings

TYCHO = "tycho-2"
BATCH = 20
"""Frames that share a store; more would only cost memory."""
LISTED = 40
"""Of the frames that weren't solved, so many are told of."""
STARS = (0, 6, 10, 15, 25, 50, 100, 300, math.inf)
"""Where the table by the number of catalog stars is cut."""


def results(
    preset: str,
    numbers: list[int],
    *,
    seed: int,
    kind: str,
    radius_deg: float,
    when: datetime,
    settings: SolveSettings,
    jobs: int = 1,
) -> Iterator[Result]:
    """Draw and solve frames.

    Parameters
    ----------
    preset : str
    numbers : list of int
        Which frames.
    seed : int
        Of the sky and the frames.
    kind : str
        The catalog to solve with.
    radius_deg : float
        Of the hints.
    when : datetime
    settings : SolveSettings
    jobs : int
        Processes.
    """
    fields = [chosen_field(preset, seed, number, radius_deg=radius_deg) for number in numbers]
    batches = [fields[at : at + BATCH] for at in range(0, len(fields), BATCH)]
    work = partial(_batch, kind=kind, when=when, settings=settings)
    if jobs == 1:
        for batch in batches:
            yield from work(batch)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for done in pool.map(work, batches):
            yield from done


def _batch(fields: list[Field], *, kind: str, when: datetime, settings: SolveSettings) -> list[Result]:
    """Some frames that share a store."""
    if kind == TYCHO:
        return [result_of(one, embedded_catalog(), when=when, settings=settings) for one in fields]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{kind}.mnc"
        store_for(path, kind, fields)
        catalog: Catalog = PackedStore(path)
        return [result_of(one, catalog, when=when, settings=settings) for one in fields]


def solved_row(preset: str, kind: str, done: list[Result]) -> str:
    """One line of the table of outcomes."""
    outcomes = Counter(one.outcome for one in done)
    solved, wrong = outcomes.pop("solved", 0), outcomes.pop("WRONG", 0)
    refused = ", ".join(f"{name} {n}" for name, n in outcomes.most_common()) or "none"
    cpu = np.array([one.solve_s for one in done])
    off = [one.center_px for one in done if one.outcome == "solved"]
    middle = f"{np.median(off):.3f} / {max(off):.2f}" if off else "-"
    return (
        f"| {preset} | {kind} | {len(done)} | {solved / len(done):.1%} | {wrong} | {refused} | {middle} "
        f"| {np.median(cpu):.2f} / {np.percentile(cpu, 95):.2f} / {cpu.max():.2f} |"
    )


def rows_by_stars(done: list[Result]) -> list[str]:
    """Lines of the table by the number of the catalog's stars in the frame."""
    out = []
    for low, high in pairwise(STARS):
        part = [one for one in done if low <= one.stars < high]
        if part:
            good = sum(one.outcome == "solved" for one in part)
            wrong = sum(one.outcome == "WRONG" for one in part)
            name = f"{low:g} to {high - 1:g}" if math.isfinite(high) else f"{low:g} and more"
            out.append(f"| {name} | {len(part)} | {good} | {wrong} | {len(part) - good - wrong} |")
    return out


def accuracy_rows(preset: str, kind: str, done: list[Result]) -> list[str]:
    """Lines of Table 1 of the paper for these frames."""
    solutions = [one.solution for one in done if one.outcome == "solved" and one.solution is not None]
    out = []
    for row in accuracy_table(pooled([deviations(one) for one in solutions]), (0.0, 5.0, 10.0)):
        for label, one in (("ΔRA cos δ ″", row.ra), ("ΔDec ″", row.dec), ("Δmag", row.mag)):
            out.append(
                f"| {preset} | {kind} | {row.rejected_percent:g} % | {label} | {one.number} "
                f"| {one.mean:+.4f} | {one.standard_deviation:.4f} | {one.least_modulus:.1e} "
                f"| {one.most_modulus:.3f} |"
            )
    return out


def report(runs: dict[tuple[str, str], list[Result]]) -> str:
    """All tables, as Markdown.

    Parameters
    ----------
    runs : dict
        Results by preset and catalog.
    """
    out = [
        "| telescope | catalog | frames | solved | wrong | refused | center off, px: median / worst "
        "| CPU s: median / 95 % / worst |",
        "|---|---|---:|---:|---:|---|---:|---:|",
    ]
    out += [solved_row(*key, done) for key, done in runs.items()]
    for (preset, kind), done in runs.items():
        out += [
            "",
            f"{preset}, {kind}, by the number of the catalog's stars in the frame:",
            "",
            "| stars | frames | solved | wrong | refused |",
            "|---|---:|---:|---:|---:|",
            *rows_by_stars(done),
        ]
    out += [
        "",
        "| telescope | catalog | rejected | deviation | number | mean | st. dev. | min mod. | max mod. |",
        "|---|---|---|---|---:|---:|---:|---:|---:|",
    ]
    for (preset, kind), done in runs.items():
        out += accuracy_rows(preset, kind, done)
    failed = [(kind, one) for (_, kind), done in runs.items() for one in done if one.outcome != "solved"]
    failed.sort(key=lambda which: (which[1].outcome != "WRONG", -which[1].stars))
    if failed:
        out += ["", f"Not solved: {len(failed)}; the wrong ones, then those with the most stars:", ""]
        out += [
            f"- `{one.field.label} --catalog {kind}`: {one.outcome}, {one.stars} catalog stars in the frame, "
            f"{one.measured} measured; {one.told}"
            for kind, one in failed[:LISTED]
        ]
    return "\n".join(out)


def main(arguments: list[str] | None = None) -> int:
    """Run; 1 if an answer was wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", choices=[*TELESCOPES, "all"], default="all")
    parser.add_argument("--catalog", choices=[*KINDS, TYCHO, "all"], default="gaia")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--only", type=int, help="draw only the frame of this number")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--radius", type=float, default=0.25, help="of the hint, degrees")
    parser.add_argument("--epoch", type=float, default=2026.9, help="Julian year of the frames")
    parser.add_argument("--budget", type=float, default=30.0, help="seconds for identification")
    parser.add_argument("--profile", choices=["measured", "paper"], default="measured")
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args(arguments)
    profile = IdentificationSettings.profile(asked.profile)
    settings = SolveSettings(identification=profile, budget_s=asked.budget)
    numbers = list(range(asked.frames)) if asked.only is None else [asked.only]
    runs: dict[tuple[str, str], list[Result]] = {}
    for preset in TELESCOPES if asked.preset == "all" else [asked.preset]:
        for kind in [*KINDS, TYCHO] if asked.catalog == "all" else [asked.catalog]:
            runs[preset, kind] = list(
                results(
                    preset,
                    numbers,
                    seed=asked.seed,
                    kind=kind,
                    radius_deg=asked.radius,
                    when=instant(asked.epoch),
                    settings=settings,
                    jobs=asked.jobs,
                )
            )
    print(report(runs))
    return int(any(one.outcome == "WRONG" for done in runs.values() for one in done))


if __name__ == "__main__":
    raise SystemExit(main())
