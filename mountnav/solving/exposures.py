"""Photographic plates with several exposures: each one's solution, from the sources that the others leave.

Observers moved the telescope a little between exposures on one plate: the same stars stand there twice or
oftener. An ordinary solve has one answer for a frame: of such a one the middle of its light, or none
(`mountnav.identification.double_exposure`). Here each exposure is asked for by itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint, StarList
from mountnav.identification.selection import star_like
from mountnav.measuring.measure import measure
from mountnav.reading import demosaiced
from mountnav.solution import Solution, Verdict
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import merged_hint, solve_stars

MOST_EXPOSURES = 6
"""Exposures of one plate that are looked for. Doubled, a plate that finds ever more of them takes twice as
long; observers made two to five."""

SAME_OPTICS = 0.01
"""The scale of later exposures is that of the first within this share: only the direction changed."""

ROOM = 1.5
"""A later exposure's center is sought as far as so many diagonals from the first: parts of both are on the
plate. Chosen by hand."""


def solve_exposures(
    frame: Frame,
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SolveSettings | None = None,
    most: int = MOST_EXPOSURES,
) -> tuple[Verdict, ...]:
    """Solve each exposure of a plate.

    Parameters
    ----------
    hint : Hint, optional
        Goes before what the frame's header says, field by field.
    most : int
        So many exposures are looked for.

    Returns
    -------
    tuple of Verdict
        Solved ones, that with the most pairs first or nearly so; the last one tells why no further was found,
        unless `most` were. What was tried for one counts in the odds of the next. They rest on the places of
        sources alone: the note of a star list is theirs, too.
    """
    settings = settings or SolveSettings()
    frame = demosaiced(frame)
    found = measure(frame, settings=settings.measuring)
    left = star_like(found)
    believed = merged_hint(frame.hint, hint)
    verdicts: list[Verdict] = []
    tried = 0
    while len(verdicts) < most:
        stars = StarList(
            found.x_px[left],
            found.y_px[left],
            found.flux[left],
            frame.width_px,
            frame.height_px,
            source=frame.source,
        )
        verdict = solve_stars(
            stars,
            catalog,
            hint=believed,
            settings=settings,
            mid_exposure_utc=frame.mid_exposure_utc,
            tried=tried,
        )
        verdicts.append(verdict)
        solution = verdict.solution
        if solution is None:
            break
        tried = int(verdict.numbers.get("hypotheses", tried))
        pairs = solution.identified
        taken = set(zip(pairs.x_px.tolist(), pairs.y_px.tolist(), strict=True))
        places = zip(found.x_px[left].tolist(), found.y_px[left].tolist(), strict=True)
        left = left[np.array([place not in taken for place in places], dtype=bool)]
        if len(verdicts) == 1:
            believed = _same_optics(solution, frame)
            settings = replace(settings, blind="never")
    return tuple(verdicts)


def _same_optics(solution: Solution, frame: Frame) -> Hint:
    """What the first exposure tells of the others."""
    scale = solution.scale_arcsec_px
    diagonal_deg = float(np.hypot(frame.width_px, frame.height_px)) * scale / 3600.0
    return Hint(
        solution.center,
        ROOM * diagonal_deg,
        scale * (1.0 - SAME_OPTICS),
        scale * (1.0 + SAME_OPTICS),
        center_source="the first exposure",
        scale_source="the first exposure",
    )
