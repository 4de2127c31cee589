"""Why a frame was not solved: a typed reason, a sentence, and the numbers behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.star_counts import depth_for
from mountnav.catalog.stars import Catalog
from mountnav.frames import Hint
from mountnav.identification.full import Search, match_radius
from mountnav.identification.selection import star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Measurements, StarImages
from mountnav.measuring.medians import median
from mountnav.solution import Reason
from mountnav.units import SKY_DEG2

SURE_STARS = 8
"""With fewer stars than this a failure is laid to their number. Chosen by hand: it changes the reason of a
refusal, never whether a frame is solved."""
BLIND_STARS = 10
"""So many stars of the catalog, and nothing else, are found anywhere in the sky: of drawn lists of a field of
0.75° all of 26 with 10 to 12 stars, 6 of 8 with 9, 5 of 9 with 8, and none of 26 with fewer. It changes the
words of a refusal, never whether a frame is solved."""
CLOUD_SHARE = 0.2
"""Fewer star-like sources than this share of the promised ones: something is in the way. Chosen by hand: it
changes the reason of a refusal, never whether a frame is solved."""
DEEPER_FRAME = 10.0
"""A frame with so many times the catalog's stars is deeper by some magnitudes. Chosen by hand: it changes the
reason of a refusal, never whether a frame is solved."""
MANY_STARS = 300
"""With so many catalog stars in a field no more are counted: their number isn't the reason of a failure."""
PROMISED_LEAST = 12
"""A promise of fewer stars than this says nothing about the sky's state. Chosen by hand: it changes the
reason of a refusal, never whether a frame is solved."""
WIDE_FWHM_PX = 9.0
"""Star images wider than this, pixels, explain a failure by defocus (`Reason.CLOUD_OR_DEFOCUS`). Chosen by
hand: it changes the reason of a refusal, never whether a frame is solved."""
CHANCE_WORTH_TELLING = 1e-3
"""A refused hypothesis with odds below this is reported as one (`Reason.CHANCE`): chance brings one in at
most 1,000 searches. It changes the reason, never whether a frame is solved."""
CROWDED_STROBES = 0.4
"""Where chance fills more of the strobes than this, the paper's 70 % hardly separate plates. Of 48 pairs that
could be, a wrong plate has so many once in 12,000 hypotheses at 0.4, once in 7 at 0.6, and once in 10^12 at
0.2. Doubled, crowding would never be reported; halved, it would be where it does no harm."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A reason and what it rests on."""

    reason: Reason
    detail: str
    numbers: dict[str, float] = field(default_factory=dict)


def promised_depth_mag(scale_arcsec_px: float) -> float:
    """Magnitude that a camera of this scale reaches in any useful exposure.

    Returns
    -------
    float
        11 from 3 ″/px down (telescopes), 8.1 at 30 ″/px (short lenses), 7 at 70 ″/px.
    """
    return float(np.clip(11.0 - 2.9 * math.log10(scale_arcsec_px / 3.0), 6.0, 11.0))


def in_field(
    catalog: Catalog,
    hint: Hint,
    width_px: int,
    height_px: int,
    *,
    epoch_yr: float,
    mag_limit: float | None = None,
) -> float | None:
    """How many stars the catalog has in a field this size, on the mean over the hinted area.

    Returns
    -------
    float or None
        None when center or scale are not known.
    """
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if hint.center is None or low is None or high is None or not 0 < low <= high:
        return None
    side_deg = math.sqrt(low * high) / 3600.0
    field_deg2 = width_px * height_px * side_deg**2
    # some fields wide, so that a star more or less means little
    radius_deg = min(max(hint.radius_deg, math.sqrt(2.0 * field_deg2 / math.pi)), 20.0)
    fields = math.pi * radius_deg**2 / field_deg2
    # a deep catalog's stars needn't be read by the million to know that there are enough
    deep = depth_for(catalog, hint.center, MANY_STARS, field_deg2)
    limits = [limit for limit in (mag_limit, deep) if limit is not None]
    stars = catalog.cone(hint.center, radius_deg, epoch_yr=epoch_yr, mag_limit=min(limits, default=None))
    return len(stars) / fields


def refusal(
    measurements: Measurements,
    catalog: Catalog,
    hint: Hint,
    search: Search,
    settings: IdentificationSettings,
    *,
    epoch_yr: float,
    out_of_time_s: float | None = None,
) -> Refusal:
    """Find the likely reason why nothing was identified.

    Parameters
    ----------
    search : Search
        What was tried.
    out_of_time_s : float, optional
        The budget, if that ended the search: it is the reason then, and the likely one stands in the detail.
    """
    likely = _likely(measurements, catalog, hint, search, settings, epoch_yr)
    if out_of_time_s is None:
        return likely
    return Refusal(
        Reason.TIMED_OUT,
        f"{out_of_time_s:g} s spent on {_tried(search)}; likely: {likely.detail}",
        likely.numbers | {"budget_s": out_of_time_s},
    )


def _mean_in_field(catalog: Catalog, hint: Hint, width_px: int, height_px: int) -> float | None:
    """Stars in a field this size on the mean over the sky, for a frame of unknown position."""
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if not isinstance(catalog, PackedStore) or low is None or high is None or not 0 < low <= high:
        return None
    field_deg2 = width_px * height_px * low * high / 3600.0**2
    return len(catalog) * field_deg2 / SKY_DEG2


def _too_shallow(has: float, measured: int) -> bool:
    """Whether the catalog has too few stars in a field; the neighbors' mean says little of one poor field."""
    return has < SURE_STARS or (has < 2.0 * SURE_STARS and measured > DEEPER_FRAME * has)


def _tried(search: Search) -> str:
    tried = f"{search.hypotheses} hypotheses"
    if search.tiles_tried:
        tried = f"{search.tiles_tried} tiles and {tried} out to {search.reach_deg:.1f}° from the hint"
    return f"{tried}, and the index of the whole sky" if search.whole_sky else tried


def _likely(
    measurements: Measurements,
    catalog: Catalog,
    hint: Hint,
    search: Search,
    settings: IdentificationSettings,
    epoch_yr: float,
) -> Refusal:
    m = measurements
    clean = star_like(m)
    numbers: dict[str, float] = {
        "measured": float(len(m)),
        "star_like": float(clean.size),
        "tiles": float(search.tiles_tried),
        "hypotheses": float(search.hypotheses),
        "searched_deg": search.reach_deg,
        "best_false_probability": search.best_probability,
        "allowed_false_probability": settings.false_probability_max,
    }
    if settings.v_min_ident is not None:
        numbers["most_confirmed_share"] = search.most_published
        numbers["v_min_ident"] = settings.v_min_ident
        numbers["strobe_chance"] = search.strobe_chance
    width = m.fwhm_px[clean]
    width = width[np.isfinite(width) & (width > 0)]
    if width.size:
        numbers["fwhm_px"] = median(width)
    has = in_field(catalog, hint, m.width_px, m.height_px, epoch_yr=epoch_yr)
    promised = None
    if has is not None:
        numbers["catalog_stars"] = has
        low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
        depth = promised_depth_mag(math.sqrt((low or 1.0) * (high or 1.0)))
        promised = in_field(catalog, hint, m.width_px, m.height_px, epoch_yr=epoch_yr, mag_limit=depth)
        numbers["promised_stars"], numbers["promised_to_mag"] = promised or 0.0, depth
    if promised is not None and promised >= PROMISED_LEAST and clean.size < CLOUD_SHARE * promised:
        return Refusal(
            Reason.CLOUD_OR_DEFOCUS,
            f"{clean.size} star-like sources, where the catalog promises about {promised:.0f} stars to "
            f"magnitude {numbers['promised_to_mag']:.1f}: cloud, dew, a closed cover, "
            "defocus or a very short exposure",
            numbers,
        )
    defocused = m.quality is not None and m.quality.images is StarImages.DEFOCUSED
    if clean.size >= 3 and (defocused or numbers.get("fwhm_px", 0.0) > WIDE_FWHM_PX):
        return Refusal(
            Reason.CLOUD_OR_DEFOCUS,
            f"the images of {clean.size} sources are {numbers.get('fwhm_px', math.nan):.1f} px wide: "
            "defocus, dew, or no stars at all",
            numbers,
        )
    if clean.size < settings.min_pairs or (search.frame_triangles == 0 and not search.whole_sky):
        what = (
            f"{clean.size} stars measured, {settings.min_pairs} needed"
            if clean.size < settings.min_pairs
            else f"{clean.size} stars measured, and they make no triangle large enough"
        )
        return Refusal(Reason.TOO_FEW_MEASUREMENTS, f"{what}: expose longer, check focus and cover", numbers)
    tried = _tried(search)
    if has is None:
        has = _mean_in_field(catalog, hint, m.width_px, m.height_px)
    if has is not None and _too_shallow(has, clean.size):
        return Refusal(
            Reason.CATALOG_TOO_SHALLOW,
            f"{catalog.name} has about {has:.1f} stars in a field this size, {SURE_STARS} are needed to "
            f"be sure ({clean.size} stars measured, {tried})",
            numbers,
        )
    if search.best_probability < CHANCE_WORTH_TELLING:
        more = stars_wanted(search.best_probability, clean.size, m.width_px, m.height_px, settings)
        advice = ""
        if more is not None:
            numbers["more_stars"] = float(more)
            advice = f": {more} more {'star' if more == 1 else 'stars'} that match would do"
            if has is not None:
                advice += f" (the catalog has about {has:.0f} in a field this size)"
        return Refusal(
            Reason.CHANCE,
            f"the best match has a false-positive probability of {search.best_probability:.1e}, allowed is "
            f"{settings.false_probability_max:.0e}{advice} ({clean.size} stars, {tried})",
            numbers,
        )
    anywhere = ""
    if search.whole_sky and hint.center is None and clean.size < BLIND_STARS:
        numbers["more_stars"] = float(BLIND_STARS - clean.size)
        anywhere = f"; {BLIND_STARS} that the catalog has would do, or a hint where to look"
    if clean.size < SURE_STARS:
        return Refusal(
            Reason.TOO_FEW_MEASUREMENTS,
            f"{clean.size} stars measured, of which no five match ({tried}){anywhere}: "
            "expose longer, check focus and cover",
            numbers,
        )
    detail = f"{clean.size} stars match nowhere ({tried}){anywhere}"
    if settings.v_min_ident is not None:
        detail += _counted(search, settings.v_min_ident, settings.match_px)
    return Refusal(Reason.NO_MATCH, detail, numbers)


def stars_wanted(
    probability: float, measured: int, width_px: int, height_px: int, settings: IdentificationSettings
) -> int | None:
    """How many more catalog stars on measurements would bring a match below the allowed odds.

    Parameters
    ----------
    probability : float
        False-positive probability of the match.
    measured : int
        Measurements that stars may fall on.
    width_px, height_px : int
        Size of the frame.

    Returns
    -------
    int or None
        Rather too many than too few: each is held to be as far off as a match may be. None in a crowd, where
        so wide a match says next to nothing, and where no odds are allowed.
    """
    reach_px = match_radius(settings, width_px, height_px)
    by_chance = -math.expm1(-measured * math.pi * reach_px**2 / (width_px * height_px))
    if not 0.0 < by_chance <= CROWDED_STROBES or not min(probability, settings.false_probability_max) > 0.0:
        return None
    missing = math.log(probability / settings.false_probability_max)
    return max(1, math.ceil(missing / -math.log(by_chance)))


def _counted(search: Search, required: float, match_px: float) -> str:
    """How near the paper's count came, why no nearer, and what to do."""
    most = f"{search.most_published:.0%} of the pairs that could be"
    if search.strobe_chance > CROWDED_STROBES:
        why = (
            f"a strobe of {match_px:g} px holds a measurement by chance in {search.strobe_chance:.0%} of "
            "places: take a narrower match_px, or the profile measured"
        )
    else:
        why = "the profile measured goes by the odds alone"
    if search.most_published >= required:
        return f"; {most} were confirmed once, but so few that it may be chance; {why}"
    return f"; at most {most} were confirmed, {required:.0%} are asked for; {why}"
