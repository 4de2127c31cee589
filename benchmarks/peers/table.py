"""The comparison as a markdown table, and as records for programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.peers.mountnav_resident import RESIDENT
from benchmarks.peers.running import Attempt, Job

TITLES = (
    "frames",
    "asked",
    "solver",
    "solved",
    "wrong",
    "CPU s median",
    "times resident",
    "wall s median",
    "wall s p95",
    "peak MB",
    "own MB",
    "error px median",
)


@dataclass(frozen=True, slots=True)
class Done:
    """An attempt, and what it was at."""

    job: Job
    blind: bool
    solver: str
    attempt: Attempt

    @property
    def asked(self) -> str:
        """The word for the mode."""
        return "blind" if self.blind else "hinted"

    def record(self) -> dict[str, Any]:
        """Everything as plain values."""
        attempt, job = self.attempt, self.job
        return {
            "frame": job.name,
            "preset": job.preset,
            "catalog_stars": job.catalog_stars,
            "asked": self.asked,
            "solver": self.solver,
            "solved": attempt.found is not None,
            "wrong": attempt.wrong(job),
            "error_px": attempt.error_px(job),
            "cpu_s": attempt.cpu_s,
            "wall_s": attempt.wall_s,
            "peak_mb": attempt.peak_mb,
            "own_mb": attempt.own_mb,
            "identify_s": attempt.identify_s,
            "note": attempt.note,
        }


def rows(done: list[Done]) -> list[str]:
    """Lines of a markdown table: one for each kind of frames, mode and solver, in the order they came."""
    groups: dict[tuple[str, str, str], list[Done]] = {}
    for one in sorted(done, key=lambda one: one.blind):
        groups.setdefault((one.job.preset, one.asked, one.solver), []).append(one)
    presets = list(dict.fromkeys(one.job.preset for one in done))
    lines = ["| " + " | ".join(TITLES) + " |", "|---" * len(TITLES) + "|"]
    for key in sorted(groups, key=lambda key: presets.index(key[0])):
        resident = groups.get((key[0], key[1], RESIDENT))
        lines.append(_row(key, groups[key], resident))
    return lines


def _row(key: tuple[str, str, str], group: list[Done], resident: list[Done] | None) -> str:
    attempts = [one.attempt for one in group]
    right = [one for one in group if one.attempt.found is not None and not one.attempt.wrong(one.job)]
    wrong = sum(one.attempt.wrong(one.job) for one in group)
    errors = [error for one in right if (error := one.attempt.error_px(one.job)) is not None]
    cpu_s = _median(attempts, lambda one: one.cpu_s)
    wall_s = [one.wall_s for one in attempts]
    own_mb = [one.own_mb for one in attempts if one.own_mb is not None]
    ratio = ""
    if resident is not None:
        ratio = f"{cpu_s / _median([one.attempt for one in resident], lambda one: one.cpu_s):.1f}"
    cells = (
        *key,
        f"{len(right)}/{len(group)}",
        f"{wrong}",
        f"{cpu_s:.3f}",
        ratio,
        f"{float(np.median(wall_s)):.3f}",
        f"{float(np.percentile(wall_s, 95)):.3f}",
        f"{max(one.peak_mb for one in attempts):.0f}",
        f"{max(own_mb):.0f}" if own_mb else "",
        f"{float(np.median(errors)):.3f}" if errors else "",
    )
    return "| " + " | ".join(cells) + " |"


def _median(attempts: list[Attempt], what: Callable[[Attempt], float]) -> float:
    return float(np.median([what(one) for one in attempts]))
