"""`mountnav pointing-doctor`: what a night's looks say about the mount; in words, or one JSON object."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import LooksOptions, takes_options
from api.cli.output import print_json
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    from mountnav.pointing.doctor import Diagnosis, Finding
    from mountnav.pointing.doctor.findings import Mounting

MOUNTINGS: tuple[Mounting, ...] = ("german", "fork", "altaz")


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(LooksOptions):
    """Options of `pointing-doctor`."""

    epoch: Annotated[
        str | None, typer.Option(help="What the mount is believed to speak: apparent (JNow) or icrs (J2000).")
    ] = None
    mounting: Annotated[str | None, typer.Option(help="german, fork or altaz.")] = None
    parity: Annotated[int | None, typer.Option(help="Of its images: 1 not mirrored, -1 mirrored.")] = None
    rotator: Annotated[bool, typer.Option("--rotator", help="The camera turns by itself.")] = False
    unsynced: Annotated[
        bool, typer.Option("--unsynced", help="Nothing was synced in these looks (a journal knows that).")
    ] = False
    points_within: Annotated[
        float | None, typer.Option(help="The mount is known to point within so many arcseconds.")
    ] = None


@takes_options(DoctorOptions)
def pointing_doctor(options: DoctorOptions) -> int:
    """Tell what a night's looks say about the mount. Exit code 1 if something is wrong."""
    from api.pointing.judgements import diagnosed
    from api.pointing.looks import read_looks, read_model

    known = next((name for name in MOUNTINGS if name == options.mounting), None)
    if options.mounting is not None and known is None:
        raise BadRequest(f"--mounting {options.mounting}", advice=f"one of {', '.join(MOUNTINGS)}")
    found = read_looks(**options.where(), epoch=options.epoch, mounting=known, unsynced=options.unsynced)
    diagnosis = diagnosed(
        found.observations,
        site=found.site,
        epoch=found.epoch,
        mounting=found.mounting,
        parity=options.parity,
        rotator=options.rotator,
        model=read_model(options.model),
        points_within_arcsec=options.points_within,
        synced_on=found.synced_on,
    )
    if options.as_json:
        print_json(diagnosis.as_dict())
    else:
        sys.stdout.write(_text(diagnosis))
    return 1 if diagnosis.healthy is False else 0


def _text(diagnosis: Diagnosis) -> str:
    lines = [f"{diagnosis.observations} looks"]
    for caption, findings in (("FOUND", diagnosis.findings), ("NOT SURE", diagnosis.suspicions)):
        for finding in findings:
            lines += _finding(caption, finding)
    if not diagnosis.findings and not diagnosis.suspicions:
        lines.append(diagnosis.words)
    return "\n".join(lines) + "\n"


def _finding(caption: str, finding: Finding) -> list[str]:
    lines = [f"{caption}: {finding.what} (probability {finding.probability:.4g})", f"  {finding.words}"]
    if finding.alternatives:
        lines.append(f"  it may also be: {', '.join(finding.alternatives)}")
    lines.append(f"  what to do: {finding.advice}")
    if finding.look_ids and any(finding.look_ids):
        lines.append(f"  looks: {', '.join(finding.look_ids)}")
    return lines
