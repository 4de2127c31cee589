"""Pointing models of a telescope: their observations, the fit and the run of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

from mountnav.clock import SystemClock
from mountnav.errors import BadRequest, BadSettings, NotFound
from mountnav.files import open_buffered
from mountnav.pointing.model.acceptance import Made, make
from mountnav.pointing.model.mechanical import Conversion, Mechanical, mechanical
from mountnav.pointing.model.model import PointingModel, model_of
from mountnav.pointing.model.planning import RunPlan, RunPoint, allowed_by, plan, read_run
from mountnav.pointing.model.tpoint_file import read_observations_file
from mountnav.pointing.observation import PointingObservation, read_observations
from mountnav.settings.model import ModelSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import TelescopeSettings
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site

_SQLITE = b"SQLite format 3\x00"
"""How each SQLite file begins (its documented format): so a journal is known from text."""
_HEAD_BYTES = 4096
"""Of a file, to see what it is: a page of the disk; the first bytes would do."""


@dataclass(frozen=True, slots=True)
class ModelledTelescope:
    """The telescope that a model is for, as far as it is known.

    Attributes
    ----------
    telescope : str
        Its id; empty if it isn't known.
    site : Site or None
        None where neither settings nor options say it; then there is no conversion either.
    conversion : Conversion or None
        From what the mount reads to the angles of its axes.
    settings : TelescopeSettings or None
        None without a settings file.
    """

    telescope: str
    site: Site | None
    air: Air
    conversion: Conversion | None
    model: ModelSettings
    settings: TelescopeSettings | None


def modelled_telescope(
    config: Path | None,
    telescope: str | None,
    *,
    site: tuple[float, float] | None = None,
    kind: Literal["equatorial", "altaz"] | None = None,
    mounting: Literal["german", "fork", "altaz"] | None = None,
) -> ModelledTelescope:
    """The telescope of a settings file, or what options alone say of it; options go before settings.

    Parameters
    ----------
    config : Path or None
        Settings file.
    telescope : str or None
        Its id; may be left out if the file has one telescope.

    Raises
    ------
    BadSettings, Unknown
        As `chosen_telescope`; or the file is wrong.
    """
    place = None if site is None else Site(*site)
    if config is None:
        model = ModelSettings()
        found = kind or model.kind_of(mounting)
        conversion = None if place is None else Conversion(place, found, mounting=mounting)
        return ModelledTelescope(telescope or "", place, Air(), conversion, model, None)
    settings = Settings.load(config)
    chosen = chosen_telescope(settings, telescope)
    model = chosen.model
    place = place or settings.site.site
    mounting = mounting or chosen.mount.mounting
    conversion = Conversion(place, kind or model.kind_of(mounting), model.does_refraction, mounting)
    return ModelledTelescope(chosen.id, place, settings.air.air, conversion, model, chosen)


def chosen_telescope(settings: Settings, telescope: str | None) -> TelescopeSettings:
    """The telescope of that id, or the only one.

    Raises
    ------
    NotFound
        There is none of that id.
    BadSettings
        No id is given, and there are several.
    """
    if telescope is None:
        if len(settings.telescope) == 1:
            return settings.telescope[0]
        raise BadSettings(
            "there are several telescopes",
            advice="say which with --telescope: " + ", ".join(known.id for known in settings.telescope),
        )
    for known in settings.telescope:
        if known.id == telescope:
            return known
    raise NotFound(
        f"there is no telescope {telescope}",
        advice="the settings have " + ", ".join(known.id for known in settings.telescope),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ModelObservations:
    """Observations ready to fit.

    Attributes
    ----------
    all : Mechanical
        For the fit.
    held_out, fresh : Mechanical or None
        Set apart when they were taken.
    said : str
        Where they come from, in words.
    """

    all: Mechanical
    held_out: Mechanical | None
    fresh: Mechanical | None
    said: str


def model_observations(
    given: str, about: ModelledTelescope, *, since: datetime | None = None, until: datetime | None = None
) -> ModelObservations:
    """Read observations for a fit, of whatever a file turns out to be.

    Parameters
    ----------
    given : str
        A file (a run, JSON lines, PMFIT, TPOINT, INDI's EQMod, EQASCOM, a journal) or a journal's URL.
    since, until : datetime, optional
        Of a journal alone: looks from then on, and before then.

    Raises
    ------
    BadRequest
        It is nothing of all that; or the site is not known, which a fit of looks needs.
    """
    if "://" in given:
        return _of_looks(_journal(given, about, since, until), about, given)
    path = Path(given)
    try:
        with open_buffered(path) as opened:
            head = opened.read(_HEAD_BYTES)
    except OSError as cause:
        raise BadRequest(f"{path} can't be read: {cause.strerror}") from cause
    if head.startswith(_SQLITE):
        return _of_looks(_journal(given, about, since, until), about, f"journal {path.name}")
    if head.lstrip()[:1] in (b"{", b"#"):
        run = read_run(path)
        if run is None:
            return _of_looks(read_observations(path), about, path.name)
        parts = {part: run.of_part(part) for part in ("fit", "held-out", "fresh")}
        if not parts["fit"]:
            raise BadRequest(f"{path} holds no solved look for the fit yet", advice="go on with the run")
        return ModelObservations(
            mechanical(parts["fit"], _conversion(about)),
            mechanical(parts["held-out"], _conversion(about)) if parts["held-out"] else None,
            mechanical(parts["fresh"], _conversion(about)) if parts["fresh"] else None,
            f"run {path.name}",
        )
    try:
        latitude_deg = None if about.site is None else about.site.latitude_deg
        return ModelObservations(
            read_observations_file(path, latitude_deg=latitude_deg), None, None, path.name
        )
    except UnicodeDecodeError as cause:
        raise BadRequest(f"{path} is neither text nor a journal") from cause


def _conversion(about: ModelledTelescope) -> Conversion:
    """The conversion, without which looks can't be fitted. Raises `BadRequest`."""
    if about.conversion is None:
        raise BadRequest(
            "where the telescope stands is not known",
            advice="give the settings with --config, or --site LATITUDE LONGITUDE (east positive)",
        )
    return about.conversion


def _of_looks(looks: list[PointingObservation], about: ModelledTelescope, said: str) -> ModelObservations:
    return ModelObservations(mechanical(looks, _conversion(about)), None, None, said)


def _journal(
    given: str, about: ModelledTelescope, since: datetime | None, until: datetime | None
) -> list[PointingObservation]:
    from mountnav.journal.observations import observations

    if not about.telescope:
        raise BadRequest("the journal holds several telescopes", advice="give --telescope")
    looks = observations(given, about.telescope, since, until)
    if not looks:
        raise BadRequest(f"the journal {given} has no solved look of {about.telescope} in that time")
    return looks


def read_terms(text: str | None, about: ModelledTelescope) -> Sequence[str] | Literal["auto"]:
    """Read ``auto`` or ``IH,ID,CH``; the settings' if not given."""
    if text is None:
        return about.model.terms
    if text == "auto":
        return "auto"
    names = tuple(name.strip().upper() for name in text.split(",") if name.strip())
    if not names:
        raise BadRequest("no terms are given", advice="auto, or names such as IH,ID,CH,ME,MA,TF")
    return names


def make_model(
    observations: ModelObservations,
    about: ModelledTelescope,
    terms: Sequence[str] | Literal["auto"],
    old: PointingModel | None,
) -> Made:
    """Fit and judge a model by a telescope's settings; `old` is the one that it has to beat."""
    return make(
        observations.all,
        terms=terms,
        highest_harmonic=about.model.highest_harmonic,
        max_sigma_arcsec=about.model.max_sigma_arcsec,
        min_points=about.model.min_points,
        old=old,
        held_out=observations.held_out,
        fresh=observations.fresh,
    )


def as_pointing_model(made: Made, about: ModelledTelescope, said: str) -> PointingModel:
    """The fit as a model with an id and the time of its making; `said` names the observations."""
    return model_of(
        made.fit,
        made_utc=SystemClock().utc(),
        does_refraction=about.model.does_refraction,
        telescope=about.telescope,
        source=said,
    )


def plan_run(
    about: ModelledTelescope,
    points: int | None,
    kind: Literal["spiral", "random"],
    seed: int,
    both_sides_each: bool = False,
) -> RunPlan:
    """Plan a run over the sky that a telescope's limits allow. Raises `BadRequest`."""
    if about.settings is None or about.site is None:
        raise BadRequest("a run needs the limits of a telescope", advice="give the settings with --config")
    return plan(
        points or about.model.run_points,
        about.site,
        allowed_by(about.settings.limits.limits, about.site),
        mounting=about.settings.mount.mounting,
        kind=kind,
        seed=seed,
        both_sides_each=both_sides_each,
    )


def position_of_point(point: RunPoint, site: Site, air: Air, utc: datetime) -> Icrs:
    """Where a point of the plan, of fixed azimuth and altitude, lies in the sky at an instant."""
    return observed_to_icrs(Observed(point.az_deg, point.alt_deg, utc), site, air)
