"""Which catalogs a frame is identified with, in which order; and the best one's stars in the end."""

from __future__ import annotations

import logging
import math
from dataclasses import replace

from mountnav.catalog.catalog_set import CatalogSet, Choice
from mountnav.catalog.combined import with_magnitudes
from mountnav.catalog.star_counts import mag_reaching
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadCatalog
from mountnav.frames import Frame, Hint
from mountnav.identification.budget import Budget
from mountnav.identification.search import Reach, identify, too_narrow_for_index
from mountnav.identification.selection import star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.verification import Identified, with_better_stars
from mountnav.measuring.measurements import Measurements
from mountnav.solution import Reason
from mountnav.solving.settings import SolveSettings

_log = logging.getLogger(__name__)

SHARE_OF_FIRST = 0.6
"""Share of the time left that each catalog may take while there are others to try."""


def catalogs_for(
    catalog: Catalog, hint: Hint, frame: Frame, blind: str, *, epoch_yr: float
) -> tuple[Choice, ...]:
    """Choose catalogs for a frame, the best first.

    Parameters
    ----------
    catalog : Catalog
        A plain one is the only choice.
    frame : Frame
        For its size.
    epoch_yr : float
        Julian year of the frame.

    Returns
    -------
    tuple of Choice
        At least one.
    """
    if not isinstance(catalog, CatalogSet):
        return (Choice(catalog, math.nan, math.nan, ""),)
    center = None if blind == "only" else hint.center
    height_px, width_px = frame.pixels.shape[:2]
    field = field_deg2(hint, width_px, height_px)
    return catalog.choices(center, field, epoch_yr=epoch_yr, radius_deg=hint.radius_deg)


def field_deg2(hint: Hint, width_px: int, height_px: int) -> float | None:
    """Area of a frame, square degrees, if its scale is known from both sides."""
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if low is None or high is None or not 0 < low <= high:
        return None
    return width_px * height_px * low * high / 3600.0**2


def index_catalog(catalog: Catalog, choice: Choice) -> Catalog | None:
    """The catalog that the blind index was made of, if it is another one than the choice."""
    if not isinstance(catalog, CatalogSet) or choice.catalog is catalog.indexed:
        return None
    return catalog.indexed


def identify_with_catalogs(
    choices: tuple[Choice, ...],
    measurements: Measurements,
    hint: Hint,
    reach: Reach,
    settings: SolveSettings,
    epoch_yr: float,
    budget_s: float,
) -> Identified:
    """Identify with the first catalog that succeeds.

    Parameters
    ----------
    reach : Reach
        The whole sky is searched once.
    epoch_yr : float
        Julian year of the frame.
    budget_s : float
        Processor time for all of them.

    Returns
    -------
    Identified
        If none succeeds, what the first one said in the end.
    """
    budget = Budget.of(budget_s)
    refused: Identified | None = None
    turns = _turns(choices, measurements, hint, reach)
    damaged: set[Catalog] = set()
    tried = reach.tried
    for number, (choice, part) in enumerate(turns):
        left_s = budget.left_s
        if choice.catalog in damaged:
            continue
        try:
            found = identify(
                measurements,
                choice.catalog,
                hint,
                epoch_yr=epoch_yr,
                settings=settings.identification,
                budget_s=left_s if number == len(turns) - 1 else SHARE_OF_FIRST * left_s,
                reach=replace(part, tried=tried),
            )
        except BadCatalog as fault:
            damaged.add(choice.catalog)
            if len(damaged) == len(choices):
                raise
            _log.warning("the catalog %s is skipped: %s", choice.catalog.name, fault)
            continue
        if found.reference is not None:
            return found
        if choice is choices[0] or refused is None:
            refused = found
        tried = found.tried
    assert refused is not None
    return refused


def _turns(
    choices: tuple[Choice, ...], measurements: Measurements, hint: Hint, reach: Reach
) -> list[tuple[Choice, Reach]]:
    """In which order the catalogs are tried, and how far each goes.

    All of them are tried with what the hint says before any is tried as if the hint were wrong. The index
    is searched once: at first, or by the thorough search where the frame is too narrow for it.
    """
    if len(choices) == 1:
        return [(choices[0], reach)]
    placed = [reading for reading in (hint, *hint.alternatives) if reading.center is not None]
    shorter_px = min(measurements.width_px, measurements.height_px)
    late = reach.indexed is not None and too_narrow_for_index(placed, shorter_px)
    without = replace(reach, index=None, indexed=None)
    done = replace(without, sky_searched=reach.index is not None and reach.blind != "never")
    quick, thorough = (without, reach) if late else (reach, done)
    first, *others = choices
    return [
        (first, replace(quick, thorough=False)),
        *((choice, replace(without, thorough=False)) for choice in others),
        (first, thorough),
        *((choice, done) for choice in others),
    ]


def with_best_catalog(
    catalog: Catalog,
    choices: tuple[Choice, ...],
    found: Identified,
    measurements: Measurements,
    settings: IdentificationSettings,
    epoch_yr: float,
) -> tuple[Identified, tuple[str, ...]]:
    """Take the stars of the catalog that suits the position where the frame turned out to be.

    Parameters
    ----------
    choices : tuple of Choice
        Those for the position that was believed.
    found : Identified
        With a reference.
    epoch_yr : float
        Julian year of the frame.

    Returns
    -------
    found : Identified
        With that catalog's stars where they hold the plate as well, and with magnitudes of the catalog that
        is configured for these.
        Without a reference where no catalog that may be used holds it.
    steps : tuple of str
        Why that catalog, and what was tried in vain: for provenance.
    """
    if not isinstance(catalog, CatalogSet) or found.reference is None or found.stars is None:
        return found, choices[0].steps
    plate = found.reference.plate
    width_px, height_px = measurements.width_px, measurements.height_px
    field = width_px * height_px * (plate.scale_arcsec_px() / 3600.0) ** 2
    used = next((choice for choice in choices if choice.catalog.name == found.stars.source), None)
    if used is None or used is not choices[0] or math.isnan(used.expected):
        there = catalog.choices(plate.center(), field, epoch_yr=epoch_yr)[0]
        if there.catalog.name != found.stars.source:
            try:
                found = with_better_stars(
                    found, measurements, star_like(measurements), there.catalog, epoch_yr, settings
                )
            except BadCatalog as fault:
                _log.warning("the catalog %s is skipped: %s", there.catalog.name, fault)
        used = there if found.stars is not None and there.catalog.name == found.stars.source else used
    found, used = _as_ordered(catalog, found, used, measurements, field, settings, epoch_yr)
    if found.reference is None:
        return found, choices[0].told
    if catalog.magnitudes is not None and found.stars is not None:
        found = replace(found, stars=with_magnitudes(found.stars, catalog.magnitudes))
    told = choices[0].told
    return found, told if used is None else tuple(dict.fromkeys((*used.steps, *told)))


def _as_ordered(
    shelf: CatalogSet,
    found: Identified,
    used: Choice | None,
    measurements: Measurements,
    field_deg2: float,
    settings: IdentificationSettings,
    epoch_yr: float,
) -> tuple[Identified, Choice | None]:
    """Take the stars of a catalog that may be used, where it was found by the index's, or refuse.

    The index proposes places by its own stars, whichever catalogs were ordered; a solution never rests on
    them then.
    """
    allowed = {usable.name for usable in shelf.usable}
    assert found.stars is not None
    assert found.reference is not None
    if found.stars.source in allowed:
        return found, used
    center = found.reference.plate.center()
    for choice in shelf.choices(center, field_deg2, epoch_yr=epoch_yr):
        again = with_better_stars(
            found, measurements, star_like(measurements), choice.catalog, epoch_yr, settings
        )
        if again.stars is not None and again.stars.source in allowed:
            return again, choice
    return (
        replace(
            found,
            reference=None,
            reason=Reason.OTHER_CATALOG,
            detail=f"the index of {found.stars.source} finds it at RA {center.ra_deg:.4f}°, Dec "
            f"{center.dec_deg:+.4f}°, where no plate can be fitted to the catalogs that were ordered "
            f"({', '.join(sorted(allowed))})",
        ),
        None,
    )


def with_catalog_advice(
    found: Identified, catalog: Catalog, hint: Hint, frame: Frame, stars_seen: int
) -> Identified:
    """Add to a refusal for want of catalog stars which catalog would help.

    Parameters
    ----------
    found : Identified
        The refusal.
    stars_seen : int
        Star-like sources measured: they show how deep the frame is.
    """
    from mountnav.catalog.doctor.diagnosis import advice_for  # only needed when a frame was refused

    height_px, width_px = frame.pixels.shape[:2]
    field = field_deg2(hint, width_px, height_px)
    if hint.center is None or field is None:
        return found
    side_deg = math.sqrt(field / (width_px * height_px))
    depth_mag = float(mag_reaching(hint.center.ra_deg, hint.center.dec_deg, max(stars_seen, 1) / field))
    here = catalog.installed if isinstance(catalog, CatalogSet) else (catalog,)
    advice = advice_for(width_px * side_deg, height_px * side_deg, depth_mag, hint.center, here)
    return replace(found, detail=f"{advice} ({stars_seen} stars measured)")
