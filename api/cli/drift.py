"""`mountnav drift`: how a mount follows the sky, from its looks; a table and advice, or one JSON object."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import LooksOptions, takes_options
from api.cli.output import print_json

if TYPE_CHECKING:
    from mountnav.pointing.drift import DriftReport, Stretch

HEAD = "from (UTC)           min looks   HA h   Dec °      east ″/h            north ″/h        jumps"


@dataclass(frozen=True, kw_only=True)
class DriftOptions(LooksOptions):
    """Options of `drift`."""

    worm_period: Annotated[float | None, typer.Option(help="Of the worm, seconds, if known.")] = None
    mount_refracts: Annotated[
        bool, typer.Option("--mount-refracts", help="The mount corrects refraction itself.")
    ] = False


@takes_options(DriftOptions)
def drift(options: DriftOptions) -> int:
    """Tell how a mount drifts, swings and settles, and how to turn its polar axis."""
    from api.pointing.judgements import drift_reported
    from api.pointing.looks import read_looks, read_model

    found = read_looks(**options.where())
    report = drift_reported(
        found.observations,
        site=found.site,
        slew_ends=found.slew_ends,
        model=read_model(options.model),
        worm_period_s=options.worm_period,
        mount_refracts=options.mount_refracts,
        altaz=found.mounting == "altaz",
    )
    if options.as_json:
        print_json(report.as_dict())
    else:
        sys.stdout.write(_text(report))
    known = any(stretch.rates is not None for stretch in report.stretches)
    return 0 if known else 1


def _text(report: DriftReport) -> str:
    lines = [HEAD] if report.stretches else []
    lines += [_row(stretch) for stretch in report.stretches]
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
                f"  or in {', '.join(f'{period_s:.1f}' for period_s in periodic.aliases_s)} s: "
                "looks come too evenly"
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
        for name, axis in (("drift", polar.from_drift), ("model", polar.from_model)):
            if axis is not None:
                lines.append(
                    f"polar axis from {name}: ME {axis.me_arcsec:+.0f} ± {axis.me_sigma_arcsec:.0f}″, "
                    f"MA {axis.ma_arcsec:+.0f} ± {axis.ma_sigma_arcsec:.0f}″"
                )
        lines.append(f"advice: {polar.advice}")
    if report.polar_reason:
        lines.append(f"polar axis from drift: unknown: {report.polar_reason}")
    return "\n".join(lines) + "\n"


def _row(stretch: Stretch) -> str:
    minutes = (stretch.stop - stretch.start).total_seconds() / 60.0
    where = f"{stretch.ha_deg / 15.0:+6.2f} {stretch.dec_deg:+7.2f}"
    row = f"{stretch.start:%Y-%m-%d %H:%M:%S} {minutes:4.0f} {stretch.looks:5d} {where}"
    if stretch.rates is None:
        return f"{row}   {stretch.reason}"
    rates = stretch.rates
    return (
        f"{row} {rates.east_arcsec_h:+10.2f} ± {rates.east_sigma_arcsec_h:6.2f} "
        f"{rates.north_arcsec_h:+10.2f} ± {rates.north_sigma_arcsec_h:6.2f} {len(stretch.jumps):6d}"
    )
