"""The way through: measure, identify, fit, within a budget. The sky's troubles are answers, not errors."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from mountnav.catalog.stars import Catalog, Stars
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.plate import NAMES, center_covariance
from mountnav.identification.reference import Reference, identified_pairs
from mountnav.identification.search import identify
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Measurements
from mountnav.measuring.settings import MeasuringSettings
from mountnav.reading import read_frame
from mountnav.sky.coordinates import utc_now
from mountnav.solution import Reason, Solution, Times, Verdict


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """What may be set about a solve.

    Attributes
    ----------
    measuring : MeasuringSettings
    identification : IdentificationSettings
    budget_s : float
        Wall time for identification; measuring comes on top.
    """

    measuring: MeasuringSettings = field(default_factory=MeasuringSettings)
    identification: IdentificationSettings = field(default_factory=IdentificationSettings)
    budget_s: float = 30.0


def merged_hint(header: Hint, given: Hint | None) -> Hint:
    """The given hint, and where it is silent the header's.

    Parameters
    ----------
    header : Hint
    given : Hint or None

    Returns
    -------
    Hint
        Center and radius go together, and so do the two bounds of the scale.
    """
    if given is None:
        return header
    merged = header
    if given.center is not None:
        merged = replace(merged, center=given.center, radius_deg=given.radius_deg)
    if given.scale_low_arcsec_px is not None or given.scale_high_arcsec_px is not None:
        merged = replace(
            merged,
            scale_low_arcsec_px=given.scale_low_arcsec_px,
            scale_high_arcsec_px=given.scale_high_arcsec_px,
        )
    return merged


def epoch_of(utc: datetime) -> float:
    """Julian year of an instant: the epoch that proper motions are carried to."""
    # plain arithmetic: astropy warns of years before 1960, and the minute between UTC and TT moves no star
    return 2000.0 + (utc.timestamp() - 946_728_000.0) / (365.25 * 86_400.0)


def solve(
    frame: Frame, catalog: Catalog, *, hint: Hint | None = None, settings: SolveSettings | None = None
) -> Verdict:
    """Find out where a frame was taken.

    Parameters
    ----------
    frame : Frame
    catalog : Catalog
    hint : Hint, optional
        Goes before what the frame's header says, field by field.
    settings : SolveSettings, optional

    Returns
    -------
    Verdict
        Never raises for what the sky or the frame are like.
    """
    settings = settings or SolveSettings()
    began = time.monotonic()
    believed = merged_hint(frame.hint, hint)
    if believed.center is None:
        return Verdict(
            None,
            Reason.NO_HINT,
            f"{frame.source}: neither the header nor the caller says where it was taken",
            0,
            Times(total_s=time.monotonic() - began),
        )
    try:
        measurements = measure(frame, settings=settings.measuring)
    except BadFrame as fault:
        spent = time.monotonic() - began
        return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times(measure_s=spent, total_s=spent))
    measured = time.monotonic()
    utc = frame.mid_exposure_utc
    identified = identify(
        measurements,
        catalog,
        believed,
        epoch_yr=epoch_of(utc if utc is not None else utc_now()),
        settings=settings.identification,
        budget_s=settings.budget_s,
    )
    solution = None
    if identified.reference is not None and identified.stars is not None:
        solution = _solution(
            identified.reference, identified.stars, measurements, catalog.name, identified.false_probability
        )
    ended = time.monotonic()
    detail = identified.detail
    if utc is None:
        detail += "; the date is unknown, so stars were taken at today's places"
    return Verdict(
        solution=solution,
        reason=identified.reason,
        detail=detail,
        measured=len(measurements),
        times=Times(measure_s=measured - began, identify_s=ended - measured, total_s=ended - began),
    )


def solve_file(
    source: Path | bytes | str,
    catalog: Catalog,
    hint: Hint | None = None,
    *,
    name: str | None = None,
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
    settings : SolveSettings, optional

    Returns
    -------
    Verdict
        With `Reason.BAD_FRAME` when it is no usable image.
    """
    began = time.monotonic()
    try:
        frame = read_frame(Path(source) if isinstance(source, str) else source, name=name)
    except BadFrame as fault:
        spent = time.monotonic() - began
        return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times(read_s=spent, total_s=spent))
    read_s = time.monotonic() - began
    verdict = solve(frame, catalog, hint=hint, settings=settings)
    return replace(
        verdict, times=replace(verdict.times, read_s=read_s, total_s=verdict.times.total_s + read_s)
    )


def _solution(
    reference: Reference, stars: Stars, measurements: Measurements, catalog: str, false_probability: float
) -> Solution:
    plate, pairs = reference.plate, reference.pairs
    x, y = measurements.x_px[pairs.measurement], measurements.y_px[pairs.measurement]
    dxi, deta = reference.dxi_arcsec, reference.deta_arcsec
    covariance = center_covariance(plate, x, y, dxi, deta, reference.sigma_arcsec)
    return Solution(
        center=plate.center(),
        center_sigma_arcsec=float(np.sqrt(0.5 * np.trace(covariance))),
        scale_arcsec_px=plate.scale_arcsec_px(),
        rotation_deg=plate.rotation_deg(),
        parity=plate.parity,
        rms_arcsec=float(np.sqrt(np.mean(dxi**2 + deta**2))),
        pairs=len(pairs),
        rejected=reference.rejected,
        false_probability=false_probability,
        mode=f"full/{NAMES[plate.degree]}",
        wcs=wcs_cards(plate, width_px=measurements.width_px, height_px=measurements.height_px),
        center_covariance_arcsec2=covariance,
        identified=identified_pairs(reference, stars, measurements),
        rejected_by=dict(reference.rejected_by),
        catalog=catalog,
    )
