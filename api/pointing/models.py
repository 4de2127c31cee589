"""Pointing models of a telescope: their observations, the fit and the run of points."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal
from uuid import uuid4

import httpx

from mountnav.client import Client, Json, ServiceError
from mountnav.clock import SystemClock
from mountnav.devices import PierSide
from mountnav.errors import BadRequest, BadSettings, MountnavError, Unknown
from mountnav.files import MOST_RECORD_BYTES, open_buffered, read_bytes, read_text
from mountnav.pointing.model.acceptance import Made, make
from mountnav.pointing.model.fit import Fit
from mountnav.pointing.model.mechanical import Conversion, Mechanical, mechanical
from mountnav.pointing.model.model import PointingModel, model_of, noted
from mountnav.pointing.model.planning import (
    Outcome,
    RunFile,
    RunPlan,
    RunPoint,
    add,
    allowed_by,
    begin,
    mend,
    plan,
    read_run,
)
from mountnav.pointing.model.terms import term
from mountnav.pointing.model.tpoint_file import (
    model_from,
    read_coefficients,
    read_observations_text,
    write_coefficients,
)
from mountnav.pointing.observation import PointingObservation, read_observations
from mountnav.settings.model import ModelSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import TelescopeSettings
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site

_SQLITE = b"SQLite format 3\x00"


@dataclass(frozen=True, slots=True)
class ModelledTelescope:
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


def modelled_telescope(
    config: Path | None,
    telescope: str | None,
    *,
    site: tuple[float, float] | None = None,
    kind: Literal["equatorial", "altaz"] | None = None,
    mounting: Literal["german", "fork", "altaz"] | None = None,
) -> ModelledTelescope:
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
        return ModelledTelescope(telescope or "", place, Air(), conversion, model, None)
    settings = Settings.load(config)
    one = chosen_telescope(settings, telescope)
    place = place or settings.site.site
    mounting = mounting or one.mount.mounting
    conversion = Conversion(place, kind or one.model.kind_of(mounting), one.model.does_refraction, mounting)
    return ModelledTelescope(one.id, place, settings.air.air, conversion, one.model, one)


def chosen_telescope(settings: Settings, telescope: str | None) -> TelescopeSettings:
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
        return ModelObservations(
            mechanical(parts["fit"], _known(about)),
            mechanical(parts["held-out"], _known(about)) if parts["held-out"] else None,
            mechanical(parts["fresh"], _known(about)) if parts["fresh"] else None,
            f"run {path.name}",
        )
    try:
        text = read_text(path, MOST_RECORD_BYTES)
    except UnicodeDecodeError as cause:
        raise BadRequest(f"{path} is neither text nor a journal") from cause
    return ModelObservations(read_observations_text(text, name=str(path)), None, None, path.name)


def _known(about: ModelledTelescope) -> Conversion:
    if about.conversion is None:
        raise BadRequest(
            "where the telescope stands is not known",
            advice="give the settings with --config, or --site LATITUDE LONGITUDE (east positive)",
        )
    return about.conversion


def _of_looks(looks: list[PointingObservation], about: ModelledTelescope, said: str) -> ModelObservations:
    return ModelObservations(mechanical(looks, _known(about)), None, None, said)


def _journal(
    given: str, about: ModelledTelescope, since: datetime | None, until: datetime | None
) -> list[PointingObservation]:
    from mountnav.journal.observations import observations

    if not about.telescope:
        raise BadRequest("whose looks are wanted of the journal?", advice="give --telescope")
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


def show_fit(
    given: str,
    about: ModelledTelescope,
    *,
    terms: str | None,
    out: Path | None,
    against: Path | None,
    since: datetime | None,
    until: datetime | None,
    anyway: bool,
    as_json: bool,
) -> int:
    """Fit, judge, write; 0 if the model is accepted, 1 if it is not.

    Raises
    ------
    MountnavError
        Nothing could be fitted.
    """
    read = model_observations(given, about, since=since, until=until)
    old = _old(about, against, out)
    made = make_model(read, about, read_terms(terms, about), old)
    model = as_pointing_model(made, about, read.said)
    accepted = made.judged.accepted
    written = out is not None and (accepted or anyway)
    if written:
        assert out is not None
        if not accepted:
            model = noted(model, *(f"written though: {reason}" for reason in made.judged.reasons))
        model.save(out)
    if as_json:
        print_json(fit_record(made, model, out if written else None))
    else:
        sys.stdout.write("\n".join(fit_lines(made, model)) + "\n")
        if out is not None:
            told = f"written to {out}" if written else f"NOT written to {out}: what was there stays"
            sys.stdout.write(told + "\n")
    return 0 if accepted else 1


def _old(about: ModelledTelescope, against: Path | None, out: Path | None) -> PointingModel | None:
    """What the new one must be better than: the one named, the settings', or the one to be overwritten."""
    for path in (against, about.model.file, out):
        if path is not None and (path is against or path.exists()):
            return PointingModel.load(path)
    return None


def make_model(
    read: ModelObservations,
    about: ModelledTelescope,
    terms: Sequence[str] | Literal["auto"],
    old: PointingModel | None,
) -> Made:
    """Make the model of a source with a telescope's settings."""
    return make(
        read.all,
        terms=terms,
        highest_harmonic=about.model.highest_harmonic,
        max_sigma_arcsec=about.model.max_sigma_arcsec,
        min_points=about.model.min_points,
        old=old,
        held_out=read.held_out,
        fresh=read.fresh,
    )


def as_pointing_model(made: Made, about: ModelledTelescope, said: str) -> PointingModel:
    """Give it its identity."""
    return model_of(
        made.fit,
        made_utc=SystemClock().utc(),
        does_refraction=about.model.does_refraction,
        telescope=about.telescope,
        source=said,
    )


def fit_record(made: Made, model: PointingModel, written: Path | None) -> dict[str, object]:
    """What `--json` tells of a fit."""
    found = made.fit
    return {
        "accepted": made.judged.accepted,
        "judgement": _finite(asdict(made.judged)),
        "model": json.loads(model.to_json()),
        "written_to": None if written is None else str(written),
        "observations": len(found.observations),
        "used": int(found.used.sum()),
        "visits": len(found.points),
        "after": _finite(asdict(found.after)),
        "before": _finite(asdict(found.before)),
        "loo_arcsec": found.loo_arcsec if math.isfinite(found.loo_arcsec) else None,
        "condition": found.condition if math.isfinite(found.condition) else None,
        "correlation": [[round(float(one), 4) for one in row] for row in found.correlation],
        "segments": [asdict(one) for one in found.segments],
        "steps": [_finite(asdict(one)) for one in found.steps],
        "residuals_arcsec": [
            {"xi": round(float(xi), 3), "eta": round(float(eta), 3), "used": bool(used)}
            for (xi, eta), used in zip(found.residuals_arcsec, found.used, strict=True)
        ],
    }


def _finite(record: dict[str, object]) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in record.items()
    }


def fit_lines(made: Made, model: PointingModel) -> Iterator[str]:
    """Write out a fit."""
    found, judged = made.fit, made.judged
    yield from model_lines(model)
    yield ""
    yield f"{'':24}{'zero points alone':>20}{'with the model':>18}"
    rows = (
        ("sky RMS (n-k), as PMFIT", found.before.sky_rms_arcsec, found.after.sky_rms_arcsec),
        ("sky RMS (n)", found.before.population_rms_arcsec, found.after.population_rms_arcsec),
        ("90 % within", found.before.percent_90_arcsec, found.after.percent_90_arcsec),
        ("largest", found.before.max_arcsec, found.after.max_arcsec),
    )
    for name, before, after in rows:
        yield f"{name:24}{_arcsec(before, 20)}{_arcsec(after, 18)}"
    if found.after.sky_rms_arcsec is None:
        yield "(n-k) is unknown where each look costs an unknown, as after many syncs: see left out in turn"
    yield ""
    yield f"{'':24}{'what was there':>20}{'the new model':>18}"
    pairs = (
        ("left out in turn", judged.old_loo_arcsec, judged.new_loo_arcsec),
        (f"{judged.held_out} held-out visits", judged.old_held_out_arcsec, judged.new_held_out_arcsec),
    )
    for name, before, after in pairs[: 2 if judged.held_out else 1]:
        yield f"{name:24}{_arcsec(before, 20)}{_arcsec(after, 18)}"
    yield from _far(found)
    if len(found.segments) > 1:
        yield ""
        yield f"{len(found.segments)} segments with zero points of their own:"
        for one in found.segments:
            names = ", ".join(name[:12] or "-" for name in one.segment_ids)
            if one.first_arcsec is None:
                yield f"  {names}: no point counts"
            else:
                yield (
                    f"  {one.points:4d} points  {model.terms[0]} {one.first_arcsec:+9.1f}″  "
                    f"{model.terms[1]} {one.second_arcsec:+9.1f}″  {names}"
                )
    yield ""
    yield "accepted: " if judged.accepted else "NOT accepted; the old one stays:"
    for reason in judged.reasons:
        yield f"  {reason}"


def _arcsec(value: float | None, width: int) -> str:
    """A figure in its column; unknown is no number."""
    told = "unknown" if value is None or not math.isfinite(value) else f"{value:.2f}″"
    return f"{told:>{width}}"


def _far(found: Fit) -> Iterator[str]:
    looks, used = len(found.observations), int(found.used.sum())
    if len(found.points) < looks:
        yield f"{looks} looks are {len(found.points)} visits of targets, and as much is known"
    if used < looks:
        yield f"{looks - used} of {looks} looks are left out as gross errors"


def model_lines(model: PointingModel) -> Iterator[str]:
    """Write out a model."""
    yield f"{model.kind} model {model.id[:12]} of {model.telescope or 'no telescope'}"
    yield (
        f"made {model.made_utc:%Y-%m-%d %H:%M} UTC of {model.source or 'unknown'}: "
        f"{model.n_used} of {model.n} points, latitude {model.site_latitude_deg:.4f}°"
    )
    if model.sky_rms_arcsec is None and model.population_rms_arcsec is not None:
        yield f"sky RMS (n-k) unknown, (n) {model.population_rms_arcsec:.2f}″"
    elif model.sky_rms_arcsec is not None:
        before = "" if model.before_arcsec is None else f", zero points alone {model.before_arcsec:.1f}″"
        yield f"sky RMS {model.sky_rms_arcsec:.2f}″{before}"
    if model.loo_arcsec is not None:
        yield f"left out in turn, targets are predicted to {model.loo_arcsec:.2f}″"
    yield ""
    for name, value, sigma in zip(model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True):
        yield f"  {name:8} {value:+10.2f}″ ± {sigma:7.2f}″  {term(model.kind, name).meaning}"
    for note in model.notes:
        yield f"  note: {note}"


def show_model(path: Path, as_json: bool) -> None:
    """Print a model. Raises `BadRequest`."""
    model = PointingModel.load(path)
    if as_json:
        sys.stdout.write(model.to_json())
    else:
        sys.stdout.write("\n".join(model_lines(model)) + "\n")


def export(path: Path, out: Path | None) -> None:
    """Write a model as a TPOINT file of coefficients. Raises `BadRequest`."""
    text = write_coefficients(PointingModel.load(path))
    if out is None:
        sys.stdout.write(text)
    else:
        out.write_text(text, encoding="utf-8")
        sys.stdout.write(f"written to {out}\n")


def import_(path: Path, out: Path, about: ModelledTelescope, latitude_deg: float | None) -> None:
    """Make a model file of a TPOINT file of coefficients. Raises `BadRequest`."""
    if latitude_deg is None and about.site is None:
        raise BadRequest(
            "the latitude of the telescope is not known", advice="give --config, --site or --latitude"
        )
    try:
        text = read_bytes(path).decode("utf-8", "replace")
    except OSError as cause:
        raise BadRequest(f"{path} can't be read: {cause.strerror}") from cause
    latitude = latitude_deg if latitude_deg is not None else about.site.latitude_deg if about.site else 0.0
    model = model_from(
        read_coefficients(text, name=str(path)),
        model_id=uuid4().hex,
        site_latitude_deg=latitude,
        made_utc=SystemClock().utc(),
        does_refraction=about.model.does_refraction,
        telescope=about.telescope,
    )
    model.save(out)
    sys.stdout.write("\n".join(model_lines(model)) + f"\nwritten to {out}\n")


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


def show_plan(
    config: Path,
    telescope: str | None,
    points: int | None,
    kind: Literal["spiral", "random"],
    seed: int,
    both_sides_each: bool,
    as_json: bool,
) -> None:
    """Print the points of a run. Raises `BadRequest`, `BadSettings`."""
    about = modelled_telescope(config, telescope)
    found = plan_run(about, points, kind, seed, both_sides_each)
    if as_json:
        record = {
            "telescope": about.telescope,
            "way_deg": round(found.way_deg, 2),
            "points": [asdict(one) for one in found.points],
        }
        print_json(record)
        return
    sys.stdout.write(f"{'':>4} {'azimuth':>8} {'altitude':>8} {'HA':>8} {'Dec':>7}  side\n")
    for one in found.points:
        held = "  held out" if one.held_out else ""
        sys.stdout.write(
            f"{one.number:4d} {one.az_deg:8.2f} {one.alt_deg:8.2f} {one.ha_deg:8.2f} {one.dec_deg:7.2f}  "
            f"{one.side}{held}\n"
        )
    sys.stdout.write(f"{len(found.points)} points; the axes turn {found.way_deg:.0f}° in all\n")


def print_json(record: dict[str, object]) -> None:
    """One line of JSON on standard output."""
    sys.stdout.write(json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n")


FAILURES_IN_A_ROW = 5
_WAIT_S = 30.0
_CONFLICT, _TRIES_WHEN_BUSY = 409, 3
_LEAST_SIGMA_ARCSEC = 0.1


class RunClient(Client):
    """The orders that a run gives."""

    def slew_to(self, telescope_id: str, ra_deg: float, dec_deg: float) -> Json:
        """Start a slew to an ICRS place; the job."""
        body = {"ra_deg": ra_deg, "dec_deg": dec_deg, "frame": "icrs"}
        return self._json("POST", f"/v1/telescopes/{telescope_id}/slew", json=body)

    def look_there(self, telescope_id: str) -> Json:
        """Start a look; the job."""
        return self._json("POST", f"/v1/telescopes/{telescope_id}/look", json={})

    def done(self, order: Callable[[], Json], *, patience_s: float) -> Json:
        """Give an order, after another job has ended if need be, and wait for its end."""
        for _ in range(_TRIES_WHEN_BUSY):
            try:
                return self.ended(order(), patience_s=patience_s)
            except ServiceError as error:
                holder = error.problem.get("job_id")
                if error.status != _CONFLICT or not holder:
                    raise
                self.job(str(holder), wait_s=_WAIT_S)
        return self.ended(order(), patience_s=patience_s)

    def ended(self, job: Json, *, patience_s: float) -> Json:
        """Wait for a job's end.

        Raises
        ------
        MountnavError
            It failed, was cancelled, or isn't over within that time (it is cancelled then).
        """
        waited_s = 0.0
        while job["state"] not in ("succeeded", "failed", "cancelled"):
            if waited_s >= patience_s:
                self.cancel(str(job["id"]))
                raise MountnavError(f"the {job['kind']} wasn't over within {patience_s:.0f} s")
            job = self.job(str(job["id"]), wait_s=_WAIT_S)
            waited_s += _WAIT_S
        if job["state"] != "succeeded":
            found = job.get("problem") or {}
            raise MountnavError(str(found.get("detail") or found.get("title") or job["state"]))
        return job


def run_model(
    about: ModelledTelescope,
    url: str,
    token: str | None,
    out: Path,
    *,
    points: int | None,
    kind: Literal["spiral", "random"],
    seed: int,
    model_out: Path | None,
    patience_s: float,
    as_json: bool,
) -> int:
    """Take the points that are left, then fit; 0 if the model is accepted, 1 if not or if it was given up.

    Raises
    ------
    MountnavError
        The plan can't be made, or nothing can be fitted.
    """
    tell = _silent if as_json else _say
    if not out.exists():
        found = plan_run(about, points, kind, seed)
        fresh = plan_run(about, about.model.fresh_points, "random", seed + 1).points
        first = len(found.points) + 1
        checks = [replace(one, number=first + index, held_out=False) for index, one in enumerate(fresh)]
        begin(out, about.telescope, [*found.points, *checks], (one.number for one in checks))
    mend(out)
    going = read_run(out)
    if going is None:
        raise MountnavError(f"{out} is there already and no model run", advice="give another --out")
    if going.telescope != about.telescope:
        raise MountnavError(f"{out} is a run of {going.telescope}, not of {about.telescope}")
    left = going.left
    if left and len(left) < len(going.points):
        tell(f"going on: {len(going.points) - len(left)} of {len(going.points)} points are done")
    with RunClient(url, token=token, timeout_s=60.0) as client:
        if not _taken(client, about, going, out, patience_s, tell):
            return 1
    read = model_observations(str(out), about)
    old = None if about.model.file is None or not about.model.file.exists() else about.model.file
    made = make_model(read, about, read_terms(None, about), None if old is None else PointingModel.load(old))
    model = as_pointing_model(made, about, read.said)
    if model_out is not None and made.judged.accepted:
        model.save(model_out)
    if as_json:
        print_json(fit_record(made, model, model_out if made.judged.accepted else None))
    else:
        tell("\n".join(fit_lines(made, model)))
        if model_out is not None:
            tell(f"written to {model_out}" if made.judged.accepted else f"NOT written to {model_out}")
    return 0 if made.judged.accepted else 1


def _taken(
    client: RunClient,
    about: ModelledTelescope,
    going: RunFile,
    out: Path,
    patience_s: float,
    tell: Callable[[str], None],
) -> bool:
    """Take the points that are left; False if it was given up."""
    assert about.site is not None
    failed = 0
    for one in going.left:
        try:
            seen = _point(client, about, one, patience_s)
        except httpx.HTTPError as error:
            # the service itself: this point is still to be taken
            tell(f"{one.number:4d}  the service doesn't answer ({error}); start the same command again later")
            return False
        except MountnavError as error:
            problem = error.what if not isinstance(error, ServiceError) else str(error)
            if isinstance(error, ServiceError) and error.status in (401, 403, 404):
                raise
            add(out, Outcome(one.number, None, problem), None)
            tell(f"{one.number:4d}  {problem}")
            failed += 1
            if failed >= FAILURES_IN_A_ROW:
                tell(f"{failed} points failed one after another: given up; start again to take the rest")
                return False
            continue
        failed = 0
        add(out, Outcome(one.number, seen.look_id), seen)
        tell(f"{one.number:4d}  az {one.az_deg:6.1f}° alt {one.alt_deg:5.1f}°  solved")
    return True


def _point(
    client: RunClient, about: ModelledTelescope, one: RunPoint, patience_s: float
) -> PointingObservation:
    assert about.site is not None
    target = position_of_point(one, about.site, about.air, SystemClock().utc())
    client.done(lambda: client.slew_to(about.telescope, target.ra_deg, target.dec_deg), patience_s=patience_s)
    job = client.done(lambda: client.look_there(about.telescope), patience_s=patience_s)
    return observation(job["result"], client.telescope(about.telescope), about.air)


def position_of_point(one: RunPoint, site: Site, air: Air, utc: datetime) -> Icrs:
    """Where a point of the plan lies at an instant."""
    return observed_to_icrs(Observed(one.az_deg, one.alt_deg, utc), site, air)


def observation(look: Json, telescope: Json, air: Air) -> PointingObservation:
    """Make an observation of a look's answer.

    Parameters
    ----------
    look : dict
        A `LookView`. What it doesn't tell of side and segment is taken from the telescope; a run that isn't
        synced meanwhile is one segment.
    telescope : dict
        The state right after the look.
    air : Air
    """
    utc = datetime.fromisoformat(str(look["mid_exposure_utc"]))
    side = look.get("pier_side") or telescope.get("pier_side") or "unknown"
    sigma = look.get("sigma_arcsec")
    return PointingObservation(
        utc=utc,
        seen=Icrs(float(look["seen"]["ra_deg"]), float(look["seen"]["dec_deg"])),
        sigma_arcsec=max(float(sigma), _LEAST_SIGMA_ARCSEC) if sigma is not None else 2.0,
        reading=_reading(look["believed"], utc),
        side=PierSide(side),
        segment_id=str(look.get("segment_id") or "run_model"),
        air=air,
        rotation_deg=look.get("rotation_deg"),
        scale_arcsec_px=look.get("scale_arcsec_px"),
        parity=look.get("parity"),
        model_id=look.get("model_id"),
        look_id=str(look["look_id"]),
    )


def _reading(place: dict[str, Any], utc: datetime) -> Apparent | Icrs:
    ra_deg, dec_deg = float(place["ra_deg"]), float(place["dec_deg"])
    return Icrs(ra_deg, dec_deg) if place["frame"] == "icrs" else Apparent(ra_deg, dec_deg, utc)


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _silent(line: str) -> None:
    sys.stderr.write(line + "\n")
