"""Print how well the plate of every rendered frame holds over the whole field, against exact truth.

Run: python -m benchmarks.rendered [--full] [word in the file's name]

--full measures in full, without a glance.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.frames import Known, rendered, shared_folder
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog
from mountnav.reading import read_frame
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs import places_at_pixels
from mountnav.solution import Verdict
from mountnav.solving.solve import SolveSettings, solve


@dataclass(frozen=True, slots=True)
class Score:
    """What a solved rendered frame is worth, in pixels.

    Attributes
    ----------
    name : str
    center_px, center_sigma_px : float
        Error of the center, and what the solution says of it (one sigma per coordinate).
    field_rms_px, worst_px : float
        Of the truth's 100 test points through the solution's WCS.
    pairs, rejected : int
    mode : str
    rms_px : float
        Of the pairs' residuals.
    rejected_by : dict
    time_s : float
    """

    name: str
    center_px: float
    center_sigma_px: float
    field_rms_px: float
    worst_px: float
    pairs: int
    rejected: int
    mode: str
    rms_px: float
    rejected_by: dict[str, int]
    time_s: float


def truths(shared: Path) -> dict[str, dict[str, list[float]]]:
    """The test points (x, y, ra, dec) of every rendered frame, by file name."""
    entries = json.loads((shared / "data" / "rendered" / "truth.json").read_text())
    return {one["file"]: one["test"] for one in entries}


def field_errors_px(
    cards: dict[str, str | int | float], test: dict[str, list[float]], scale: float
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Distances (px, shape (n,)) on the sky between WCS and truth at the test points."""
    ra, dec = places_at_pixels(cards, np.array(test["x"]), np.array(test["y"]))
    true_ra, true_dec = np.array(test["ra"]), np.array(test["dec"])
    one, other = (
        np.stack((np.cos(d) * np.cos(r), np.cos(d) * np.sin(r), np.sin(d)))
        for r, d in ((np.radians(ra), np.radians(dec)), (np.radians(true_ra), np.radians(true_dec)))
    )
    chord = np.linalg.norm(one - other, axis=0)
    errors: np.ndarray[tuple[int], np.dtype[np.float64]] = (
        np.degrees(2 * np.arcsin(0.5 * chord)) * 3600.0 / scale
    )
    return errors


def score(
    known: Known, test: dict[str, list[float]], catalog: Catalog, settings: SolveSettings | None = None
) -> Score | Verdict:
    """Solve one rendered frame and compare; the verdict itself when it was refused."""
    verdict = solve(read_frame(known.path), catalog, hint=known.hint, settings=settings)
    solution = verdict.solution
    if solution is None or known.center is None or known.scale_arcsec_px is None:
        return verdict
    scale = known.scale_arcsec_px
    errors = field_errors_px(solution.wcs, test, scale)
    return Score(
        name=known.path.name.split(".")[0],
        center_px=separation_arcsec(solution.center, known.center) / scale,
        center_sigma_px=solution.center_sigma_arcsec / scale,
        field_rms_px=float(np.sqrt(np.mean(errors**2))),
        worst_px=float(errors.max()),
        pairs=solution.pairs,
        rejected=solution.rejected,
        mode=solution.mode,
        rms_px=solution.rms_arcsec / scale,
        rejected_by=solution.rejected_by,
        time_s=verdict.times.total_s,
    )


def main() -> None:
    words = [one for one in sys.argv[1:] if one != "--full"]
    word, settings = words[0] if words else "", SolveSettings(glance="--full" not in sys.argv)
    shared, catalog = shared_folder(), embedded_catalog()
    points = truths(shared)
    titles = (
        "frame, center error px, its sigma px, field rms px, worst px, pairs, model, pairs' rms px, time s"
    )
    print("| " + titles.replace(", ", " | ") + " | rejected by |")
    print("|---" * 10 + "|")
    scores: list[Score] = []
    for known in rendered(shared):
        if word not in known.path.name:
            continue
        got = score(known, points[known.path.name], catalog, settings)
        if isinstance(got, Verdict):
            print(f"| {known.path.name} | {got.reason}: {got.detail} |", flush=True)
            continue
        scores.append(got)
        why = ", ".join(f"{rule} {count}" for rule, count in got.rejected_by.items() if count)
        print(
            f"| {got.name} | {got.center_px:.4f} | {got.center_sigma_px:.4f} | {got.field_rms_px:.4f} | "
            f"{got.worst_px:.4f} | {got.pairs} | {got.mode.removeprefix('full/')} | {got.rms_px:.3f} | "
            f"{got.time_s:.2f} | {why} |",
            flush=True,
        )
    judged = [one for one in scores if one.name[0] in "ABCE"]
    if judged:
        center = float(np.median([one.center_px for one in judged]))
        rms = float(np.median([one.field_rms_px for one in judged]))
        worst = max(one.worst_px for one in judged)
        print(
            f"\nA, B, C, E, {len(judged)} frames: center error median {center:.4f} px (reach 0.02), "
            f"field rms median {rms:.4f} px (reach 0.01), worst test point {worst:.4f} px (reach 0.1)"
        )


if __name__ == "__main__":
    main()
