"""The way through: calibrate, measure, identify, fit. The sky's troubles are answers, not errors."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.catalog_set import CatalogSet, Choice
from mountnav.catalog.stars import Catalog, Stars
from mountnav.clock import utc_now
from mountnav.errors import BadCatalog, BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.fast import FastResult, identify_fast
from mountnav.identification.plate import NAMES
from mountnav.identification.reference import Reference, identified_pairs
from mountnav.identification.search import Reach, without_place
from mountnav.identification.selection import star_like
from mountnav.identification.trail_check import StarsInCone, TrailCheck, check_trails
from mountnav.identification.verification import Identified
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measurements import Flag, Measurements, SkyQuality, with_plate
from mountnav.reading import demosaiced, read_frame
from mountnav.sky.coordinates import Icrs
from mountnav.solution import (
    SEEN_AT_MOST,
    Contradiction,
    ErrorBudget,
    IdentifiedPairs,
    Reason,
    Solution,
    Times,
    Verdict,
)
from mountnav.solving.catalog_choice import (
    catalogs_for,
    identify_with_catalogs,
    index_catalog,
    with_best_catalog,
    with_catalog_advice,
)
from mountnav.solving.contradictions import contradictions_of_hints, contradictions_with
from mountnav.solving.settings import SolveSettings

__all__ = ["SolveSettings", "epoch_of", "merged_hint", "solve", "solve_file"]


def merged_hint(header: Hint, given: Hint | None) -> Hint:
    """The given hint, and where it is silent the header's.

    Parameters
    ----------
    header : Hint
    given : Hint or None

    Returns
    -------
    Hint
        Center and radius go together, and so do the two bounds of the scale. What the header says otherwise
        is kept as alternatives: the caller may be wrong.
    """
    if given is None:
        return header
    merged = _over(header, given)
    others = [_over(one, given) for one in header.alternatives] + list(given.alternatives)
    others += [_over(given, one) for one in (header, *header.alternatives)]
    plain = replace(merged, alternatives=())
    kept: list[Hint] = []
    for one in others:
        bare = replace(one, alternatives=())
        if bare != plain and bare not in kept:
            kept.append(bare)
    return replace(merged, alternatives=tuple(kept))


def _over(below: Hint, above: Hint) -> Hint:
    """What `above` says, and where it is silent `below`."""
    merged = below
    if above.center is not None:
        merged = replace(
            merged, center=above.center, radius_deg=above.radius_deg, center_source=above.center_source
        )
    if above.scale_low_arcsec_px is not None or above.scale_high_arcsec_px is not None:
        merged = replace(
            merged,
            scale_low_arcsec_px=above.scale_low_arcsec_px,
            scale_high_arcsec_px=above.scale_high_arcsec_px,
            scale_source=above.scale_source,
        )
    return merged


def epoch_of(utc: datetime) -> float:
    """Julian year of an instant: the epoch that proper motions are carried to."""
    # plain arithmetic: astropy warns of years before 1960, and the minute between UTC and TT moves no star
    return 2000.0 + (utc.timestamp() - 946_728_000.0) / (365.25 * 86_400.0)


def solve(
    frame: Frame,
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SolveSettings | None = None,
    measurements: Measurements | None = None,
) -> Verdict:
    """Find out where a frame was taken.

    Parameters
    ----------
    frame : Frame
    catalog : Catalog
        One, or a `CatalogSet` of several, of which the frame's field, place and epoch choose.
    hint : Hint, optional
        Goes before what the frame's header says, field by field.
    settings : SolveSettings, optional
    measurements : Measurements, optional
        What `measure` made of this frame already; it is neither calibrated nor measured again then.

    Returns
    -------
    Verdict
        Never raises for what the sky or the frame are like.
    """
    settings = settings or SolveSettings()
    began = time.monotonic()
    believed = merged_hint(frame.hint, hint)
    reach = Reach(settings.index, settings.blind)
    nowhere = without_place(believed, reach)
    if nowhere is not None:
        return Verdict(
            None,
            nowhere.reason,
            f"{frame.source}: {nowhere.detail}",
            0,
            Times(total_s=time.monotonic() - began),
            contradictions=contradictions_of_hints(frame.hint, hint),
        )
    notes: list[str] = []
    zero_adu: float | None = None
    utc = frame.mid_exposure_utc
    epoch_yr = epoch_of(utc if utc is not None else utc_now())
    found, measured, measure_s, searched_s = None, 0, 0.0, 0.0
    choices: tuple[Choice, ...] = ()
    lit: tuple[TrailCheck, tuple[str, ...]] | None = None

    def light_of(one: Identified, its: Measurements) -> tuple[TrailCheck, tuple[str, ...]]:
        best, chosen = with_best_catalog(catalog, choices, one, its, settings.identification, epoch_yr)
        if best.reference is None:
            return TrailCheck(best, its, None, points=True), chosen
        sky = _sky_of(best.stars, catalog, choices, epoch_yr)
        return check_trails(best, its, frame.pixels, settings.identification, sky=sky), chosen

    try:
        if measurements is None:
            if settings.calibration is not None:
                frame, done = settings.calibration.applied(frame)
                notes += [*done.not_applied, *done.warnings]
                zero_adu = done.zero_adu
            frame = demosaiced(frame)
            measure_s = time.monotonic() - began
        choices = catalogs_for(catalog, believed, frame, settings.blind, epoch_yr=epoch_yr)
        reach = replace(reach, indexed=index_catalog(catalog, choices[0]))
        if measurements is None:
            if settings.glance and settings.identification.v_min_ident is None:
                computed_s = time.thread_time()
                try:
                    first = identify_fast(
                        frame,
                        choices[0].catalog,
                        believed,
                        epoch_yr=epoch_yr,
                        settings=settings.identification,
                        measuring=settings.measuring,
                        budget_s=settings.budget_s,
                        reach=reach,
                    )
                except BadCatalog:
                    if len(choices) == 1:
                        raise
                    first = FastResult(tried=reach.tried)  # the search in full passes the catalog over
                found, measurements, measured = first.identified, first.measurements, first.seen
                reach = replace(reach, tried=first.tried)
                measure_s += first.measure_s
                searched_s = max(0.0, time.thread_time() - computed_s - first.measure_s)
            if found is not None and found.reference is not None:
                assert measurements is not None
                lit = light_of(found, measurements)
                # pieces of trails pass for stars at a glance; measured in full, each trail may be one source
                found = None if not lit[0].points else found
            if found is None:
                from mountnav.measuring.measure import measure  # dear to import, and a glance does without

                lit = None
                before = time.monotonic()
                measurements = measure(frame, settings=settings.measuring)
                measure_s += time.monotonic() - before
    except BadFrame as fault:
        spent = time.monotonic() - began
        return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times(measure_s=spent, total_s=spent))
    assert measurements is not None
    if found is None:
        measured = len(measurements)
        left_s = settings.budget_s - searched_s
        found = identify_with_catalogs(choices, measurements, believed, reach, settings, epoch_yr, left_s)
    solution, quality, steps = None, measurements.quality, choices[0].steps
    if found.reference is not None:
        light, steps = lit or light_of(found, measurements)
        found, measurements = light.found, light.measurements
        if found.stars is not None:
            steps = (*steps, *found.stars.steps)
        if found.reference is not None and found.stars is not None:
            solution = _solution(found, found.reference, found.stars, measurements, steps)
            quality = _quality(quality, solution, zero_adu)
    elif found.reason is Reason.CATALOG_TOO_SHALLOW:
        found = with_catalog_advice(found, catalog, believed, frame, len(star_like(measurements)))
    if solution is None and isinstance(catalog, CatalogSet):
        notes += [f"catalog: {step}" for step in steps]
    total_s = time.monotonic() - began
    if utc is None:
        notes.append("the date is unknown, so stars were taken at today's places")
    return Verdict(
        solution=solution,
        reason=found.reason,
        detail=found.detail,
        measured=measured,
        times=Times(measure_s=measure_s, identify_s=total_s - measure_s, total_s=total_s),
        numbers=found.numbers | ({"blind": 1.0} if found.blind else {}),
        contradictions=_disproved(frame.hint, hint, solution, found),
        quality=quality,
        notes=tuple(notes),
        seen_px=_places_px(measurements),
    )


def _sky_of(
    stars: Stars | None, catalog: Catalog, choices: tuple[Choice, ...], epoch_yr: float
) -> StarsInCone | None:
    """Where more stars of the same catalog are to be had; None if it is none of those at hand."""
    known = [one.catalog for one in choices] + ([] if isinstance(catalog, CatalogSet) else [catalog])
    of = next((one for one in known if stars is not None and one.name == stars.source), None)
    if of is None:
        return None

    def sky(center: Icrs, radius_deg: float, mag_limit: float | None) -> Stars | None:
        try:
            return of.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        except BadCatalog:
            return None  # an online catalog that was reached for the frame itself

    return sky


def _places_px(measurements: Measurements) -> NDArray[np.float32]:
    """Where the brightest of them lie."""
    places = (measurements.x_px[:SEEN_AT_MOST], measurements.y_px[:SEEN_AT_MOST])
    return np.column_stack(places).astype(np.float32)


def _disproved(
    header: Hint, given: Hint | None, solution: Solution | None, identified: Identified
) -> tuple[Contradiction, ...]:
    """Which hints were wrong: told by the solution, else by the hints themselves."""
    if solution is None:
        return contradictions_of_hints(header, given) + identified.contradictions
    found: list[Contradiction] = []
    for hint in (given, header):
        if hint is not None:
            found += contradictions_with(hint, solution.center, solution.scale_arcsec_px)
    return tuple(dict.fromkeys(found))


def _quality(quality: SkyQuality | None, solution: Solution, zero_adu: float | None) -> SkyQuality | None:
    """What the frame tells about the night, now that its scale and its stars are known."""
    if quality is None:
        return None
    pairs = solution.identified
    clean = (pairs.flags & int(Flag.SATURATED | Flag.BLENDED | Flag.EDGE)) == 0
    return with_plate(
        quality,
        scale_arcsec_px=solution.scale_arcsec_px,
        mag=pairs.mag[clean],
        flux=pairs.flux[clean],
        bias_adu=zero_adu,
    )


def solve_file(
    source: Path | bytes | str,
    catalog: Catalog,
    hint: Hint | None = None,
    *,
    name: str | None = None,
    hdu: int | str | None = None,
    settings: SolveSettings | None = None,
) -> Verdict:
    """Read a file or an upload and solve it.

    Parameters
    ----------
    source : Path, str or bytes
        A path, or the file's content.
    catalog : Catalog
    hint : Hint, optional
    name : str, optional
        What to call it in messages.
    hdu : int or str, optional
        Which extension of a FITS file holds the image; chosen if left out.
    settings : SolveSettings, optional

    Returns
    -------
    Verdict
        With `Reason.BAD_FRAME` when it is no usable image.
    """
    began = time.monotonic()
    try:
        frame = read_frame(Path(source) if isinstance(source, str) else source, name=name, hdu=hdu, raw=True)
    except BadFrame as fault:
        spent = time.monotonic() - began
        return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times(read_s=spent, total_s=spent))
    read_s = time.monotonic() - began
    verdict = solve(frame, catalog, hint=hint, settings=settings)
    return replace(
        verdict, times=replace(verdict.times, read_s=read_s, total_s=verdict.times.total_s + read_s)
    )


def _solution(
    found: Identified,
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    steps: tuple[str, ...],
) -> Solution:
    plate, pairs = reference.plate, reference.pairs
    dxi, deta = reference.dxi_arcsec, reference.deta_arcsec
    covariance = reference.center_covariance_arcsec2
    pairs_told = identified_pairs(reference, stars, measurements)
    return Solution(
        center=plate.center(),
        center_sigma_arcsec=float(np.sqrt(0.5 * np.trace(covariance))),
        scale_arcsec_px=plate.scale_arcsec_px(),
        rotation_deg=plate.rotation_deg(),
        parity=plate.parity,
        rms_arcsec=float(np.sqrt(np.mean(dxi**2 + deta**2))),
        pairs=len(pairs),
        rejected=reference.rejected,
        false_probability=found.false_probability,
        mode=f"{'blind' if found.blind else 'full'}/{NAMES[plate.degree]}",
        wcs=wcs_cards(plate, width_px=measurements.width_px, height_px=measurements.height_px),
        center_covariance_arcsec2=covariance,
        identified=pairs_told,
        rejected_by=dict(reference.rejected_by),
        catalog=stars.source,
        catalog_steps=steps,
        errors=_budget(pairs_told, reference.extra_px * plate.scale_arcsec_px()),
    )


def _budget(pairs: IdentifiedPairs, other_arcsec: float) -> ErrorBudget:
    """Errors of the pairs in the fit."""

    def rms(sigma_arcsec: NDArray[np.float64]) -> float:
        known = sigma_arcsec[pairs.used & np.isfinite(sigma_arcsec)]
        return float(np.sqrt(np.mean(known**2))) if known.size else 0.0

    return ErrorBudget(rms(pairs.centroid_sigma_arcsec), rms(pairs.catalog_sigma_arcsec), other_arcsec)
