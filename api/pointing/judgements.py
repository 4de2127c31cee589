"""What solved looks say of a mount, for HTTP and commands: the doctor's, and its drift."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from api.pointing.looks import read_looks, read_model
from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.pointing.doctor import ORDINARY, Diagnosis, Finding, Geometry, diagnose, within
from mountnav.pointing.doctor.facts import geometry_of
from mountnav.pointing.doctor.findings import Mounting
from mountnav.pointing.drift import DriftReport, Stretch, drift_report
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Site

MOUNTINGS: tuple[Mounting, ...] = ("german", "fork", "altaz")


def run_doctor(
    source: str | None,
    *,
    config: Path | None,
    telescope: str | None,
    since: str | None,
    until: str | None,
    latitude: float | None,
    longitude: float | None,
    epoch: str | None,
    mounting: str | None,
    parity: int | None,
    rotator: bool,
    model: Path | None,
    points_within: float | None,
    unsynced: bool,
    as_json: bool,
) -> int:
    """Diagnose and print; 0 if nothing is wrong or nothing can be told, 1 if something is wrong.

    Raises
    ------
    BadRequest
        Options that make no sense, a bad file, no site.
    """
    known = next((one for one in MOUNTINGS if one == mounting), None)
    if mounting is not None and known is None:
        raise BadRequest(f"--mounting {mounting}", advice=f"one of {', '.join(MOUNTINGS)}")
    found = read_looks(
        source,
        config=config,
        telescope=telescope,
        since=since,
        until=until,
        latitude=latitude,
        longitude=longitude,
        epoch=epoch,
        mounting=known,
        unsynced=unsynced,
    )
    diagnosis = diagnosed(
        found.observations,
        site=found.site,
        epoch=found.epoch,
        mounting=found.mounting,
        parity=parity,
        rotator=rotator,
        model=read_model(model),
        points_within_arcsec=points_within,
        synced_on=found.synced_on,
    )
    if as_json:
        sys.stdout.write(json.dumps(diagnosis.as_dict(), allow_nan=False) + "\n")
    else:
        sys.stdout.write(_diagnosis_text(diagnosis))
    return 1 if diagnosis.healthy is False else 0


def diagnosed(
    observations: Sequence[PointingObservation],
    *,
    site: Site,
    epoch: Epoch,
    mounting: Mounting | None = None,
    parity: int | None = None,
    rotator: bool = False,
    model: PointingModel | None = None,
    points_within_arcsec: float | None = None,
    synced_on: Sequence[PointingObservation] | None = None,
    sign_confirmed: bool = False,
) -> Diagnosis:
    """Diagnose with all that is known of the mount; see `mountnav.pointing.doctor.diagnose`.

    Raises
    ------
    BadRequest
        A value is out of range.
    """
    geometry: tuple[Geometry, ...] = ORDINARY
    noise = None
    if points_within_arcsec is not None:
        if not points_within_arcsec > 0.0:
            raise BadRequest(f"{points_within_arcsec}″ is no pointing error", advice="> 0")
        geometry = within(points_within_arcsec)
    if model is not None:
        geometry, noise = geometry_of(model)
    return diagnose(
        observations,
        site=site,
        believed_epoch=epoch,
        expected_parity=parity,
        mounting=mounting,
        rotator=rotator,
        geometry=geometry,
        noise_arcsec=noise,
        synced_on=synced_on,
        sign_confirmed=sign_confirmed,
    )


def diagnosis_view(
    observations: Sequence[PointingObservation],
    *,
    site: Site,
    epoch: Epoch,
    mounting: Mounting | None = None,
    parity: int | None = None,
    rotator: bool = False,
    model: PointingModel | None = None,
    synced_on: Sequence[PointingObservation] | None = None,
    sign_confirmed: bool = False,
) -> dict[str, object]:
    """Diagnose as plain values, for HTTP; docs/doctor.md describes them. Raises `BadRequest`."""
    return diagnosed(
        observations,
        site=site,
        epoch=epoch,
        mounting=mounting,
        parity=parity,
        rotator=rotator,
        model=model,
        synced_on=synced_on,
        sign_confirmed=sign_confirmed,
    ).as_dict()


def _diagnosis_text(diagnosis: Diagnosis) -> str:
    lines = [f"{diagnosis.observations} looks"]
    for caption, findings in (("FOUND", diagnosis.findings), ("NOT SURE", diagnosis.suspicions)):
        for one in findings:
            lines += _finding(caption, one)
    if not diagnosis.findings and not diagnosis.suspicions:
        lines.append(diagnosis.words)
    return "\n".join(lines) + "\n"


def _finding(caption: str, one: Finding) -> list[str]:
    lines = [f"{caption}: {one.what} (probability {one.probability:.4g})", f"  {one.words}"]
    if one.alternatives:
        lines.append(f"  it may also be: {', '.join(one.alternatives)}")
    lines.append(f"  what to do: {one.advice}")
    if one.look_ids and any(one.look_ids):
        lines.append(f"  looks: {', '.join(one.look_ids)}")
    return lines


DRIFT_HEAD = "from (UTC)           min looks   HA h   Dec °      east ″/h            north ″/h        jumps"


def run_drift(
    source: str | None,
    *,
    config: Path | None,
    telescope: str | None,
    since: str | None,
    until: str | None,
    latitude: float | None,
    longitude: float | None,
    model: Path | None,
    worm_period: float | None,
    mount_refracts: bool,
    as_json: bool,
) -> int:
    """Report and print; 0 if a drift is known, else 1.

    Raises
    ------
    BadRequest
        Options that make no sense, a bad file, no site.
    """
    found = read_looks(
        source,
        config=config,
        telescope=telescope,
        since=since,
        until=until,
        latitude=latitude,
        longitude=longitude,
    )
    report = drift_reported(
        found.observations,
        site=found.site,
        slew_ends=found.slew_ends,
        model=read_model(model),
        worm_period_s=worm_period,
        mount_refracts=mount_refracts,
        altaz=found.mounting == "altaz",
    )
    if as_json:
        sys.stdout.write(json.dumps(report.as_dict(), allow_nan=False) + "\n")
    else:
        sys.stdout.write(_drift_text(report))
    return 0 if any(one.rates is not None for one in report.stretches) else 1


def drift_reported(
    observations: Sequence[PointingObservation],
    *,
    site: Site,
    slew_ends: Sequence[datetime] = (),
    model: PointingModel | None = None,
    worm_period_s: float | None = None,
    mount_refracts: bool = False,
    altaz: bool = False,
) -> DriftReport:
    """Report with all that is known of the mount; see `mountnav.pointing.drift.drift_report`."""
    terms = None
    if model is not None and model.kind == "equatorial":
        values = zip(model.coefficients_arcsec, model.sigma_arcsec, strict=True)
        terms = dict(zip(model.terms, values, strict=True))
    return drift_report(
        observations,
        site=site,
        slew_ends=slew_ends,
        model_terms=terms,
        worm_period_s=worm_period_s,
        mount_refracts=mount_refracts,
        altaz=altaz,
    )


def drift_view(
    observations: Sequence[PointingObservation],
    *,
    site: Site,
    slew_ends: Sequence[datetime] = (),
    model: PointingModel | None = None,
    worm_period_s: float | None = None,
    mount_refracts: bool = False,
    altaz: bool = False,
) -> dict[str, object]:
    """Report as plain values, for HTTP; docs/drift.md describes them."""
    return drift_reported(
        observations,
        site=site,
        slew_ends=slew_ends,
        model=model,
        worm_period_s=worm_period_s,
        mount_refracts=mount_refracts,
        altaz=altaz,
    ).as_dict()


def _drift_text(report: DriftReport) -> str:
    lines = [DRIFT_HEAD] if report.stretches else []
    lines += [_drift_row(one) for one in report.stretches]
    periodic, settled, polar = report.periodic, report.settling, report.polar
    lines.append("")
    if periodic is not None:
        lines.append(
            f"periodic error: ±{periodic.amplitude_arcsec:.2f} ± {periodic.amplitude_sigma_arcsec:.2f}″ "
            f"of the axis in {periodic.period_s:.1f} ± {periodic.period_sigma_s:.1f} s "
            f"(by chance: {periodic.false_alarm:.1g})"
        )
        if periodic.aliases_s:
            lines.append(
                f"  or in {', '.join(f'{one:.1f}' for one in periodic.aliases_s)} s: looks come too evenly"
            )
    else:
        lines.append(f"periodic error: unknown: {report.periodic_reason}")
    if settled is not None:
        parts = [f"at most {settled.most_s:.0f} s"]
        parts += [] if settled.least_s is None else [f"once more than {settled.least_s:.0f} s"]
        parts += [] if settled.typical_s is None else [f"{settled.typical_s:.0f} ± {settled.sigma_s:.0f} s"]
        lines.append(f"settle time: {', '.join(reversed(parts))} ({settled.slews} slews)")
    else:
        lines.append(f"settle time: unknown: {report.settling_reason}")
    if polar is not None:
        for name, one in (("drift", polar.from_drift), ("model", polar.from_model)):
            if one is not None:
                lines.append(
                    f"polar axis from {name}: ME {one.me_arcsec:+.0f} ± {one.me_sigma_arcsec:.0f}″, "
                    f"MA {one.ma_arcsec:+.0f} ± {one.ma_sigma_arcsec:.0f}″"
                )
        lines.append(f"advice: {polar.advice}")
    if report.polar_reason:
        lines.append(f"polar axis from drift: unknown: {report.polar_reason}")
    return "\n".join(lines) + "\n"


def _drift_row(one: Stretch) -> str:
    minutes = (one.stop - one.start).total_seconds() / 60.0
    where = f"{one.ha_deg / 15.0:+6.2f} {one.dec_deg:+7.2f}"
    row = f"{one.start:%Y-%m-%d %H:%M:%S} {minutes:4.0f} {one.looks:5d} {where}"
    if one.rates is None:
        return f"{row}   {one.reason}"
    rates = one.rates
    return (
        f"{row} {rates.east_arcsec_h:+10.2f} ± {rates.east_sigma_arcsec_h:6.2f} "
        f"{rates.north_arcsec_h:+10.2f} ± {rates.north_sigma_arcsec_h:6.2f} {len(one.jumps):6d}"
    )
