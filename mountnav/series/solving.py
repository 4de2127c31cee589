"""Full solutions within a series: first near where it is believed to be, then as the caller says."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.measuring.measurements import Measurements
from mountnav.series.results import SeriesSettings
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Solution, Verdict
from mountnav.solving.solve import solve

SCALE_SHARE = 0.02
"""How well the scale of a series is known once a frame is solved."""
NEAR_BUDGET_S = 10.0
"""Wall time of a full solution where the series is believed to be; then come the caller's hints."""


def solved(
    frame: Frame,
    measurements: Measurements,
    catalog: Catalog,
    settings: SeriesSettings,
    *,
    near: Hint | None,
    hint: Hint | None,
) -> tuple[Verdict, float]:
    """Solve near where it is believed to be, then as caller and header say; the verdict, and the seconds."""
    began = time.perf_counter()
    solving = settings.solving
    verdict = None
    if near is not None:
        quick = replace(solving, budget_s=min(NEAR_BUDGET_S, solving.budget_s))
        verdict = solve(frame, catalog, hint=near, settings=quick, measurements=measurements)
    if verdict is None or not verdict.solved:
        again = solve(frame, catalog, hint=hint, settings=solving, measurements=measurements)
        verdict = again if again.solved or verdict is None else verdict
    return verdict, time.perf_counter() - began


def near_hint(frame: Frame, last: Solution | None, expected: Icrs | None) -> Hint | None:
    """Where the series is believed to be: where it should be by the shift, or where it was last."""
    if last is None:
        return None
    width = float(last.wcs["IMAGEW"])
    scale = last.scale_arcsec_px * width / frame.width_px  # another size is most often another binning
    share = SCALE_SHARE if frame.width_px == int(width) else 0.05
    field_deg = float(np.hypot(frame.width_px, frame.height_px)) * scale / 3600.0
    return Hint(
        center=expected or last.center,
        radius_deg=0.3 * field_deg if expected else max(1.0, 1.5 * field_deg),
        scale_low_arcsec_px=scale * (1.0 - share),
        scale_high_arcsec_px=scale * (1.0 + share),
        center_source="the series",
        scale_source="the series",
    )
