"""`model` of a telescope: its pointing model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from mountnav.errors import BadRequest, BadSettings
from mountnav.settings.section import Section

if TYPE_CHECKING:
    from mountnav.pointing.model.in_force import Pointing
    from mountnav.sky.coordinates import Air, Site


class ModelSettings(Section):
    """`model` of a telescope: its pointing model; see docs/explanation/pointing-model.md.

    Attributes
    ----------
    file
        The model, as `mountnav model fit` writes it. Left out: there is none, and how far the telescope may
        be off is told by the distance from the last sync. A path that isn't absolute is taken from the folder
        in which the service runs.
    apply
        Whether slews are corrected by it. If not, it still tells what to expect, which guards the syncs.
    does_refraction
        Whether the mount itself allows for refraction (10micron, Astro-Physics, OnStep and others can). Must
        be as it is when looks are taken for a model: a model made one way is refused the other way.
    kind
        What the axes are: for fitting. Left out: by `mount.mounting`, equatorial if that isn't set either.
    terms
        ``auto``: chosen by how well points are predicted from the others. Or names, as TPOINT has them:
        ``["IH", "ID", "CH", "ME", "MA", "TF"]``; zero points are always among them.
    highest_harmonic
        Of an automatic choice.
    min_points
        Fewer solved looks make no model.
    max_sigma_arcsec
        A coefficient less certain than this is refused.
    run_points
        Of a planned run; one in five judges the model and has no part in it.
    fresh_points
        Taken after a run, for the last check; at least 3.
    unseen_sigma_arcsec
        How far off the zero points may be in a segment in which nothing was seen yet.
    wander_arcsec
        How far they wander in an hour.
    """

    file: Path | None = None
    apply: bool = True
    does_refraction: bool = False
    kind: Literal["equatorial", "altaz"] | None = None
    terms: Literal["auto"] | tuple[str, ...] = "auto"
    highest_harmonic: int = Field(default=3, ge=1, le=8)
    min_points: int = Field(default=8, ge=3, le=10_000)
    max_sigma_arcsec: float = Field(default=300.0, gt=0, le=36_000)
    run_points: int = Field(default=30, ge=5, le=1000)
    fresh_points: int = Field(default=4, ge=3, le=20)
    unseen_sigma_arcsec: float = Field(default=3600.0, gt=0, le=360_000)
    wander_arcsec: float = Field(default=5.0, ge=0, le=3600)

    def kind_of(self, mounting: str | None) -> Literal["equatorial", "altaz"]:
        """What the axes of a mount of this mounting are."""
        if self.kind is not None:
            return self.kind
        return "altaz" if mounting == "altaz" else "equatorial"

    def pointing(
        self, *, site: Site, air: Air, mounting: str | None = None, resolution_arcsec: float = 0.0
    ) -> Pointing:
        """Load the model that is named here; without one, what single syncs are worth.

        Raises
        ------
        BadSettings
            The file can't be read, or holds no model.
        ModelRefused
            The model was made for another site, or for readings with another refraction.
        """
        # a settings file is read, and complained of, without the mathematics of models
        from mountnav.pointing.model.in_force import ModelInForce, NoModel
        from mountnav.pointing.model.model import PointingModel

        if self.file is None:
            return NoModel(self.unseen_sigma_arcsec)
        try:
            model = PointingModel.load(self.file)
        except BadRequest as cause:
            raise BadSettings(
                cause.what,
                device="model.file",
                advice="make one with `mountnav model fit`, or remove model.file",
            ) from cause
        wanted = self.kind_of(mounting)
        if (self.kind is not None or mounting is not None) and model.kind != wanted:
            raise BadSettings(
                f"{self.file} is an {model.kind} model, the mount is {wanted}",
                device="model.file",
                advice="choose another file, or correct mount.mounting (or model.kind)",
            )
        return ModelInForce(
            model,
            site=site,
            air=air,
            does_refraction=self.does_refraction,
            mounting=mounting,
            resolution_arcsec=resolution_arcsec,
            unseen_sigma_arcsec=self.unseen_sigma_arcsec,
            wander_arcsec=self.wander_arcsec,
        )
