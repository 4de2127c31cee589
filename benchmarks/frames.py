"""Print a table of every shared frame: solved or why not, error against the truth, pairs, odds, time.

Run: python -m benchmarks.frames [rendered|real|all] [word in the file's name] [--profile paper] [--budget 5]

The budget is in seconds of processor time, for identification.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
from dataclasses import dataclass, replace
from pathlib import Path

from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.settings import IdentificationSettings
from mountnav.reading import read_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.solve import SolveSettings, solve

SEED = 20230511


@dataclass(frozen=True, slots=True)
class Known:
    """A frame whose place is known.

    Attributes
    ----------
    path : Path
    center : Icrs or None
        Truth for the geometric center; None where the frame must not solve.
    scale_arcsec_px : float or None
    uncertainty_arcsec : float
        Of the truth.
    grade : str
        The manifest's grade, or "R" for a rendered frame.
    field_deg : float
        The shorter side.
    hint : Hint
        What to ask with.
    parity : int or None
    """

    path: Path
    center: Icrs | None
    scale_arcsec_px: float | None
    uncertainty_arcsec: float
    grade: str
    field_deg: float
    hint: Hint
    parity: int | None = None

    def error_px(self, verdict: Verdict) -> float:
        """Distance of the solved center from the truth, in pixels."""
        if verdict.solution is None or self.center is None or self.scale_arcsec_px is None:
            return math.nan
        return separation_arcsec(verdict.solution.center, self.center) / self.scale_arcsec_px

    def allowed_px(self) -> float:
        """How far off counts as right: 3 px or the truth's uncertainty; 1 px for rendered frames."""
        if self.grade == "R" or self.scale_arcsec_px is None:
            return 1.0
        return max(3.0, self.uncertainty_arcsec / self.scale_arcsec_px)


def shared_folder() -> Path:
    """Where the measured data lie."""
    return Path(os.environ.get("MOUNTNAV_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def rendered(shared: Path) -> list[Known]:
    """The rendered frames, with the hints of their truth.json: radius 1°, scale ±5 %."""
    folder = shared / "data" / "rendered"
    known = []
    for one in json.loads((folder / "truth.json").read_text()):
        hint = one["hint"]
        known.append(
            Known(
                path=folder / one["file"],
                center=Icrs(one["ra"], one["dec"]),
                scale_arcsec_px=one["scale"],
                uncertainty_arcsec=0.0,
                grade="R",
                field_deg=min(one["w"], one["h"]) * one["scale"] / 3600,
                hint=Hint(Icrs(hint["ra"], hint["dec"]), 1.0, hint["scale"] / 1.05, hint["scale"] * 1.05),
            )
        )
    return known


def real(shared: Path) -> list[Known]:
    """The real frames; the hint is the truth moved by up to 0.2° each way, the scale within 3 %."""
    folder = shared / "data" / "frames"
    chance = random.Random(SEED)
    known = []
    for one in json.loads((folder / "manifest.json").read_text())["frames"]:
        east, north, stretch = (
            chance.uniform(-720, 720),
            chance.uniform(-720, 720),
            chance.uniform(0.98, 1.02),
        )
        grade = one["truth_grade"]
        center = (
            Icrs(one["ra_deg"], one["dec_deg"]) if one.get("ra_deg") is not None and grade != "N" else None
        )
        scale = one.get("scale_arcsec")
        hint = (
            Hint(Icrs(83.8, -5.4), 1.0, 2.0, 4.0)
            if center is None
            else Hint(displaced(center, east, north), 0.5)
        )
        if center is not None and scale is not None:
            hint = replace(
                hint, scale_low_arcsec_px=scale * stretch * 0.97, scale_high_arcsec_px=scale * stretch * 1.03
            )
        known.append(
            Known(
                path=folder / one["file"],
                center=center,
                scale_arcsec_px=scale,
                uncertainty_arcsec=one.get("truth_uncertainty_arcsec") or 0.0,
                grade=grade,
                field_deg=min(one.get("fov_deg") or [0.0]),
                hint=hint,
                parity={"normal": 1, "flipped": -1}.get(one.get("parity") or ""),
            )
        )
    return known


def read(known: Known) -> Frame | BadFrame:
    """The frame, or why it can't be read."""
    try:
        return read_frame(known.path)
    except BadFrame as fault:
        return fault


def asked(known: Known, frame: Frame) -> Hint:
    """The hint to ask with: the header's center and scale where they are sane, else the table's."""
    hint, header = known.hint, frame.hint
    if known.grade == "R" or known.center is None:
        return hint
    if header.center is not None:
        off_deg = separation_arcsec(header.center, known.center) / 3600
        if off_deg < max(1.0, header.radius_deg):
            hint = replace(hint, center=header.center, radius_deg=max(1.0, header.radius_deg))
    low, high, true = header.scale_low_arcsec_px, header.scale_high_arcsec_px, known.scale_arcsec_px
    if low is not None and high is not None and (true is None or low < true < high):
        hint = replace(hint, scale_low_arcsec_px=low, scale_high_arcsec_px=high)
    return hint


def row(known: Known, settings: SolveSettings | None = None) -> str:
    """Solve a frame and write a line of the table."""
    frame = read(known)
    start = f"| {'/'.join(known.path.parts[-2:])} | {known.grade} | {known.field_deg:.2f}"
    if isinstance(frame, BadFrame):
        return f"{start} | unreadable | | | | | | | {frame} |"
    verdict = solve(frame, embedded_catalog(), hint=asked(known, frame), settings=settings)
    times = verdict.times
    end = f"{times.measure_s:.2f} | {times.identify_s:.2f} | {verdict.measured}: {verdict.detail} |"
    solution, error = verdict.solution, known.error_px(verdict)
    if solution is None:
        return f"{start} | {verdict.reason} | | | | | {end}"
    right = "?" if math.isnan(error) else ("yes" if error <= known.allowed_px() else "WRONG")
    if known.parity is not None and known.parity != solution.parity:
        right += " parity!"
    pairs = f"{solution.pairs} {solution.mode}"
    fit = f"{error:.2f} | {pairs} | {solution.rms_arcsec:.2f} | {solution.false_probability:.0e}"
    return f"{start} | {right} | {fit} | {end}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("which", nargs="?", choices=["rendered", "real", "all"], default="all")
    parser.add_argument("word", nargs="?", default="")
    parser.add_argument("--profile", choices=["measured", "paper"], default="measured")
    parser.add_argument("--budget", type=float, default=30.0)
    arguments = parser.parse_args()
    which, word = arguments.which, arguments.word
    settings = SolveSettings(
        identification=IdentificationSettings.profile(arguments.profile), budget_s=arguments.budget
    )
    shared = shared_folder()
    titles = "frame, grade, field °, solved, error px, pairs, rms ″, p false, measure s, identify s, detail"
    print("| " + titles.replace(", ", " | ") + " |")
    print("|---" * 11 + "|")
    for known in (rendered(shared) if which != "real" else []) + (
        real(shared) if which != "rendered" else []
    ):
        if word in str(known.path):
            print(row(known, settings), flush=True)


if __name__ == "__main__":
    main()
