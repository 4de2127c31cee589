"""The way of a frame: read, measure, identify, fit, judge. Troubles of the sky are verdicts, not errors."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.catalog_set import CatalogSet, Choice
from mountnav.catalog.stars import Catalog, Stars
from mountnav.clock import utc_now
from mountnav.errors import BadCatalog, BadFrame
from mountnav.frames import Frame, Hint, StarList
from mountnav.identification.fast import FastResult, identify_fast
from mountnav.identification.plate import CUBIC, NAMES
from mountnav.identification.reference import Reference, identified_pairs
from mountnav.identification.refusal import Refusal
from mountnav.identification.search import Reach, without_place
from mountnav.identification.selection import star_like
from mountnav.identification.trail_check import StarsInCone, TrailCheck, check_trails
from mountnav.identification.verification import Identified
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.fast.coarse import Summed
from mountnav.measuring.measurements import Flag, Measurements, SkyQuality, with_plate
from mountnav.reading import ListFormat, demosaiced, read_source
from mountnav.sky.coordinates import Icrs
from mountnav.solution import (
    MOST_CARD,
    SEEN_AT_MOST,
    Contradiction,
    ErrorBudget,
    IdentifiedPairs,
    Origin,
    PriorPart,
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
from mountnav.solving.priors import CameraPrior, prior_of
from mountnav.solving.settings import SolveSettings
from mountnav.solving.special_frames import SpecialFrame, special_frame
from mountnav.solving.wide_fields import (
    WideField,
    bent,
    lens_for_bent,
    may_be_wide,
    solution_of,
    solve_middle,
)
from mountnav.units import julian_year

PRIOR_SHARE = 0.25
"""Of the budget that is left, for a search with a prior: what is found so takes a hundredth of it, and what
isn't needs the rest. Chosen by hand."""

SPECIAL_SHARE = 0.5
"""Of the budget, for a frame that was made ordinary; chosen by hand."""

__all__ = [
    "SolveSettings",
    "merged_hint",
    "solve",
    "solve_file",
    "solve_source",
    "solve_stars",
]


def merged_hint(header: Hint, given: Hint | None) -> Hint:
    """The given hint, and where it is silent the header's.

    Returns
    -------
    Hint
        Center and radius go together, and so do the two bounds of the scale. What the header says otherwise
        is kept as alternatives: the caller may be wrong.
    """
    if given is None:
        return header
    merged = _over(header, given)
    others = [_over(alternative, given) for alternative in header.alternatives] + list(given.alternatives)
    others += [_over(given, alternative) for alternative in (header, *header.alternatives)]
    plain = replace(merged, alternatives=())
    kept: list[Hint] = []
    for other in others:
        bare = replace(other, alternatives=())
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


def solve(
    frame: Frame,
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SolveSettings | None = None,
    measurements: Measurements | None = None,
) -> Verdict:
    """Find out where a frame was taken: read, measure, identify, fit, judge.

    Parameters
    ----------
    catalog : Catalog
        One, or a `CatalogSet` of several, of which the frame's field, position and epoch choose.
    hint : Hint, optional
        Goes before what the frame's header says, field by field.
    measurements : Measurements, optional
        What `measure` made of this frame already; it is neither calibrated nor measured again then.

    Returns
    -------
    Verdict
        Never raises for what the sky or the frame are like.
    """
    job = _job(frame, catalog, hint, settings or SolveSettings())
    nowhere = without_place(job.believed, job.reach)
    if nowhere is not None:
        return _unplaced(job, nowhere)
    try:
        if measurements is None:
            job = _read(job)
            special = special_frame(job.frame)
            if special is not None:
                found = _solve_special(job, special)
                if found.solved or special.sure:
                    return found
                left_s = (1.0 - SPECIAL_SHARE) * job.settings.budget_s
                # each hypothesis of that search was one more chance to be fooled
                reach = replace(job.reach, tried=int(found.numbers.get("hypotheses", 0.0)))
                job = replace(job, settings=replace(job.settings, budget_s=left_s), reach=reach)
            if job.settings.exposures > 1:
                return _plate_solved(job)
        job = _with_catalogs(job)
        measured = _measure(job) if measurements is None else _Measured(measurements, len(measurements))
    except BadFrame as fault:
        spent_s = job.spent_s
        return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times(measure_s=spent_s, total_s=spent_s))
    return _answered(job, measured)


def solve_stars(
    stars: StarList,
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SolveSettings | None = None,
    mid_exposure_utc: datetime | None = None,
    tried: int = 0,
) -> Verdict:
    """Find out where a frame was taken whose stars somebody else has measured.

    Parameters
    ----------
    hint : Hint, optional
        Goes before what the list's header says.
    mid_exposure_utc : datetime, optional
        When the stars were taken, where that is known.
    tried : int
        Hypotheses that were tried for the same frame before: the odds count them.

    Returns
    -------
    Verdict
        Its notes tell that the light of the stars was not looked at: a list of the pieces of trails can't be
        told from one of stars. There is no quality.
    """
    # a frame of the list's size that takes no memory: nothing looks at its pixels
    nothing = np.broadcast_to(np.zeros((), np.uint8), (stars.height_px, stars.width_px))
    frame = Frame(nothing, mid_exposure_utc, hint=stars.hint, source=stars.source)
    job = replace(_job(frame, catalog, hint, settings or SolveSettings()), light=False)
    job = replace(job, reach=replace(job.reach, tried=tried))
    nowhere = without_place(job.believed, job.reach)
    if nowhere is not None:
        return _unplaced(job, nowhere)
    job = _with_catalogs(job)
    note = "solved from a list of stars: their light was not looked at"
    job = replace(job, notes=(*job.notes, note))
    measured = _Measured(_measured_elsewhere(stars), len(stars.x_px))
    return _answered(job, measured)


def _measured_elsewhere(stars: StarList) -> Measurements:
    """A list of stars as measurements, the brightest first: their errors and shapes are unknown."""
    count = stars.x_px.size
    unknown = np.full(count, np.nan)
    known = np.isfinite(stars.flux)
    order = np.argsort(-np.where(known, stars.flux, -np.inf), kind="stable")
    # the search wants an order: stars whose brightness isn't told come in that of the list
    ranked = np.arange(count, 0, -1, dtype=np.float64)
    flux = np.where(known, stars.flux, np.nan)[order] if known.any() else ranked
    return Measurements(
        x_px=stars.x_px[order],
        y_px=stars.y_px[order],
        x_sigma_px=unknown,
        y_sigma_px=unknown,
        flux=flux,
        flux_sigma=unknown,
        fwhm_px=unknown,
        ellipticity=np.zeros(count),
        flags=np.zeros(count, dtype=np.int64),
        width_px=stars.width_px,
        height_px=stars.height_px,
        background_adu=0.0,
        noise_adu=1.0,
    )


def _solve_special(job: _Job, special: SpecialFrame) -> Verdict:
    """Solve a frame that was made ordinary: the verdict on the frame as it was."""
    given = None if job.given is None else special.widened(job.given)
    # the rest stays for the frame as it was: what its header or its levels say may be wrong
    budget_s = job.settings.budget_s * (1.0 if special.sure else SPECIAL_SHARE)
    settings = replace(job.settings, calibration=None, budget_s=budget_s, priors=())
    inner = solve(special.frame, job.catalog, hint=given, settings=settings)
    verdict = special.back(inner)
    if inner.further:
        others = (special.back(replace(inner, solution=one)).solution for one in inner.further)
        verdict = replace(verdict, further=tuple(one for one in others if one is not None))
    return replace(verdict, notes=(*job.notes, *verdict.notes))


def _plate_solved(job: _Job) -> Verdict:
    """The verdict on a photographic plate, with all its exposures."""
    from mountnav.solving.exposures import solve_plate  # it asks for star lists to be solved here

    settings = replace(job.settings, calibration=None)
    verdict = solve_plate(
        job.frame, job.catalog, hint=job.given, settings=settings, tried=job.reach.tried, read_s=job.read_s
    )
    return replace(verdict, notes=(*job.notes, *verdict.notes))


@dataclass(frozen=True, slots=True)
class _Job:
    """One solve: what is asked, and what is known before anything is measured.

    Attributes
    ----------
    frame : Frame
        Calibrated and without a mosaic once it is read.
    given : Hint or None
        What the caller says.
    believed : Hint
        That, and where it is silent the header's.
    epoch_yr : float
        Julian year of the frame; the present one where its date is unknown.
    began_s : float
        On `time.monotonic`.
    read_s : float
        Wall time of calibration and of taking the mosaic apart.
    choices : tuple of Choice
        Catalogs for this frame, the best first.
    notes : tuple of str
        What reading found besides, and what calibration could not do.
    zero_adu : float or None
        Level of no light, as calibration knows it.
    light : bool
        The frame's pixels are at hand, so that a solution can be held against its stars' light.
    prior : CameraPrior or None
        What other frames of its camera taught.
    narrowed : Hint or None
        What is believed with the prior's scale, where that saves something.
    """

    frame: Frame
    catalog: Catalog
    given: Hint | None
    believed: Hint
    settings: SolveSettings
    epoch_yr: float
    reach: Reach
    began_s: float
    read_s: float = 0.0
    choices: tuple[Choice, ...] = ()
    notes: tuple[str, ...] = ()
    zero_adu: float | None = None
    light: bool = True
    prior: CameraPrior | None = None
    narrowed: Hint | None = None

    def turns(self) -> Iterator[tuple[Hint, Reach]]:
        """What is sought, and how far: with the prior what the hint says and no more, then as without it."""
        if self.narrowed is not None:
            yield self.narrowed, replace(self.reach, thorough=False, blind="never")
        yield self.believed, self.reach

    @property
    def spent_s(self) -> float:
        """Wall time so far."""
        return time.monotonic() - self.began_s


@dataclass(frozen=True, slots=True)
class _Checked:
    """A solution held against the light of its stars, and how its catalog's stars were come by."""

    light: TrailCheck
    catalog_steps: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Measured:
    """The sources of a frame; and what was found with the brightest alone, where that was enough.

    Attributes
    ----------
    count : int
        Sources seen: of a frame solved fast, those that were detected.
    measure_s : float
        Wall time of reading and measuring.
    searched_s : float
        Processor time that a fast search has taken of the budget.
    tried : int
        Hypotheses that it tried: the odds of what follows count them.
    held : bool
        It was solved by the prior's scale.
    """

    measurements: Measurements
    count: int
    measure_s: float = 0.0
    searched_s: float = 0.0
    tried: int = 0
    solved_fast: _Checked | None = None
    held: bool = False


@dataclass(frozen=True, slots=True)
class _Fitted:
    """What came of it: the solution, or a refusal that `found` gives the reason of."""

    found: Identified
    measurements: Measurements
    solution: Solution | None
    quality: SkyQuality | None
    catalog_steps: tuple[str, ...]
    notes: tuple[str, ...] = ()


def _job(frame: Frame, catalog: Catalog, given: Hint | None, settings: SolveSettings) -> _Job:
    utc = frame.mid_exposure_utc or settings.undated_utc or utc_now()
    believed = merged_hint(frame.hint, given)
    prior = None
    if settings.priors:
        camera = _card(frame, "INSTRUME"), _card(frame, "TELESCOP")
        prior = prior_of(settings.priors, *camera, frame.width_px, frame.height_px)
    return _Job(
        frame=frame,
        catalog=catalog,
        given=given,
        believed=believed,
        prior=prior,
        narrowed=None if prior is None else prior.narrowed(believed),
        settings=settings,
        epoch_yr=julian_year(utc),
        reach=Reach(settings.index, settings.blind),
        began_s=time.monotonic(),
        notes=frame.notes,
    )


def _unplaced(job: _Job, refusal: Refusal) -> Verdict:
    """The verdict on a frame without a hint of where it is, where the whole sky may not be searched."""
    return Verdict(
        None,
        refusal.reason,
        f"{job.frame.source}: {refusal.detail}",
        0,
        Times(total_s=job.spent_s),
        contradictions=contradictions_of_hints(job.frame.hint, job.given),
    )


# -- read ----------------------------------------------------------------------------------------------------


def _read(job: _Job) -> _Job:
    """Calibrate the frame, and take its mosaic apart."""
    frame, notes, zero_adu = job.frame, job.notes, None
    if job.settings.calibration is not None:
        frame, done = job.settings.calibration.applied(frame)
        notes = (*notes, *done.not_applied, *done.warnings)
        zero_adu = done.zero_adu
    frame = demosaiced(frame)
    return replace(job, frame=frame, notes=notes, zero_adu=zero_adu, read_s=job.spent_s)


def _with_catalogs(job: _Job) -> _Job:
    """Choose the catalogs for the frame."""
    blind = job.settings.blind
    choices = catalogs_for(job.catalog, job.believed, job.frame, blind, epoch_yr=job.epoch_yr)
    reach = replace(job.reach, indexed=index_catalog(job.catalog, choices[0]))
    return replace(job, choices=choices, reach=reach)


# -- measure -------------------------------------------------------------------------------------------------


def _measure(job: _Job) -> _Measured:
    """The frame's sources: the brightest alone where these solve it, else all of them."""
    measure_s, searched_s, tried = job.read_s, 0.0, job.reach.tried
    for hint, reach in job.turns():
        computed_s = time.thread_time()
        left_s = job.settings.budget_s - searched_s
        share = PRIOR_SHARE if hint is job.narrowed else 1.0
        fast = _identify_fast(job, hint, replace(reach, tried=tried), share * left_s)
        searched_s += max(0.0, time.thread_time() - computed_s - fast.measure_s)
        measure_s += fast.measure_s
        tried = fast.tried
        if fast.identified is not None:
            assert fast.measurements is not None
            checked = _check(job, fast.identified, fast.measurements, fast.summed)
            # pieces of trails pass for stars in a fast search; measured in full, each trail may be one source
            if checked.light.points:
                held = hint is job.narrowed
                return _Measured(fast.measurements, fast.seen, measure_s, searched_s, tried, checked, held)
            break
    from mountnav.measuring.measure import (
        measure,  # slow to import, and a frame that is solved fast does without
    )

    before_s = time.monotonic()
    measurements = measure(job.frame, settings=job.settings.measuring)
    measure_s += time.monotonic() - before_s
    return _Measured(measurements, len(measurements), measure_s, searched_s, tried)


def _identify_fast(job: _Job, hint: Hint, reach: Reach, budget_s: float) -> FastResult:
    """Try with the brightest sources alone, where the settings allow it."""
    settings, nothing = job.settings, FastResult(tried=reach.tried)
    if not settings.glance or settings.identification.v_min_ident is not None:
        return nothing
    try:
        return identify_fast(
            job.frame,
            job.choices[0].catalog,
            hint,
            epoch_yr=job.epoch_yr,
            settings=settings.identification,
            measuring=settings.measuring,
            budget_s=budget_s,
            reach=reach,
        )
    except BadCatalog:
        if len(job.choices) == 1:
            raise
        return nothing  # the search in full passes the catalog over


def _answered(job: _Job, measured: _Measured) -> Verdict:
    """The verdict on what was measured."""
    identified, held = _identify(job, measured)
    wide = _wide_field(job, measured, identified)
    fitted = _fit(job, measured, identified) if wide is None else _fit_wide(job, wide)
    verdict = _judge(job, measured, fitted)
    if job.prior is None:
        return verdict
    prior = job.prior
    part = PriorPart(
        prior.frames, prior.scale_low_arcsec_px, prior.scale_high_arcsec_px, held and verdict.solved
    )
    solution, told = verdict.solution, verdict.contradictions
    if solution is not None:
        told = (*told, *contradictions_with(prior.hint, solution.center, solution.scale_arcsec_px))
    return replace(verdict, prior=None if job.narrowed is None else part, contradictions=told)


# -- identify ------------------------------------------------------------------------------------------------


def _identify(job: _Job, measured: _Measured) -> tuple[_Checked | Identified, bool]:
    """Which stars the sources are: checked against their light, or the refusal of the search.

    And whether the prior's scale told.
    """
    if measured.solved_fast is not None:
        return measured.solved_fast, measured.held
    tried, began_s = measured.tried, time.thread_time()
    for hint, reach in job.turns():
        assumed = hint is job.narrowed
        left_s = job.settings.budget_s - measured.searched_s - (time.thread_time() - began_s)
        found = identify_with_catalogs(
            job.choices[:1] if assumed else job.choices,
            measured.measurements,
            hint,
            replace(reach, tried=tried),
            job.settings,
            job.epoch_yr,
            (PRIOR_SHARE if assumed else 1.0) * left_s,
        )
        if found.reference is not None:
            return _check(job, found, measured.measurements), assumed
        tried = found.tried
    return found, False


def _check(
    job: _Job,
    found: Identified,
    measurements: Measurements,
    summed: Summed | None = None,
) -> _Checked:
    """Take the stars of the best catalog, and hold the solution against the light of these stars.

    `summed` is the frame in bins, where the fast search has summed it already.
    """
    settings = job.settings.identification
    best, steps = with_best_catalog(job.catalog, job.choices, found, measurements, settings, job.epoch_yr)
    if best.reference is None or not job.light:
        return _Checked(TrailCheck(best, measurements, None, points=True), steps)
    cone = _stars_in_cone(best.stars, job)
    light = check_trails(best, measurements, job.frame.pixels, settings, sky=cone, summed=summed)
    return _Checked(light, steps)


def _wide_field(job: _Job, measured: _Measured, identified: _Checked | Identified) -> WideField | None:
    """The lens of a frame that no plate holds, or holds as well; None for all others."""
    settings = job.settings.identification
    if settings.v_min_ident is not None:
        return None  # the paper's own method knows no lenses
    if isinstance(identified, _Checked):
        light = identified.light
        reference = light.found.reference
        if reference is None or not light.points or light.found.stars is None:
            return None
        m = light.measurements
        if not bent(reference.plate, m.width_px, m.height_px):
            return None
        catalog = _catalog_of(light.found.stars, job)
        if catalog is None:
            return None
        return lens_for_bent(light.found, m, lambda: _measured_whole(job, measured), catalog, job.epoch_yr)
    if not may_be_wide(identified, job.believed, measured.measurements):
        return None
    try:
        return solve_middle(
            measured.measurements,
            job.frame.pixels if job.light else None,
            job.choices[0].catalog,
            job.believed,
            replace(job.reach, tried=max(identified.tried, measured.tried)),
            settings,
            epoch_yr=job.epoch_yr,
            budget_s=job.settings.budget_s,
            sky=lambda stars: _stars_in_cone(stars, job),
        )
    except BadCatalog:
        return None  # what is wrong with it is told by the search before


def _measured_whole(job: _Job, measured: _Measured) -> Measurements:
    """All sources of the frame."""
    if measured.solved_fast is None or not job.light:
        return measured.measurements
    from mountnav.measuring.measure import measure

    return measure(job.frame, settings=job.settings.measuring)


# -- fit -----------------------------------------------------------------------------------------------------


def _fit_wide(job: _Job, wide: WideField) -> _Fitted:
    """The solution that a lens gives."""
    found = Identified(
        None,
        wide.fit.stars,
        None,
        wide.detail,
        wide.false_probability,
        {"pairs": float(len(wide.fit.pairs)), "holds_to_deg": math.degrees(wide.fit.reach_rad)},
        blind=wide.blind,
    )
    solution = solution_of(wide, (*job.choices[0].steps, *wide.fit.stars.steps))
    m = wide.measurements
    return _Fitted(
        found, m, solution, _quality(m.quality, solution, job.zero_adu), solution.catalog_steps, wide.notes
    )


def _fit(job: _Job, measured: _Measured, identified: _Checked | Identified) -> _Fitted:
    """The solution that the identified pairs hold, or the refusal with advice."""
    measurements, quality = measured.measurements, measured.measurements.quality
    if isinstance(identified, Identified):
        if identified.reason is Reason.CATALOG_TOO_SHALLOW:
            seen = len(star_like(measurements))
            identified = with_catalog_advice(identified, job.catalog, job.believed, job.frame, seen)
        return _Fitted(identified, measurements, None, quality, job.choices[0].steps)
    found, measurements, steps = (
        identified.light.found,
        identified.light.measurements,
        identified.catalog_steps,
    )
    if found.stars is not None:
        steps = (*steps, *found.stars.steps)
    if found.reference is None or found.stars is None:
        return _Fitted(found, measurements, None, quality, steps)
    solution = _solution(found, found.reference, found.stars, measurements, steps)
    return _Fitted(found, measurements, solution, _quality(quality, solution, job.zero_adu), steps)


# -- judge ---------------------------------------------------------------------------------------------------


def _judge(job: _Job, measured: _Measured, fitted: _Fitted) -> Verdict:
    """The verdict: the solution or the reason for none, wrong hints, notes, times."""
    found, solution, notes = fitted.found, fitted.solution, (*job.notes, *fitted.notes)
    if solution is None and isinstance(job.catalog, CatalogSet):
        notes = (*notes, *(f"catalog: {step}" for step in fitted.catalog_steps))
    total_s = job.spent_s
    if job.frame.mid_exposure_utc is None:
        chosen = job.settings.undated_utc
        when = "today's places" if chosen is None else f"their places of {chosen:%Y-%m-%d}"
        notes = (*notes, f"the date is unknown, so stars were taken at {when}")
    return Verdict(
        solution=solution,
        reason=found.reason,
        detail=found.detail,
        measured=measured.count,
        times=Times(measure_s=measured.measure_s, identify_s=total_s - measured.measure_s, total_s=total_s),
        numbers=found.numbers | ({"blind": 1.0} if found.blind else {}),
        contradictions=_wrong_hints(job.frame.hint, job.given, solution, found),
        quality=fitted.quality,
        notes=notes,
        seen_px=_brightest_px(fitted.measurements),
        seen_flux=fitted.measurements.flux[:SEEN_AT_MOST].astype(np.float32),
    )


def _catalog_of(stars: Stars | None, job: _Job) -> Catalog | None:
    """Which of the catalogs stars are from; None if of none that is installed."""
    known = [choice.catalog for choice in job.choices]
    if not isinstance(job.catalog, CatalogSet):
        known.append(job.catalog)
    return next((catalog for catalog in known if stars is not None and catalog.name == stars.source), None)


def _stars_in_cone(stars: Stars | None, job: _Job) -> StarsInCone | None:
    """Where more stars of the same catalog are to be had; None if it is none of those installed."""
    of = _catalog_of(stars, job)
    if of is None:
        return None

    def cone(center: Icrs, radius_deg: float, mag_limit: float | None) -> Stars | None:
        try:
            return of.cone(center, radius_deg, epoch_yr=job.epoch_yr, mag_limit=mag_limit)
        except BadCatalog:
            return None  # an online catalog that was reached for the frame itself

    return cone


def _brightest_px(measurements: Measurements) -> NDArray[np.float32]:
    """Where the brightest sources lie."""
    places = (measurements.x_px[:SEEN_AT_MOST], measurements.y_px[:SEEN_AT_MOST])
    return np.column_stack(places).astype(np.float32)


def _wrong_hints(
    header: Hint, given: Hint | None, solution: Solution | None, identified: Identified
) -> tuple[Contradiction, ...]:
    """Which hints were wrong: by the solution, else by what they say of each other."""
    if solution is None:
        return contradictions_of_hints(header, given) + identified.contradictions
    found: list[Contradiction] = []
    for hint in (given, header):
        if hint is not None:
            found += contradictions_with(hint, solution.center, solution.scale_arcsec_px)
    return tuple(dict.fromkeys(found))


def _quality(quality: SkyQuality | None, solution: Solution, zero_adu: float | None) -> SkyQuality | None:
    """What the frame shows of the night, now that its scale and its stars are known."""
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
    stars: ListFormat | None = None,
) -> Verdict:
    """Read a file or an upload, an image or a list of stars, and solve it.

    Parameters
    ----------
    source : Path, str or bytes
        A path, or the file's content.
    name : str, optional
        What to call it in messages.
    hdu : int or str, optional
        Which extension of a FITS file holds the image; chosen if left out.
    stars : ListFormat, optional
        How a list of stars is to be read.

    Returns
    -------
    Verdict
        With `Reason.BAD_FRAME` when it is neither a usable image nor a list of stars.
    """
    began = time.monotonic()
    try:
        return solve_source(
            Path(source) if isinstance(source, str) else source,
            catalog,
            hint,
            name=name,
            hdu=hdu,
            settings=settings,
            stars=stars,
        )
    except BadFrame as fault:
        spent = time.monotonic() - began
        return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times(read_s=spent, total_s=spent))


def solve_source(
    source: Path | bytes,
    catalog: Catalog,
    hint: Hint | None = None,
    *,
    name: str | None = None,
    hdu: int | str | None = None,
    settings: SolveSettings | None = None,
    stars: ListFormat | None = None,
) -> Verdict:
    """As `solve_file`, but what is neither an image nor a list of stars raises.

    Raises
    ------
    BadFrame
        Neither an image nor a list of stars.
    """
    began = time.monotonic()
    found = read_source(source, name=name, hdu=hdu, raw=True, stars=stars)
    read_s = time.monotonic() - began
    if isinstance(found, StarList):
        verdict = solve_stars(found, catalog, hint=hint, settings=settings)
    else:
        verdict = solve(found, catalog, hint=hint, settings=settings)
    times = replace(verdict.times, read_s=read_s, total_s=verdict.times.total_s + read_s)
    return replace(verdict, times=times, origin=_origin(found))


def _origin(found: Frame | StarList) -> Origin:
    """Where it comes from, as its header says."""
    if isinstance(found, StarList):
        return Origin()

    return Origin(
        _card(found, "INSTRUME"), _card(found, "TELESCOP"), _card(found, "OBJECT"), found.mid_exposure_utc
    )


def _card(frame: Frame, key: str) -> str:
    """A text of the header, such that it can be shown."""
    text = str(frame.header.get(key, "")).strip()[:MOST_CARD]
    return "".join(
        character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text
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
        mode=f"{'blind' if found.blind else 'full'}/{NAMES[min(plate.degree, CUBIC)]}",
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
