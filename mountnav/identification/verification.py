"""Judges a hypothesis: the odds of its agreement, the plate that grows from it, whether that is sound."""

from __future__ import annotations

import math

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.identification.anchor_count import Sources
from mountnav.identification.anchored import anchored_odds
from mountnav.identification.area import stars_round
from mountnav.identification.confirmation import Witnesses
from mountnav.identification.full import Hypothesis, Search, match_radius
from mountnav.identification.identified import Identified
from mountnav.identification.odds import looks
from mountnav.identification.paper import published_share
from mountnav.identification.plate import Plate
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.selection import Index
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Measurements

PLATE_STARS = 1000
"""Stars fetched for the plate, brightest first."""
WORTH_COUNTING = 1e-5
"""Below this chance of one hypothesis the anchors are counted, if the search was too long for its odds."""
CENTER_SIGMA_PX = 2.0
"""A plate that leaves the frame's center less certain than this rests on a corner and is refused."""


def verified(
    one: Hypothesis,
    measurements: Measurements,
    usable: Index,
    catalog: Catalog,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
    *,
    rough: bool = False,
) -> Identified | None:
    """Ask what the odds of a hypothesis are, and grow its plate.

    Parameters
    ----------
    one : Hypothesis
    measurements : Measurements
    usable : ndarray of int
        Which measurements take part, brightest first.
    catalog : Catalog
    epoch_yr : float
        Julian year of the frame.
    settings : IdentificationSettings
    search : Search
        How many hypotheses were tried so far: the odds need it.
    rough : bool
        A plate to find stars by is enough; the odds are the same.

    Returns
    -------
    Identified or None
        None when it may be chance, or the plate is no camera's.
    """
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
    chance = witnesses.chance()
    probability = min(1.0, chance * looks(search.hypotheses))
    if probability > settings.false_probability_max and chance < WORTH_COUNTING:
        again = anchored_odds(
            one.plate,
            stars,
            Sources.of(measurements, usable),
            search.anchors,
            catalog,
            epoch_yr,
            match_px=strobe_px,
            limit=settings.false_probability_max,
        )
        # should no sound plate grow, these odds are what the refusal tells of
        search.best_probability = min(search.best_probability, probability)
        probability = min(probability, again)
    if probability > settings.false_probability_max:
        search.best_probability = min(search.best_probability, probability)
        return None
    selection = Selection(measurements, usable, stars, settings)
    reference = selection.grow(one.plate, strobe_px, rough=rough)
    if reference is None or not sound(reference, selection, measurements, one.plate, settings, strobe_px):
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


def sound(
    reference: Reference,
    selection: Selection,
    measurements: Measurements,
    believed: Plate,
    settings: IdentificationSettings,
    strobe_px: float,
) -> bool:
    """Tell whether a final plate is still a camera's, and rests on pairs from more than a corner.

    Parameters
    ----------
    reference : Reference
    selection : Selection
        What it was grown with.
    measurements : Measurements
    believed : Plate
        What it grew from.
    settings : IdentificationSettings
    strobe_px : float
        How far off `believed` may have been.
    """
    pairs, plate = reference.pairs, reference.plate
    if len(pairs) < settings.min_pairs or plate.parity != believed.parity:
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
    if abs(math.log(scale / believed.scale_arcsec_px())) > 0.05:
        return False
    dxi, deta = reference.dxi_arcsec, reference.deta_arcsec
    if float(np.sqrt(np.mean(dxi**2 + deta**2))) > 0.5 * strobe_px * scale:
        return False
    if math.sqrt(0.5 * float(np.trace(reference.center_covariance_arcsec2))) > CENTER_SIGMA_PX * scale:
        return False
    # of few stars nearly all must be there; of many a fair share
    return len(pairs) >= 0.5 * settings.min_share * min(selection.allowed(plate), 100)
