"""What solved looks say of a mount, for HTTP and commands: the doctor's diagnosis, and its drift."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.pointing.doctor import ORDINARY, Diagnosis, Geometry, diagnose, within
from mountnav.pointing.doctor.facts import geometry_of
from mountnav.pointing.doctor.findings import Mounting
from mountnav.pointing.drift import DriftReport, drift_report
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Site


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
