"""`mountnav model`: pointing models, from a run or from ordinary nights."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.cli.options import Json, config_option
from api.cli.output import finite_or_none, json_ready, print_json, refusing_os_errors
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    from api.pointing.models import ModelledTelescope
    from mountnav.pointing.model.acceptance import Made
    from mountnav.pointing.model.fit import Fit
    from mountnav.pointing.model.model import PointingModel

model_app = typer.Typer(
    help="Pointing models: what the mount and the tube do wrong, learned from the sky.", no_args_is_help=True
)

ModelConfig = Annotated[Path | None, config_option("The settings (TOML): site, air, mount, model.")]
NeededConfig = Annotated[Path, config_option("The settings (TOML).")]
Telescope = Annotated[str | None, typer.Option(help="Its id; may be left out if there is one.")]
SitePlace = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--site", metavar="LATITUDE LONGITUDE", help="Instead of the settings'; degrees, east positive."
    ),
]
Seed = Annotated[int, typer.Option(help="The same plan for the same seed.")]
Points = Annotated[
    int | None, typer.Option(min=3, max=1000, help="How many; the settings' run_points if not given.")
]
_DAYS = ["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S"]
Spread = Literal["spiral", "random"]
"""How the points of a run are spread."""
AxesKind = Literal["equatorial", "altaz"]
Mounting = Literal["german", "fork", "altaz"]


@model_app.command()
def fit(
    given: Annotated[
        str,
        typer.Argument(
            metavar="FILE|JOURNAL",
            help="A run, observations as JSON lines, a file of PMFIT, TPOINT, INDI's EQMod or EQASCOM, "
            "a journal (file or URL).",
        ),
    ],
    terms: Annotated[
        str | None, typer.Option(metavar="auto|IH,ID,...", help="TPOINT names; the settings' if not given.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the model here, if it is accepted.")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            help="A model that it must be better than; the settings', or the one at --out, if not given."
        ),
    ] = None,
    anyway: Annotated[bool, typer.Option("--anyway", help="Write it even if it is not accepted.")] = False,
    config: ModelConfig = None,
    telescope: Telescope = None,
    site: SitePlace = None,
    kind: Annotated[AxesKind | None, typer.Option(help="Instead of the settings'.")] = None,
    mounting: Annotated[Mounting | None, typer.Option(help="Instead of the settings'.")] = None,
    since: Annotated[
        datetime | None, typer.Option(formats=_DAYS, help="Of a journal: looks from this time on, UTC.")
    ] = None,
    until: Annotated[
        datetime | None, typer.Option(formats=_DAYS, help="Of a journal: looks before this time, UTC.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fit a pointing model and judge it by points that it hasn't seen.

    Exit code 0 if it predicts better than what is there, 1 if not (nothing is written then), 2 on bad usage.
    """
    from api.pointing.models import (
        as_pointing_model,
        make_model,
        model_observations,
        modelled_telescope,
        read_terms,
    )
    from mountnav.pointing.model.model import noted

    about = modelled_telescope(config, telescope, site=site, kind=kind, mounting=mounting)
    observations = model_observations(given, about, since=_utc(since), until=_utc(until))
    old = _model_to_beat(about, against, out)
    made = make_model(observations, about, read_terms(terms, about), old)
    model = as_pointing_model(made, about, observations.said)
    accepted = made.judged.accepted
    written = out is not None and (accepted or anyway)
    if written:
        assert out is not None
        if not accepted:
            model = noted(model, *(f"written though: {reason}" for reason in made.judged.reasons))
        model.save(out)
    if as_json:
        print_json(fit_record(made, model, out if written else None), ascii_only=False)
    else:
        sys.stdout.write("\n".join(fit_lines(made, model)) + "\n")
        if out is not None:
            line = f"written to {out}" if written else f"NOT written to {out}: what was there stays"
            sys.stdout.write(line + "\n")
    raise typer.Exit(0 if accepted else 1)


@model_app.command()
def show(file: Annotated[Path, typer.Argument(help="As `fit` writes it.")], as_json: Json = False) -> None:
    """Show what a model holds: coefficients with their errors, and how good it was."""
    from mountnav.pointing.model.model import PointingModel

    model = PointingModel.load(file)
    if as_json:
        sys.stdout.write(model.to_json())
    else:
        sys.stdout.write("\n".join(model_lines(model)) + "\n")


@model_app.command()
def export(
    file: Annotated[Path, typer.Argument(help="As `fit` writes it.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Standard output if not given.")] = None,
) -> None:
    """Write a model's coefficients as TPOINT does."""
    from mountnav.pointing.model.model import PointingModel
    from mountnav.pointing.model.tpoint_file import write_coefficients

    text = write_coefficients(PointingModel.load(file))
    if out is None:
        sys.stdout.write(text)
    else:
        out.write_text(text, encoding="utf-8")
        sys.stdout.write(f"written to {out}\n")


@model_app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="Coefficients as TPOINT writes them.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The model file.")],
    config: ModelConfig = None,
    telescope: Telescope = None,
    latitude: Annotated[
        float | None,
        typer.Option(min=-90, max=90, help="Of the telescope, degrees; the settings' if not given."),
    ] = None,
) -> None:
    """Make a model of TPOINT's coefficients."""
    from uuid import uuid4

    from api.pointing.models import modelled_telescope
    from mountnav.clock import SystemClock
    from mountnav.files import read_bytes
    from mountnav.pointing.model.tpoint_file import model_from, read_coefficients

    about = modelled_telescope(config, telescope)
    if latitude is None and about.site is not None:
        latitude = about.site.latitude_deg
    if latitude is None:
        raise BadRequest(
            "the latitude of the telescope is not known", advice="give --config, --site or --latitude"
        )
    with refusing_os_errors(f"{file} can't be read"):
        text = read_bytes(file).decode("utf-8-sig", "replace")
    model = model_from(
        read_coefficients(text, name=str(file)),
        model_id=uuid4().hex,
        site_latitude_deg=latitude,
        made_utc=SystemClock().utc(),
        does_refraction=about.model.does_refraction,
        telescope=about.telescope,
    )
    model.save(out)
    sys.stdout.write("\n".join(model_lines(model)) + f"\nwritten to {out}\n")


@model_app.command()
def plan(
    config: NeededConfig,
    telescope: Telescope = None,
    points: Points = None,
    spread: Annotated[Spread, typer.Option(help="Golden spiral, or random.")] = "spiral",
    seed: Seed = 0,
    both_sides_each: Annotated[
        bool, typer.Option("--both-sides-each", help="German mounts: each place from every side allowed.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the points of a run: over the allowed sky, in a short way. Nothing moves."""
    from api.pointing.models import modelled_telescope, plan_run

    about = modelled_telescope(config, telescope)
    found = plan_run(about, points, spread, seed, both_sides_each)
    if as_json:
        record = {
            "telescope": about.telescope,
            "way_deg": round(found.way_deg, 2),
            "points": [asdict(point) for point in found.points],
        }
        print_json(record, ascii_only=False)
        return
    sys.stdout.write(f"{'':>4} {'azimuth':>8} {'altitude':>8} {'HA':>8} {'Dec':>7}  side\n")
    for point in found.points:
        held = "  held out" if point.held_out else ""
        sys.stdout.write(
            f"{point.number:4d} {point.az_deg:8.2f} {point.alt_deg:8.2f} {point.ha_deg:8.2f} "
            f"{point.dec_deg:7.2f}  {point.side}{held}\n"
        )
    sys.stdout.write(f"{len(found.points)} points; the axes turn {found.way_deg:.0f}° in all\n")


@model_app.command()
def run(
    config: NeededConfig,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The run's file; if it is there, the run goes on.")
    ],
    telescope: Telescope = None,
    url: Annotated[
        str | None, typer.Option(help="Of the service; the settings' host and port if not given.")
    ] = None,
    token: Annotated[str | None, typer.Option(envvar="MOUNTNAV_TOKEN", help="API token.")] = None,
    points: Points = None,
    spread: Annotated[Spread, typer.Option(help="Golden spiral, or random.")] = "spiral",
    seed: Seed = 0,
    model: Annotated[
        Path | None, typer.Option("--model", help="Write the model here, if it is accepted.")
    ] = None,
    patience: Annotated[
        float, typer.Option(min=10, max=3600, help="Seconds for a slew, and for a look.")
    ] = 300.0,
    as_json: Json = False,
) -> None:
    """Slew over the sky and look, by a service that runs; then fit. Interrupted, it goes on.

    One point in five judges the model and has no part in it; some fresh ones at the end check it once more.
    Exit code 0 if the model is accepted, 1 if not, or if the run was given up.
    """
    from api.cli.model_run import RunClient, begin_or_go_on, take_points
    from api.pointing.models import (
        as_pointing_model,
        make_model,
        model_observations,
        modelled_telescope,
        read_terms,
    )
    from mountnav.pointing.model.model import PointingModel
    from mountnav.settings.observatory import Settings

    if url is None:
        service = Settings.load(config).service
        url = f"http://{service.host}:{service.port}"
    about = modelled_telescope(config, telescope)

    def say(line: str) -> None:
        """The progress: beside JSON it goes to the standard error."""
        out_stream = sys.stderr if as_json else sys.stdout
        out_stream.write(line + "\n")
        out_stream.flush()

    going = begin_or_go_on(about, out, points=points, spread=spread, seed=seed, say=say)
    with RunClient(url, token=token, timeout_s=60.0) as client:
        if not take_points(client, about, going, out, patience, say):
            raise typer.Exit(1)
    observations = model_observations(str(out), about)
    file = about.model.file
    old = None if file is None or not file.exists() else PointingModel.load(file)
    made = make_model(observations, about, read_terms(None, about), old)
    fitted = as_pointing_model(made, about, observations.said)
    accepted = made.judged.accepted
    if model is not None and accepted:
        fitted.save(model)
    if as_json:
        print_json(fit_record(made, fitted, model if accepted else None), ascii_only=False)
    else:
        say("\n".join(fit_lines(made, fitted)))
        if model is not None:
            say(f"written to {model}" if accepted else f"NOT written to {model}")
    raise typer.Exit(0 if accepted else 1)


def _utc(when: datetime | None) -> datetime | None:
    return None if when is None else when.replace(tzinfo=UTC)


def _model_to_beat(about: ModelledTelescope, against: Path | None, out: Path | None) -> PointingModel | None:
    """What the new one must be better than: the one named, the settings', or the one to be overwritten."""
    from mountnav.pointing.model.model import PointingModel

    for path in (against, about.model.file, out):
        if path is not None and (path is against or path.exists()):
            return PointingModel.load(path)
    return None


def fit_record(made: Made, model: PointingModel, written: Path | None) -> dict[str, object]:
    """What `--json` tells of a fit."""
    found = made.fit
    return {
        "accepted": made.judged.accepted,
        "judgement": json_ready(asdict(made.judged)),
        "model": json.loads(model.to_json()),
        "written_to": None if written is None else str(written),
        "observations": len(found.observations),
        "used": int(found.used.sum()),
        "visits": len(found.points),
        "after": json_ready(asdict(found.after)),
        "before": json_ready(asdict(found.before)),
        "loo_arcsec": finite_or_none(found.loo_arcsec),
        "condition": finite_or_none(found.condition),
        "correlation": [[round(float(value), 4) for value in row] for row in found.correlation],
        "segments": [asdict(segment) for segment in found.segments],
        "steps": [json_ready(asdict(step)) for step in found.steps],
        "residuals_arcsec": [
            {"xi": round(float(xi), 3), "eta": round(float(eta), 3), "used": bool(used)}
            for (xi, eta), used in zip(found.residuals_arcsec, found.used, strict=True)
        ],
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
    yield from _left_out(found)
    if len(found.segments) > 1:
        yield ""
        yield f"{len(found.segments)} segments with zero points of their own:"
        for segment in found.segments:
            names = ", ".join(name[:12] or "-" for name in segment.segment_ids)
            if segment.first_arcsec is None:
                yield f"  {names}: no point counts"
            else:
                yield (
                    f"  {segment.points:4d} points  {model.terms[0]} {segment.first_arcsec:+9.1f}″  "
                    f"{model.terms[1]} {segment.second_arcsec:+9.1f}″  {names}"
                )
    yield ""
    yield "accepted: " if judged.accepted else "NOT accepted; the old one stays:"
    for reason in judged.reasons:
        yield f"  {reason}"


def _arcsec(value: float | None, width: int) -> str:
    """A figure in its column; unknown is no number."""
    cell = "unknown" if value is None or not math.isfinite(value) else f"{value:.2f}″"
    return f"{cell:>{width}}"


def _left_out(found: Fit) -> Iterator[str]:
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
    from mountnav.pointing.model.terms import term

    for name, value, sigma in zip(model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True):
        yield f"  {name:8} {value:+10.2f}″ ± {sigma:7.2f}″  {term(model.kind, name).meaning}"
    for note in model.notes:
        yield f"  note: {note}"
