"""Star lists in, a verified reference or a typed refusal out: hypotheses, plate, odds, in that order."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from mountnav.catalog.stars import Catalog, Stars
from mountnav.frames import Hint
from mountnav.identification.area import WIDEST_DEG, stars_round
from mountnav.identification.confirmation import Witnesses
from mountnav.identification.full import Hypothesis, OutOfTime, Points, Search, hypotheses, match_radius
from mountnav.identification.odds import looks
from mountnav.identification.paper import published_share
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.refusal import Refusal, refusal
from mountnav.identification.rounds import Round, plan
from mountnav.identification.selection import Index, all_finite, star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Contradiction, Reason

PLATE_STARS = 1000
"""Stars fetched for the plate, brightest first."""
CENTER_SIGMA_PX = 2.0
"""A plate that leaves the frame's center less certain than this rests on a corner and is refused."""


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
        For people.
    false_probability : float
        Chance that a wrong place would have looked as good: that of one hypothesis times all that were tried.
    numbers : dict of str to float
        The numbers behind it.
    contradictions : tuple of Contradiction
        Hints that disprove each other. Who has the solution compares it with the hints
        (`mountnav.contradictions`).
    """

    reference: Reference | None
    stars: Stars | None
    reason: Reason | None
    detail: str
    false_probability: float = 1.0
    numbers: dict[str, float] = field(default_factory=dict)
    contradictions: tuple[Contradiction, ...] = ()


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
        Its `center`, or that of one of its alternatives, must be known. What it says is tried first, then its
        alternatives, then what may be if it is wrong: other scales, places farther out.
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
    believed = [_reconciled(one) for one in (hint, *hint.alternatives) if one.center is not None]
    if not believed:
        return _refused(
            Refusal(Reason.NO_HINT, "no assumed center; searching the whole sky is not built"), 1.0, ()
        )
    search = Search(deadline_s=time.monotonic() + budget_s)
    clean, every = star_like(measurements), all_finite(measurements)
    late: float | None = None
    try:
        if every.size >= settings.min_pairs:
            for center, turn in _turns(believed, measurements, settings, flagged=clean.size < every.size):
                usable = every if turn.flagged else clean
                found = _attempt(measurements, usable, turn, catalog, center, epoch_yr, settings, search)
                if found is not None:
                    return found
    except OutOfTime:
        late = budget_s
    empty = _empty_bounds(hint)
    if empty and late is None:
        return _refused(
            Refusal(
                Reason.HINT_CONTRADICTS,
                f"{empty[0]}; and with the scale unknown nothing matches",
                {
                    "scale_low_arcsec_px": hint.scale_low_arcsec_px or 0.0,
                    "scale_high_arcsec_px": hint.scale_high_arcsec_px or 0.0,
                    "measured": float(len(measurements)),
                },
            ),
            search.best_probability,
            empty,
        )
    why = refusal(measurements, catalog, believed[0], search, settings, epoch_yr=epoch_yr, out_of_time_s=late)
    return _refused(why, search.best_probability, empty)


def _refused(why: Refusal, probability: float, disproved: tuple[Contradiction, ...]) -> Identified:
    return Identified(None, None, why.reason, why.detail, probability, why.numbers, disproved)


def _empty_bounds(hint: Hint) -> tuple[Contradiction, ...]:
    """Say so, if no scale lies between the bounds."""
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if low is None or high is None or 0 < low <= high:
        return ()
    return (
        Contradiction(
            "scale", hint.scale_source, f"at least {low:g} ″/px", f"at most {high:g} ″/px is said too"
        ),
    )


def _reconciled(hint: Hint) -> Hint:
    """The hint without bounds that rule each other out: the scale is unknown then."""
    if not _empty_bounds(hint):
        return hint
    return replace(hint, scale_low_arcsec_px=None, scale_high_arcsec_px=None)


def _turns(
    believed: list[Hint], measurements: Measurements, settings: IdentificationSettings, *, flagged: bool
) -> Iterator[tuple[Icrs, Round]]:
    """Centers and rounds as they are tried: what each hint says, then what may be if it is wrong."""
    shorter_px = min(measurements.width_px, measurements.height_px)
    plans = [(one, plan(one, shorter_px, settings, flagged=flagged)) for one in believed]
    for part in range(3):
        for one, parts in plans:
            for turn in parts[part]:
                if one.center is not None:
                    yield one.center, turn


def _attempt(
    measurements: Measurements,
    usable: Index,
    turn: Round,
    catalog: Catalog,
    center: Icrs,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
) -> Identified | None:
    """One round."""
    width, height = measurements.width_px, measurements.height_px
    if usable.size < settings.min_pairs or math.hypot(width, height) * turn.scales[0] / 3600 > WIDEST_DEG:
        return None
    points = Points(measurements.x_px[usable], measurements.y_px[usable], width, height)
    proposals: Iterator[Hypothesis] = hypotheses(
        points, turn, catalog, center, epoch_yr=epoch_yr, settings=settings, search=search
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
    """Ask what the odds of a hypothesis are, and grow its plate."""
    width, height = measurements.width_px, measurements.height_px
    x, y = measurements.x_px[usable], measurements.y_px[usable]
    diagonal_deg = math.hypot(width, height) * one.plate.scale_arcsec_px() / 3600
    stars = stars_round(catalog, one.plate.center(), 0.52 * diagonal_deg, PLATE_STARS, epoch_yr=epoch_yr)
    if len(stars) < settings.min_pairs:
        return None
    if settings.v_min_ident is not None:
        share = published_share(one.plate, stars, x, y, width_px=width, height_px=height, settings=settings)
        search.most_published = max(search.most_published, share)
        if share < settings.v_min_ident:
            return None
    strobe_px = match_radius(settings, width, height)
    witnesses = Witnesses(
        one.plate, one.corners, stars, x, y, width_px=width, height_px=height, match_px=strobe_px
    )
    probability = min(1.0, witnesses.chance() * looks(search.hypotheses))
    if probability > settings.false_probability_max:
        search.best_probability = min(search.best_probability, probability)
        return None
    selection = Selection(measurements, usable, stars, settings)
    reference = selection.grow(one.plate, strobe_px)
    if reference is None or not _sound(reference, selection, measurements, one, settings, strobe_px):
        return None
    numbers = {
        "pairs": float(len(reference.pairs)),
        "hypotheses": float(search.hypotheses),
        "tiles": float(search.tiles_tried),
        "searched_deg": search.reach_deg,
        "false_probability": probability,
    }
    if settings.v_min_ident is not None:
        numbers["confirmed_share"] = share
    return Identified(
        reference,
        stars,
        None,
        f"{len(reference.pairs)} pairs, {reference.rejected} rejected, {search.hypotheses} hypotheses, "
        f"{search.tiles_tried} tiles",
        probability,
        numbers,
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
    scale = plate.scale_arcsec_px()
    if abs(math.log(scale / one.plate.scale_arcsec_px())) > 0.05:
        return False
    dxi, deta = reference.dxi_arcsec, reference.deta_arcsec
    if float(np.sqrt(np.mean(dxi**2 + deta**2))) > 0.5 * strobe_px * scale:
        return False
    if math.sqrt(0.5 * float(np.trace(reference.center_covariance_arcsec2))) > CENTER_SIGMA_PX * scale:
        return False
    # of few stars nearly all must be there; of many a fair share
    return len(pairs) >= 0.5 * settings.min_share * min(selection.allowed(plate), 100)
