"""What `mountnav model` reads: observations from a run, JSON lines, a journal, or other programs' files."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

from mountnav.errors import BadRequest, BadSettings, Unknown
from mountnav.files import MOST_RECORD_BYTES, open_buffered, read_text
from mountnav.pointing.model.mechanical import Conversion, Mechanical, mechanical
from mountnav.pointing.model.planning import read_run
from mountnav.pointing.model.tpoint_file import read_observations_text
from mountnav.pointing.observation import PointingObservation, read_observations
from mountnav.settings.model import ModelSettings
from mountnav.settings.observatory import Settings, TelescopeSettings
from mountnav.sky.coordinates import Air, Site

_SQLITE = b"SQLite format 3\x00"


@dataclass(frozen=True, slots=True)
class Whose:
    """The telescope that a model is for, as far as it is known.

    Attributes
    ----------
    telescope : str
    site : Site or None
        None: neither settings nor options tell it.
    air : Air
    conversion : Conversion or None
    model : ModelSettings
    settings : TelescopeSettings or None
    """

    telescope: str
    site: Site | None
    air: Air
    conversion: Conversion | None
    model: ModelSettings
    settings: TelescopeSettings | None


def whose(
    config: Path | None,
    telescope: str | None,
    *,
    site: tuple[float, float] | None = None,
    kind: Literal["equatorial", "altaz"] | None = None,
    mounting: Literal["german", "fork", "altaz"] | None = None,
) -> Whose:
    """Find out whose model it is; options come before settings.

    Parameters
    ----------
    config : Path or None
        Settings file.
    telescope : str or None
        Its id; may be left out if the file has one.
    site : (latitude_deg, longitude_deg), optional
    kind, mounting : str, optional

    Raises
    ------
    BadSettings, Unknown
    """
    place = None if site is None else Site(*site)
    if config is None:
        model = ModelSettings()
        found = kind or model.kind_of(mounting)
        conversion = None if place is None else Conversion(place, found, mounting=mounting)
        return Whose(telescope or "", place, Air(), conversion, model, None)
    settings = Settings.load(config)
    one = chosen(settings, telescope)
    place = place or settings.site.site
    mounting = mounting or one.mount.mounting
    conversion = Conversion(place, kind or one.model.kind_of(mounting), one.model.does_refraction, mounting)
    return Whose(one.id, place, settings.air.air, conversion, one.model, one)


def chosen(settings: Settings, telescope: str | None) -> TelescopeSettings:
    """Find the telescope of that id, or the only one.

    Raises
    ------
    Unknown, BadSettings
    """
    if telescope is None:
        if len(settings.telescope) == 1:
            return settings.telescope[0]
        raise BadSettings(
            "there are several telescopes",
            advice="say which with --telescope: " + ", ".join(one.id for one in settings.telescope),
        )
    for one in settings.telescope:
        if one.id == telescope:
            return one
    raise Unknown(
        f"there is no telescope {telescope}",
        advice="the settings have " + ", ".join(one.id for one in settings.telescope),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Source:
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


def source(
    given: str, about: Whose, *, since: datetime | None = None, until: datetime | None = None
) -> Source:
    """Read observations.

    Parameters
    ----------
    given : str
        A file (a run, JSON lines, PMFIT, TPOINT, a journal) or a journal's URL.
    about : Whose
    since, until : datetime, optional
        Of those of a journal.

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
            head = opened.read(4096)
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
        return Source(
            mechanical(parts["fit"], _known(about)),
            mechanical(parts["held-out"], _known(about)) if parts["held-out"] else None,
            mechanical(parts["fresh"], _known(about)) if parts["fresh"] else None,
            f"run {path.name}",
        )
    try:
        text = read_text(path, MOST_RECORD_BYTES)
    except UnicodeDecodeError as cause:
        raise BadRequest(f"{path} is neither text nor a journal") from cause
    return Source(read_observations_text(text, name=str(path)), None, None, path.name)


def _known(about: Whose) -> Conversion:
    if about.conversion is None:
        raise BadRequest(
            "where the telescope stands is not known",
            advice="give the settings with --config, or --site LATITUDE LONGITUDE (east positive)",
        )
    return about.conversion


def _of_looks(looks: list[PointingObservation], about: Whose, said: str) -> Source:
    return Source(mechanical(looks, _known(about)), None, None, said)


def _journal(
    given: str, about: Whose, since: datetime | None, until: datetime | None
) -> list[PointingObservation]:
    from mountnav.journal.observations import observations

    if not about.telescope:
        raise BadRequest("whose looks are wanted of the journal?", advice="give --telescope")
    looks = observations(given, about.telescope, since, until)
    if not looks:
        raise BadRequest(f"the journal {given} has no solved look of {about.telescope} in that time")
    return looks
