"""What solved looks say of a mount, for HTTP and commands: the doctor's diagnosis, and its drift."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import ParamSpec

from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.pointing.doctor import ORDINARY, Diagnosis, Geometry, diagnose, within
from mountnav.pointing.doctor.facts import geometry_of
from mountnav.pointing.doctor.findings import Mounting
from mountnav.pointing.drift import DriftReport, drift_report
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Site

Known = ParamSpec("Known")
"""The looks, and what is known of the mount."""


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
            raise BadRequest(f"{points_within_arcsec}″ is not a pointing error", advice="> 0")
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


def _as_values(judge: Callable[Known, Diagnosis | DriftReport]) -> Callable[Known, dict[str, object]]:
    """The same judgement as plain values, for HTTP."""

    @functools.wraps(judge)
    def view(*arguments: Known.args, **known: Known.kwargs) -> dict[str, object]:
        return judge(*arguments, **known).as_dict()

    return view


diagnosis_view = _as_values(diagnosed)
"""The diagnosis as docs/how-to/doctor.md describes it."""
drift_view = _as_values(drift_reported)
"""The report as docs/how-to/drift.md describes it."""
