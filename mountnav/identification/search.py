"""Star lists in, a verified reference or a typed refusal out: hypotheses, plate, odds, in that order."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mountnav.catalog.stars import Catalog, Stars
from mountnav.frames import Hint
from mountnav.identification.area import WIDEST_DEG, stars_round
from mountnav.identification.confirmation import Witnesses
from mountnav.identification.full import Hypothesis, OutOfTime, Points, Search, hypotheses, match_radius
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.selection import Index, all_finite, star_like
from mountnav.identification.settings import IdentificationSettings, Stage
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Reason

SCALE_LEAST_ARCSEC_PX = 0.3
SCALE_MOST_ARCSEC_PX = 200.0
SCALE_STEP = 1.6
"""With no scale given, it is sought in windows this wide."""
PLATE_STARS = 1000
"""Stars fetched for the plate, brightest first."""
WIDER = 1.3
"""When the hinted scale fails, its bounds are widened by this factor once."""


@dataclass(frozen=True, slots=True)
class Identified:
    """What came of a search.

    Attributes
    ----------
    reference : Reference or None
    stars : Stars or None
        The list that `reference.pairs.star` points into.
    reason : Reason or None
    detail : str
        The numbers behind it.
    false_probability : float
        Chance that a wrong place would have looked as good: that of one hypothesis times all plates tried.
    """

    reference: Reference | None
    stars: Stars | None
    reason: Reason | None
    detail: str
    false_probability: float = 1.0


def scale_windows(hint: Hint) -> list[tuple[float, float]]:
    """Bounds of the scale to be tried in turn, arcsec per pixel.

    Parameters
    ----------
    hint : Hint

    Returns
    -------
    list of (float, float)
        The hinted bounds and then wider ones; without a hint windows of `SCALE_STEP` over the whole range,
        the coarsest first: it
        has the fewest tiles.
    """
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if low is not None and high is not None:
        return [(low, high), (low / WIDER, high * WIDER)]
    least = low if low is not None else SCALE_LEAST_ARCSEC_PX
    most = high if high is not None else SCALE_MOST_ARCSEC_PX
    steps = max(1, math.ceil(math.log(most / least) / math.log(SCALE_STEP)))
    edges = [least * (most / least) ** (i / steps) for i in range(steps + 1)]
    windows = list(pairwise(edges))
    return windows[::-1]


def identify(
    measurements: Measurements,
    catalog: Catalog,
    hint: Hint,
    *,
    epoch_yr: float,
    settings: IdentificationSettings | None = None,
    budget_s: float = 30.0,
) -> Identified:
    """Find out which stars the measurements are.

    Parameters
    ----------
    measurements : Measurements
    catalog : Catalog
    hint : Hint
        `center` must be known.
    epoch_yr : float
        Julian year of the frame.
    settings : IdentificationSettings, optional
    budget_s : float
        Wall time allowed.

    Returns
    -------
    Identified
        With a reference whose false-positive probability is below the limit, or with a reason.
    """
    settings = settings or IdentificationSettings()
    if hint.center is None:
        return Identified(
            None, None, Reason.NO_HINT, "no assumed center; searching the whole sky is not built"
        )
    clean, every = star_like(measurements), all_finite(measurements)
    if every.size < settings.min_pairs:
        return Identified(
            None,
            None,
            Reason.TOO_FEW_MEASUREMENTS,
            f"{every.size} stars measured, {settings.min_pairs} needed: expose longer, check focus, cap",
        )
    search = Search(deadline_s=time.monotonic() + budget_s)
    try:
        for usable, window, stage in _plan(clean, every, hint, settings):
            found = _attempt(
                measurements,
                usable,
                stage,
                catalog,
                hint.center,
                hint.radius_deg,
                window,
                epoch_yr,
                settings,
                search,
            )
            if found is not None:
                return found
    except OutOfTime:
        return Identified(
            None,
            None,
            Reason.TIMED_OUT,
            f"{budget_s:.0f} s spent on {search.tiles_tried} tiles and {search.hypotheses} hypotheses; "
            "a closer center or scale makes it faster",
        )
    return _refusal(measurements, search, settings, hint)


def _plan(
    clean: Index, every: Index, hint: Hint, settings: IdentificationSettings
) -> list[tuple[Index, tuple[float, float], Stage]]:
    """What is tried in turn: which measurements, which bounds of the scale, how many stars."""
    windows = scale_windows(hint)
    if hint.scale_low_arcsec_px is None or hint.scale_high_arcsec_px is None:
        # the cheap stage over all scales before the dear one over any
        return [(clean, window, stage) for stage in settings.stages for window in windows]
    plan = [(clean, windows[0], stage) for stage in settings.stages]
    if clean.size < every.size:  # a sharp frame's stars may all look like hot pixels
        plan += [(every, windows[0], stage) for stage in settings.stages]
    return plan + [(clean, window, stage) for window in windows[1:] for stage in settings.stages]


def _refusal(
    measurements: Measurements, search: Search, settings: IdentificationSettings, hint: Hint
) -> Identified:
    tried = f"{len(measurements)} measurements, {search.tiles_tried} tiles, {search.hypotheses} hypotheses"
    if search.frame_triangles == 0:
        return Identified(
            None,
            None,
            Reason.TOO_FEW_MEASUREMENTS,
            f"{len(measurements)} measurements make no triangle large enough: expose longer, check focus",
        )
    if search.most_stars < settings.min_pairs:
        return Identified(
            None,
            None,
            Reason.TOO_FEW_CATALOG_STARS,
            f"the catalog has at most {search.most_stars} stars in a field this size here, "
            f"{settings.min_pairs} are needed: a deeper catalog or a wider field",
        )
    if search.best_probability < 1e-3:
        return Identified(
            None,
            None,
            Reason.CHANCE,
            f"the best match has a false-positive probability of {search.best_probability:.1e}, "
            f"allowed is {settings.false_probability_max:.0e} ({tried})",
            search.best_probability,
        )
    return Identified(
        None,
        None,
        Reason.NO_MATCH,
        f"{tried} within {hint.radius_deg:g}° of the assumed center",
        search.best_probability,
    )


def _attempt(
    measurements: Measurements,
    usable: Index,
    stage: Stage,
    catalog: Catalog,
    center: Icrs,
    radius_deg: float,
    window: tuple[float, float],
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
) -> Identified | None:
    """One window of scales and one choice of measurements."""
    width, height = measurements.width_px, measurements.height_px
    if usable.size < settings.min_pairs or math.hypot(width, height) * window[0] / 3600 > WIDEST_DEG:
        return None
    points = Points(measurements.x_px[usable], measurements.y_px[usable], width, height)
    proposals: Iterator[Hypothesis] = hypotheses(
        points,
        stage,
        catalog,
        center,
        radius_deg,
        *window,
        epoch_yr=epoch_yr,
        settings=settings,
        search=search,
    )
    for one in proposals:
        found = _verified(one, measurements, usable, catalog, epoch_yr, settings, search)
        if found is not None:
            return found
    return None


def _verified(
    one: Hypothesis,
    measurements: Measurements,
    usable: Index,
    catalog: Catalog,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
) -> Identified | None:
    """Grow the plate of a hypothesis and ask what the odds of the outcome are."""
    width, height = measurements.width_px, measurements.height_px
    diagonal_deg = math.hypot(width, height) * one.plate.scale_arcsec_px() / 3600
    stars = stars_round(catalog, one.plate.center(), 0.52 * diagonal_deg, PLATE_STARS, epoch_yr=epoch_yr)
    if len(stars) < settings.min_pairs:
        return None
    selection = Selection(measurements, usable, stars, settings)
    strobe_px = match_radius(settings, width, height)
    reference = selection.grow(one.plate, strobe_px)
    if reference is None:
        return None
    if not _sound(reference, selection, measurements, one, settings, strobe_px):
        return None
    witnesses = Witnesses(
        one.plate,
        one.corners,
        stars,
        measurements.x_px[usable],
        measurements.y_px[usable],
        width_px=width,
        height_px=height,
        match_px=strobe_px,
    )
    probability = min(1.0, witnesses.chance() * search.hypotheses)
    search.best_probability = min(search.best_probability, probability)
    if probability > settings.false_probability_max:
        return None
    return Identified(
        reference,
        stars,
        None,
        f"{len(reference.pairs)} pairs, {reference.rejected} rejected, {search.hypotheses} hypotheses, "
        f"{search.tiles_tried} tiles",
        probability,
    )


def _sound(
    reference: Reference,
    selection: Selection,
    measurements: Measurements,
    one: Hypothesis,
    settings: IdentificationSettings,
    strobe_px: float,
) -> bool:
    """Whether the final plate is still a camera's, and rests on pairs from more than a corner."""
    pairs, plate = reference.pairs, reference.plate
    if len(pairs) < settings.min_pairs or plate.parity != one.plate.parity:
        return False
    x, y = measurements.x_px[pairs.measurement], measurements.y_px[pairs.measurement]
    frame = min(measurements.width_px, measurements.height_px)
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(np.vstack((x, y)))))
    if spread[0] < 0.05 * frame:
        return False
    singular = np.linalg.svd(plate.matrix(), compute_uv=False)
    if singular[1] < (1 - 2 * settings.skew_max) * singular[0]:
        return False
    if abs(math.log(plate.scale_arcsec_px() / one.plate.scale_arcsec_px())) > 0.05:
        return False
    rms_px = (
        float(np.sqrt(np.mean(reference.dxi_arcsec**2 + reference.deta_arcsec**2))) / plate.scale_arcsec_px()
    )
    if rms_px > 0.5 * strobe_px:
        return False
    # of few stars nearly all must be there; of many a fair share
    return len(pairs) >= 0.5 * settings.min_share * min(selection.allowed(plate), 100)
