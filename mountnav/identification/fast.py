"""A frame solved by its brightest sources: identify a coarse list, then measure only what was identified."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.identification.pairing import predicted
from mountnav.identification.reference import Selection
from mountnav.identification.search import Reach, identify
from mountnav.identification.selection import star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.verification import KEPT_SHARE, Identified, is_sound, reach_of, stars_of_frame
from mountnav.measuring.fast import measure_fast
from mountnav.measuring.fast.coarse import Summed
from mountnav.measuring.measurements import Measurements
from mountnav.measuring.settings import MeasuringSettings


@dataclass(frozen=True, slots=True)
class FastResult:
    """What the fast search of a frame found.

    Attributes
    ----------
    identified : Identified or None
        With a reference, or None: measure the frame in full.
    measurements : Measurements or None
        The precise ones, which `identified.reference.pairs.measurement` points into.
    seen : int
        Sources found.
    tried : int
        Hypotheses tried; a later search for the same frame has to count them.
    measure_s : float
        Wall time of looking and measuring.
    summed : Summed or None
        The frame of whole numbers in bins.
    """

    identified: Identified | None = None
    measurements: Measurements | None = None
    seen: int = 0
    tried: int = 0
    measure_s: float = 0.0
    summed: Summed | None = None


def identify_fast(
    frame: Frame,
    catalog: Catalog,
    hint: Hint,
    *,
    epoch_yr: float,
    settings: IdentificationSettings,
    measuring: MeasuringSettings,
    budget_s: float,
    reach: Reach,
) -> FastResult:
    """Identify a frame's brightest sources, and measure precisely where the plate has stars.

    Parameters
    ----------
    frame : Frame
        Calibrated, no mosaic.
    epoch_yr : float
        Julian year of the frame.
    budget_s : float
        Processor time allowed for identification.
    reach : Reach
        Only the hint and the whole sky are searched, however far it goes.

    Returns
    -------
    FastResult
        The odds are those of the coarse list; the plate rests on the precise one.
    """
    began = time.monotonic()
    look = measure_fast(frame, settings=measuring)
    looked_s = time.monotonic() - began
    if look is None:
        return FastResult(measure_s=looked_s, tried=reach.tried)
    found = identify(
        look.measurements,
        catalog,
        hint,
        epoch_yr=epoch_yr,
        settings=settings,
        budget_s=budget_s,
        reach=replace(reach, thorough=False, rough=True),
    )
    seen, tried = len(look.measurements), found.tried
    coarse = found.reference
    if coarse is None or found.stars is None:
        return FastResult(seen=seen, tried=tried, measure_s=looked_s)
    plate, stars = coarse.plate, found.stars
    reach_px = reach_of(coarse)
    if reach.indexed is not None:
        # found with the stars of the index, perhaps; those of the frame's own catalog are better or more
        better = stars_of_frame(plate, look.measurements, catalog, epoch_yr)
        stars = better if len(better) >= KEPT_SHARE * len(stars) else stars
    places = predicted(plate, stars, width_px=frame.width_px, height_px=frame.height_px)
    again = time.monotonic()
    precise = look.measured_at(places.x_px, places.y_px, reach_px=reach_px)
    measure_s = looked_s + time.monotonic() - again
    selection = Selection(precise, star_like(precise), stars, settings)
    reference = selection.refine(plate, reach_px)
    if reference is None or not is_sound(reference, selection, precise, plate, settings, reach_px):
        return FastResult(seen=seen, tried=tried, measure_s=measure_s)
    numbers = found.numbers | {"pairs": float(len(reference.pairs)), "seen": float(seen)}
    detail = f"{len(reference.pairs)} pairs, {reference.rejected} rejected, {tried} hypotheses, at a glance"
    identified = replace(found, reference=reference, stars=stars, numbers=numbers, detail=detail)
    return FastResult(identified, precise, seen, tried, measure_s, look.summed)
