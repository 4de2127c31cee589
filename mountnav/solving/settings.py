"""Settings of a solve, without the code that solves: callers who only pass them on import nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Literal

from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.settings import MeasuringSettings
from mountnav.solving.priors import CameraPrior

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.measuring.calibration import Calibration


MOST_EXPOSURES = 6
"""Exposures of one plate that are looked for. Doubled, a plate that finds ever more of them takes twice as
long; observers made two to five."""


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """Settings of a solve.

    Attributes
    ----------
    budget_s : float
        Processor time for identification; measuring comes on top. It never takes longer than
        `mountnav.identification.budget.wall_limit_s` of it.
    calibration : Calibration or None
        Masters that frames are freed from the camera's own signal with.
    index : BlindIndex or None
        For searching the whole sky; without one no blind search takes place.
    blind : {"after", "only", "never"}
        Search the whole sky after the hint failed; at once, without asking any hint; or not at all.
    glance : bool
        Try with a glance first: the brightest sources, found coarsely, and then precise centroids of the
        identified ones only. What a glance doesn't solve is measured in full.
    undated_utc : datetime or None
        When a frame was taken whose date nobody knows, so that its answer is the same on any day; None: now.
    priors : tuple of CameraPrior
        What is known of cameras from frames that were solved before.
    exposures : int
        Above 1 each frame is taken for a photographic plate, negative or not, and so many exposures sought
        on it: see `mountnav.solving.exposures`.
    """

    measuring: MeasuringSettings = field(default_factory=MeasuringSettings)
    identification: IdentificationSettings = field(default_factory=IdentificationSettings)
    budget_s: float = 30.0
    calibration: Calibration | None = None
    index: BlindIndex | None = None
    blind: Literal["after", "only", "never"] = "after"
    glance: bool = True
    undated_utc: datetime | None = None
    priors: tuple[CameraPrior, ...] = ()
    exposures: int = 1
