"""`mountnav pointing-doctor`: what a night's looks say about the mount; in words, or one JSON object."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from api.cli.pointing_looks import looks, read_model
from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.pointing.doctor import ORDINARY, Diagnosis, Finding, Geometry, diagnose, within
from mountnav.pointing.doctor.facts import geometry_of
from mountnav.pointing.doctor.findings import Mounting
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Site

MOUNTINGS: tuple[Mounting, ...] = ("german", "fork", "altaz")


def run(
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
    found = looks(
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
        sys.stdout.write(_text(diagnosis))
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


def _text(diagnosis: Diagnosis) -> str:
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
