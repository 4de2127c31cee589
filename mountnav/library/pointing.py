"""Pointing models in a few calls: read a run, fit it, ask it, plot it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from mountnav.clock import utc_now
from mountnav.errors import BadRequest
from mountnav.extras import extra
from mountnav.pointing.model.fit import Fit, fit
from mountnav.pointing.model.mechanical import Conversion, Mechanical, mechanical
from mountnav.pointing.model.model import PointingModel, model_of
from mountnav.pointing.model.rigorous import angles, seen_from
from mountnav.pointing.model.tpoint_file import read_observations_file
from mountnav.pointing.observation import PointingObservation, read_observations
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from astropy.table import Table
    from matplotlib.axes import Axes

JSON_LINES = (".jsonl", ".ndjson")
"""Files of these names hold observations as `mountnav journal export` writes them; others are PMFIT's or
TPOINT's."""


@dataclass(frozen=True)
class FittedPointing:
    """A fitted pointing model.

    Attributes
    ----------
    model : PointingModel
        Coefficients with errors, as `mountnav model` keeps them; `model.save(path)` writes it.
    fit : Fit
        All that the fit says: residuals, leave-one-out, how the terms were chosen.
    """

    model: PointingModel
    fit: Fit = field(repr=False)

    @property
    def terms(self) -> Table:
        """The coefficients and their one-sigma errors, arcsec; one row a term."""
        from astropy import units as u
        from astropy.table import Table

        return Table(
            {
                "term": list(self.model.terms),
                "value": np.array(self.model.coefficients_arcsec) * u.arcsec,
                "sigma": np.array(self.model.sigma_arcsec) * u.arcsec,
            }
        )

    @property
    def rms_arcsec(self) -> float:
        """RMS on the sky of the looks that count; NaN where as many unknowns were fitted."""
        rms = self.fit.after.sky_rms_arcsec
        return float("nan") if rms is None else rms

    @property
    def leave_one_out_arcsec(self) -> float:
        """RMS of each target predicted from the others: how well the model points."""
        return self.fit.loo_arcsec

    def seen(self, lon_deg: float, lat_deg: float) -> tuple[float, float]:
        """Where the tube looks when the axes read these angles.

        Parameters
        ----------
        lon_deg, lat_deg : float
            Hour angle and declination of an equatorial mount's axes; azimuth and altitude of an altazimuth's.

        Returns
        -------
        lon_deg, lat_deg : float
            The same of the observed (refracted) sky.
        """
        rotations = self.model.rotations()
        vector = seen_from(rotations, np.radians([lon_deg]), np.radians([lat_deg]))
        lon, lat = angles(vector)
        return float(np.degrees(lon[0])), float(np.degrees(lat[0]))

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw what the model leaves over: a point a look, with a ring at the RMS."""
        with extra("plots", "plots"):
            import matplotlib.pyplot as plt

        if axes is None:
            _, axes = plt.subplots(figsize=(5, 5))
        left, used = self.fit.residuals_arcsec, self.fit.used
        axes.scatter(left[used, 0], left[used, 1], s=12, label=f"{int(used.sum())} looks")
        if not used.all():
            axes.scatter(left[~used, 0], left[~used, 1], marker="x", c="C3", label="left out")
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        axes.plot(self.rms_arcsec * np.cos(turn), self.rms_arcsec * np.sin(turn), lw=0.8, c="C1")
        axes.set_aspect("equal", "datalim")
        axes.set_xlabel("ξ (″), along the first axis")
        axes.set_ylabel("η (″), along the second axis")
        axes.set_title(
            f"rms {self.rms_arcsec:.1f}″, leave-one-out {self.leave_one_out_arcsec:.1f}″", fontsize=9
        )
        axes.legend(fontsize=8)
        return axes

    def __repr__(self) -> str:
        terms = ", ".join(
            f"{name} {value:+.1f}±{sigma:.1f}"
            for name, value, sigma in zip(
                self.model.terms, self.model.coefficients_arcsec, self.model.sigma_arcsec, strict=True
            )
        )
        return f"<FittedPointing of {self.model.n_used} looks: {terms}; rms {self.rms_arcsec:.2f}″>"


def fit_pointing(
    run: str | PathLike[str] | Sequence[PointingObservation],
    terms: Sequence[str] | Literal["auto"] = "auto",
    *,
    site: Site | None = None,
    kind: Literal["equatorial", "altaz"] = "equatorial",
    does_refraction: bool = False,
    mounting: Literal["german", "fork", "altaz"] | None = None,
) -> FittedPointing:
    """Fit a pointing model to a run or to the looks of ordinary nights.

    Parameters
    ----------
    run : path or sequence of PointingObservation
        A file of PMFIT, TPOINT or INDI's EQMod driver; EQASCOM's ``ALIGN.ini``, or observations as JSON
        lines (`.jsonl`), which both need `site`.
    terms : sequence of str or "auto"
        TPOINT names; "auto" chooses by what predicts unseen targets best.
    site : Site, optional
        Where the telescope stands; files of PMFIT, TPOINT and INDI's EQMod bring their latitude.
    kind, does_refraction, mounting
        Of the mount, for observations; see `mountnav.pointing.model.mechanical.Conversion`.

    Returns
    -------
    FittedPointing
        The model, with its residuals and its judgement.

    Raises
    ------
    ModelRefused
        The looks don't determine the terms.
    BadRequest
        The file is none of these, an unknown term, or `site` is missing.
    """
    looks, source = _looks(run, site, kind, does_refraction, mounting)
    fitted = fit(looks, terms)
    model = model_of(fitted, made_utc=utc_now(), does_refraction=does_refraction, source=source)
    return FittedPointing(model, fitted)


def _looks(
    run: str | PathLike[str] | Sequence[PointingObservation],
    site: Site | None,
    kind: Literal["equatorial", "altaz"],
    does_refraction: bool,
    mounting: str | None,
) -> tuple[Mechanical, str]:
    source = "observations"
    if isinstance(run, (str, PathLike)):
        path = Path(run)
        source = path.name
        if path.suffix not in JSON_LINES:
            latitude_deg = None if site is None else site.latitude_deg
            return read_observations_file(path, name=path.name, latitude_deg=latitude_deg), source
        run = read_observations(path)
    if site is None:
        raise BadRequest("the observations give no site", advice="give site=mn.Site(latitude, longitude)")
    return mechanical(run, Conversion(site, kind, does_refraction, mounting)), source
