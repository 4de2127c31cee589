"""`mountnav model`: pointing models, from a run or from ordinary nights."""

from __future__ import annotations

from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Json

model_app = typer.Typer(
    help="Pointing models: what the mount and the tube do wrong, learned from the sky.", no_args_is_help=True
)


class Spread(StrEnum):
    """How the points of a run are spread."""

    SPIRAL = "spiral"
    RANDOM = "random"


class AxesKind(StrEnum):
    """What the axes are."""

    EQUATORIAL = "equatorial"
    ALTAZ = "altaz"


class Mounting(StrEnum):
    """How the mount is built."""

    GERMAN = "german"
    FORK = "fork"
    ALTAZ = "altaz"


ModelConfig = Annotated[
    Path | None, typer.Option("--config", "-c", help="The settings (TOML): site, air, mount, model.")
]
NeededConfig = Annotated[Path, typer.Option("--config", "-c", help="The settings (TOML).")]
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


def _utc(when: datetime | None) -> datetime | None:
    return None if when is None else when.replace(tzinfo=UTC)


@model_app.command()
def fit(
    given: Annotated[
        str,
        typer.Argument(
            metavar="FILE|JOURNAL",
            help="A run, observations as JSON lines, a PMFIT or TPOINT file, a journal (file or URL).",
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
        datetime | None, typer.Option(formats=_DAYS, help="Of a journal: looks from then on, UTC.")
    ] = None,
    until: Annotated[
        datetime | None, typer.Option(formats=_DAYS, help="Of a journal: looks before then, UTC.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fit a pointing model and judge it by points that it hasn't seen.

    Exit code 0 if it predicts better than what is there, 1 if not (nothing is written then), 2 on bad usage.
    """
    from api.pointing.models import modelled_telescope, show_fit

    about = modelled_telescope(
        config,
        telescope,
        site=site,
        kind=None if kind is None else kind.value,
        mounting=None if mounting is None else mounting.value,
    )
    raise typer.Exit(
        show_fit(
            given,
            about,
            terms=terms,
            out=out,
            against=against,
            since=_utc(since),
            until=_utc(until),
            anyway=anyway,
            as_json=as_json,
        )
    )


@model_app.command()
def show(file: Annotated[Path, typer.Argument(help="As `fit` writes it.")], as_json: Json = False) -> None:
    """Tell what a model holds: coefficients with their errors, and how good it was."""
    from api.pointing.models import show_model

    show_model(file, as_json)


@model_app.command()
def export(
    file: Annotated[Path, typer.Argument(help="As `fit` writes it.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Standard output if not given.")] = None,
) -> None:
    """Write a model's coefficients as TPOINT does."""
    from api.pointing.models import export as run

    run(file, out)


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
    from api.pointing.models import import_ as run
    from api.pointing.models import modelled_telescope

    run(file, out, modelled_telescope(config, telescope), latitude)


@model_app.command()
def plan(
    config: NeededConfig,
    telescope: Telescope = None,
    points: Points = None,
    spread: Annotated[Spread, typer.Option(help="Golden spiral, or random.")] = Spread.SPIRAL,
    seed: Seed = 0,
    both_sides_each: Annotated[
        bool, typer.Option("--both-sides-each", help="German mounts: each place from every side allowed.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the points of a run: over the allowed sky, in a short way. Nothing moves."""
    from api.pointing.models import show_plan

    show_plan(config, telescope, points, spread.value, seed, both_sides_each, as_json)


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
    spread: Annotated[Spread, typer.Option(help="Golden spiral, or random.")] = Spread.SPIRAL,
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
    from api.pointing.models import modelled_telescope
    from api.pointing.models import run_model as go
    from mountnav.settings.observatory import Settings

    if url is None:
        service = Settings.load(config).service
        url = f"http://{service.host}:{service.port}"
    raise typer.Exit(
        go(
            modelled_telescope(config, telescope),
            url,
            token,
            out,
            points=points,
            kind=spread.value,
            seed=seed,
            model_out=model,
            patience_s=patience,
            as_json=as_json,
        )
    )
