"""`mountnav drift`: how a mount follows the sky, from its looks; a table and advice, or one JSON object."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from api.cli.pointing_looks import looks, read_model
from mountnav.pointing.drift import DriftReport, Stretch, drift_report
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Site

HEAD = "from (UTC)           min looks   HA h   Dec °      east ″/h            north ″/h        jumps"


def run(
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
    found = looks(
        source,
        config=config,
        telescope=telescope,
        since=since,
        until=until,
        latitude=latitude,
        longitude=longitude,
    )
    report = reported(
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
        sys.stdout.write(_text(report))
    return 0 if any(one.rates is not None for one in report.stretches) else 1


def reported(
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
    return reported(
        observations,
        site=site,
        slew_ends=slew_ends,
        model=model,
        worm_period_s=worm_period_s,
        mount_refracts=mount_refracts,
        altaz=altaz,
    ).as_dict()


def _text(report: DriftReport) -> str:
    lines = [HEAD] if report.stretches else []
    lines += [_row(one) for one in report.stretches]
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


def _row(one: Stretch) -> str:
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
