"""The record of an accuracy run: what `mountnav accuracy --json` prints; its tables are made from it."""

from __future__ import annotations

import math

from pydantic import BaseModel, Field

from api.cli.output import finite_or_none
from mountnav.identification.accuracy import (
    AccuracyRow,
    Indicators,
    accuracy_table,
    deviations,
    fit_factor,
    pooled,
)
from mountnav.identification.photometry import Photometry, fit_photometry
from mountnav.solution import Solution


class IndicatorRecord(BaseModel):
    """Indicators of one kind of deviation; null where there are too few values."""

    number: int
    mean: float | None
    standard_deviation: float | None
    least_modulus: float | None
    most_modulus: float | None


class RowRecord(BaseModel):
    """One column of the paper's Table 1."""

    rejected_percent: float
    ra_arcsec: IndicatorRecord = Field(description="ΔRA cos δ")
    dec_arcsec: IndicatorRecord
    mag: IndicatorRecord


class PhotometryRecord(BaseModel):
    """Brightness of one frame: m = -2.5 log10(ADU) + zero point + color term · (color - pivot)."""

    zero_point_mag: float
    zero_point_sigma_mag: float
    color_term: float = Field(description="0 where the pairs don't hold one")
    color_term_sigma: float | None
    pivot_mag: float | None = Field(description="Color that the zero point holds for")
    color_name: str
    band: str
    stars: int
    scatter_mag: float = Field(description="Beyond the errors of the fluxes")


class FrameAccuracy(BaseModel):
    """One frame: its indicators, or why it was not solved."""

    file: str
    solved: bool
    reason: str | None = None
    mode: str | None = None
    pairs: int | None = Field(default=None, description="In the fit")
    fit_factor: float | None = Field(
        default=None,
        description="sqrt(1 - p/n): so much smaller than their errors are deviations of the fit's own pairs",
    )
    photometry: PhotometryRecord | None = Field(
        default=None, description="null if fewer than three pairs are fit for it"
    )
    rows: list[RowRecord] = []


class AccuracyRecord(BaseModel):
    """Table 1 for a set of frames."""

    frames: list[FrameAccuracy]
    solved: int
    catalog: str
    every_pair: bool = Field(description="Also the pairs that K_rej rejected")
    leave_one_out: bool
    catalog_sigma_arcsec: float | None = Field(
        default=None, description="Only stars whose place the catalog states to be at least so good"
    )
    fit_factor: float | None
    overall: list[RowRecord]


def accuracy_record(
    outcomes: list[tuple[str, Solution | str]],
    rejected_percent: tuple[float, ...],
    *,
    every: bool,
    leave_one_out: bool,
    catalog_sigma_arcsec: float = math.inf,
) -> AccuracyRecord:
    """The record of a run, of each file and its solution or the reason why there is none.

    `every`, `leave_one_out` and `catalog_sigma_arcsec`: see `mountnav.identification.accuracy.deviations`.
    """
    frames, parts, parameters, pairs = [], [], 0.0, 0
    for file, outcome in outcomes:
        if isinstance(outcome, str):
            frames.append(FrameAccuracy(file=file, solved=False, reason=outcome))
            continue
        found = deviations(
            outcome,
            every=every,
            leave_one_out=leave_one_out,
            catalog_sigma_arcsec=catalog_sigma_arcsec,
        )
        parts.append(found)
        free = float(outcome.identified.leverage.sum())
        parameters, pairs = parameters + free, pairs + outcome.pairs
        frames.append(
            FrameAccuracy(
                file=file,
                solved=True,
                mode=outcome.mode,
                pairs=outcome.pairs,
                fit_factor=fit_factor(outcome.pairs, free),
                photometry=_photometry(fit_photometry(outcome.identified)),
                rows=[_row(row) for row in accuracy_table(found, rejected_percent)],
            )
        )
    catalogs = {outcome.catalog for _, outcome in outcomes if isinstance(outcome, Solution)}
    return AccuracyRecord(
        frames=frames,
        solved=len(parts),
        catalog=", ".join(sorted(catalogs)),
        every_pair=every,
        leave_one_out=leave_one_out,
        catalog_sigma_arcsec=catalog_sigma_arcsec if math.isfinite(catalog_sigma_arcsec) else None,
        fit_factor=fit_factor(pairs, parameters) if parts else None,
        overall=[_row(row) for row in accuracy_table(pooled(parts), rejected_percent)],
    )


def _photometry(fitted: Photometry | None) -> PhotometryRecord | None:
    if fitted is None:
        return None
    return PhotometryRecord(
        zero_point_mag=fitted.zero_point_mag,
        zero_point_sigma_mag=fitted.zero_point_sigma_mag,
        color_term=fitted.color_term,
        color_term_sigma=finite_or_none(fitted.color_term_sigma),
        pivot_mag=finite_or_none(fitted.pivot_mag),
        color_name=fitted.color_name,
        band=fitted.band,
        stars=fitted.stars,
        scatter_mag=fitted.scatter_mag,
    )


def _row(row: AccuracyRow) -> RowRecord:
    return RowRecord(
        rejected_percent=row.rejected_percent,
        ra_arcsec=_indicators(row.ra),
        dec_arcsec=_indicators(row.dec),
        mag=_indicators(row.mag),
    )


def _indicators(found: Indicators) -> IndicatorRecord:
    return IndicatorRecord(
        number=found.number,
        mean=finite_or_none(found.mean),
        standard_deviation=finite_or_none(found.standard_deviation),
        least_modulus=finite_or_none(found.least_modulus),
        most_modulus=finite_or_none(found.most_modulus),
    )
