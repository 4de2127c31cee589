"""Judges a hypothesis: its odds (or the paper's count rule), and the plate that grows from it.

The count rule of the paper: enough of Ω_bl100 must find a star of Ω_star200 [S23 §2.2]. Each list holds what
there is, if that is less than its name says: with a catalog of 16 stars in the frame no more than 16 of a
hundred measurements can pair. So v_min_ident is a share of the pairs that could be: as many as the shorter of
the two lists has in the frame. docs/explanation/identification.md has the figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.star_counts import stars_round
from mountnav.catalog.stars import Catalog, Stars
from mountnav.identification.anchors import AnchorSources, anchored_odds
from mountnav.identification.full import Hypothesis, Search, match_radius
from mountnav.identification.odds import Confirmation, trials_factor
from mountnav.identification.pairing import Pairs
from mountnav.identification.plate import Plate
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.selection import Index, spread_brightest
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Measurements
from mountnav.solution import Contradiction, Reason

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Identified:
    """Result of a search: the reference with its stars, or the reason for none.

    Attributes
    ----------
    stars : Stars or None
        The list that `reference.pairs.star` points into.
    detail : str
        For people.
    false_probability : float
        Chance that a wrong position would have looked as good: that of one hypothesis times all that were
        tried.
    numbers : dict of str to float
        The numbers behind it.
    contradictions : tuple of Contradiction
        Hints that disprove each other. Who has the solution compares it with the hints
        (`mountnav.solving.contradictions`).
    blind : bool
        Found over the whole sky, not where the hint said.
    tried : int
        Hypotheses tried so far: a later search for the same frame has to count them.
    """

    reference: Reference | None
    stars: Stars | None
    reason: Reason | None
    detail: str
    false_probability: float = 1.0
    numbers: dict[str, float] = field(default_factory=dict)
    contradictions: tuple[Contradiction, ...] = ()
    blind: bool = False
    tried: int = 0


def count_rule_share(
    plate: Plate,
    stars: Stars,
    x_px: Array,
    y_px: Array,
    *,
    width_px: int,
    height_px: int,
    settings: IdentificationSettings,
) -> float:
    """Share of the pairs that could be which are there, as the paper counts.

    Parameters
    ----------
    plate : Plate
        The six constants that a triangle gave.
    stars : Stars
        Round the plate's center, brightest first; Ω_star200 is taken evenly from the circle round the frame.
    x_px, y_px : ndarray, shape (n,)
        Star-like measurements, brightest first; Ω_bl100 is taken evenly from them.
    width_px, height_px : int
        Size of the frame.
    settings : IdentificationSettings
        `n_confirm_measurements`, `n_confirm_stars`, `m_reg`, `region_cap`, `match_px`, `min_pairs`.

    Returns
    -------
    float
        To be compared with v_min_ident. A measurement counts once. 0 where fewer than `min_pairs` pairs
        could be: the triangle alone would fill the share.
    """
    blobs = spread_brightest(
        x_px, y_px, settings.n_confirm_measurements, regions=settings.m_reg, cap=settings.region_cap
    )
    if blobs.size == 0:
        return 0.0
    x, y = plate.pixels(*plate.project(stars.ra_deg, stars.dec_deg))
    reach_px = 0.5 * math.hypot(width_px, height_px)
    near = np.flatnonzero(np.hypot(x - plate.center_x_px, y - plate.center_y_px) <= reach_px)
    chosen = near[
        spread_brightest(
            x[near], y[near], settings.n_confirm_stars, regions=settings.m_reg, cap=settings.region_cap
        )
    ]
    x, y = x[chosen], y[chosen]
    in_frame = (x > -0.5) & (x < width_px - 0.5) & (y > -0.5) & (y < height_px - 0.5)
    possible = min(blobs.size, int(in_frame.sum()))
    if possible < settings.min_pairs:
        return 0.0
    tree = cKDTree(np.column_stack((x, y)))
    distance = np.asarray(tree.query(np.column_stack((x_px[blobs], y_px[blobs])))[0])
    return min(1.0, int((distance < settings.match_px).sum()) / possible)


PLATE_STARS = 1000
"""Number of stars read for the plate, brightest first: a limit of time and memory."""
WORTH_COUNTING = 1e-5
"""Below this chance of one hypothesis the anchors are counted, if the search was too long for its odds.
Counting reads the searched area's stars, so it isn't done for hypotheses that are chance."""
LEAST_REACH_PX, MOST_REACH_PX = 2.5, 8.0
"""How near to a predicted place its source is looked for: the coarse plate's own deviations, within these."""
KEPT_SHARE = 0.7
"""A catalog that loses more of the pairs than this leaves is not the better one here. Chosen by hand."""
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
    """Compute the odds of a hypothesis, and grow its plate.

    Parameters
    ----------
    usable : ndarray of int
        Which measurements take part, brightest first.
    epoch_yr : float
        Julian year of the frame.
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
    stars = stars_of_frame(one.plate, measurements, catalog, epoch_yr)
    if len(stars) < settings.min_pairs:
        return None
    if settings.v_min_ident is not None:
        share = count_rule_share(one.plate, stars, x, y, width_px=width, height_px=height, settings=settings)
        search.most_published = max(search.most_published, share)
        if share < settings.v_min_ident:
            return None
    strobe_px = match_radius(settings, width, height)
    piece_of = search.pieces(x, y)
    confirmation = Confirmation(
        one.plate,
        one.corners,
        stars,
        x,
        y,
        width_px=width,
        height_px=height,
        match_px=strobe_px,
        source=piece_of,
    )
    chance = confirmation.chance()
    probability = min(1.0, chance * trials_factor(search.hypotheses))
    if probability > settings.false_probability_max and chance < WORTH_COUNTING:
        again = anchored_odds(
            one.plate,
            stars,
            AnchorSources.of(measurements, usable, piece_of),
            search.anchors,
            catalog,
            epoch_yr,
            match_px=strobe_px,
            limit=settings.false_probability_max,
        )
        # should no sound plate grow, the refusal reports these odds
        search.best_probability = min(search.best_probability, probability)
        probability = min(probability, again)
    if probability > settings.false_probability_max:
        search.best_probability = min(search.best_probability, probability)
        return None
    selection = Selection(measurements, usable, stars, settings)
    reference = selection.grow(one.plate, strobe_px, rough=rough)
    if reference is None or not is_sound(reference, selection, measurements, one.plate, settings, strobe_px):
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
        tried=search.hypotheses,
    )


def with_better_stars(
    found: Identified,
    measurements: Measurements,
    usable: Index,
    catalog: Catalog,
    epoch_yr: float,
    settings: IdentificationSettings,
) -> Identified:
    """Fit the plate again, to the stars of a more precise catalog than the one that it was found with.

    Parameters
    ----------
    found : Identified
        With a reference; it is sure already, and its odds stay.
    measurements : Measurements
        Those its pairs point into.
    epoch_yr : float
        Julian year of the frame.

    Returns
    -------
    Identified
        The same as given where the other catalog's stars don't hold a plate as well.
    """
    reference = found.reference
    assert reference is not None
    plate = reference.plate
    stars = stars_of_frame(plate, measurements, catalog, epoch_yr)
    if len(stars) < settings.min_pairs:
        return found
    reach_px = reach_of(reference)
    selection = Selection(measurements, usable, stars, settings)
    again = selection.refine(plate, reach_px)
    if again is None or len(again.pairs) < KEPT_SHARE * len(reference.pairs):
        return found
    if not is_sound(again, selection, measurements, plate, settings, reach_px):
        return found
    return replace(found, reference=again, stars=stars)


def stars_of_frame(plate: Plate, measurements: Measurements, catalog: Catalog, epoch_yr: float) -> Stars:
    """The stars that a plate may rest on, brightest first.

    Parameters
    ----------
    measurements : Measurements
        For the frame's size.
    epoch_yr : float
        Julian year of the frame.
    """
    diagonal_deg = math.hypot(measurements.width_px, measurements.height_px) * plate.scale_arcsec_px() / 3600
    return stars_round(catalog, plate.center(), 0.52 * diagonal_deg, PLATE_STARS, epoch_yr=epoch_yr)


def reach_of(reference: Reference) -> float:
    """How far from its predicted place a star may be found, pixels, by the deviations of the pairs so far."""
    square = reference.dxi_arcsec**2 + reference.deta_arcsec**2
    off_px = float(np.sqrt(np.mean(square))) / reference.plate.scale_arcsec_px()
    return float(np.clip(1.5 + 4.0 * off_px, LEAST_REACH_PX, MOST_REACH_PX))


def spread_px(measurements: Measurements, pairs: Pairs) -> float:
    """How far pairs scatter in the direction in which they scatter least, one sigma, pixels."""
    x, y = measurements.x_px[pairs.measurement], measurements.y_px[pairs.measurement]
    return math.sqrt(max(float(np.linalg.eigvalsh(np.cov(np.vstack((x, y))))[0]), 0.0))


def is_sound(
    reference: Reference,
    selection: Selection,
    measurements: Measurements,
    believed: Plate,
    settings: IdentificationSettings,
    strobe_px: float,
) -> bool:
    """Whether a final plate is still a camera's, and rests on pairs from more than a corner.

    Parameters
    ----------
    selection : Selection
        What it was grown with.
    believed : Plate
        What it grew from.
    strobe_px : float
        How far off `believed` may have been.
    """
    pairs, plate = reference.pairs, reference.plate
    if len(pairs) < settings.min_pairs or plate.parity != believed.parity:
        return False
    if spread_px(measurements, pairs) < 0.05 * min(measurements.width_px, measurements.height_px):
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
