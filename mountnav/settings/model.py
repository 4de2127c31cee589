"""`model` of a telescope: its pointing model."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from mountnav.settings.section import Section


class ModelSettings(Section):
    """`model` of a telescope: its pointing model; see docs/pointing-model.md.

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
