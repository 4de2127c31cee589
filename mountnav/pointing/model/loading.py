"""From an operator's settings to the pointing model in force."""

from __future__ import annotations

from mountnav.errors import BadRequest, BadSettings
from mountnav.pointing.model.in_force import ModelInForce, NoModel, Pointing
from mountnav.pointing.model.model import PointingModel
from mountnav.settings.model import ModelSettings
from mountnav.sky.coordinates import Air, Site


def pointing_of(
    settings: ModelSettings,
    *,
    site: Site,
    air: Air,
    mounting: str | None = None,
    resolution_arcsec: float = 0.0,
) -> Pointing:
    """Load the model that the settings name; without one, what single syncs are worth.

    Raises
    ------
    BadSettings
        The file can't be read, or holds no model.
    ModelRefused
        The model was made for another site, or for readings with another refraction.
    """
    if settings.file is None:
        return NoModel(settings.unseen_sigma_arcsec)
    try:
        model = PointingModel.load(settings.file)
    except BadRequest as cause:
        raise BadSettings(
            cause.what,
            device="model.file",
            advice="make one with `mountnav model fit`, or remove model.file",
        ) from cause
    wanted = settings.kind_of(mounting)
    if (settings.kind is not None or mounting is not None) and model.kind != wanted:
        raise BadSettings(
            f"{settings.file} is an {model.kind} model, the mount is {wanted}",
            device="model.file",
            advice="choose another file, or put mount.mounting (or model.kind) right",
        )
    return ModelInForce(
        model,
        site=site,
        air=air,
        does_refraction=settings.does_refraction,
        mounting=mounting,
        resolution_arcsec=resolution_arcsec,
        unseen_sigma_arcsec=settings.unseen_sigma_arcsec,
        wander_arcsec=settings.wander_arcsec,
    )
