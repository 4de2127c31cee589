"""`mountnav night`: a running service's nights; `mountnav replay`: a recorded night once more."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Json

night_app = typer.Typer(help="The nights of a running service.", no_args_is_help=True)

Telescope = Annotated[str, typer.Argument(help="Id of the telescope.")]
Service = Annotated[str, typer.Option(help="Address of the service.")]
Token = Annotated[str | None, typer.Option(envvar="MOUNTNAV_TOKEN", help="API token of the service.")]
Why = Annotated[str, typer.Option(help="In your words; the journal keeps them.")]
AT_HOME = "http://127.0.0.1:8000"


@night_app.command()
def status(
    telescope: Telescope, service: Service = AT_HOME, token: Token = None, as_json: Json = False
) -> None:
    """Tell the night's phase, what was measured and corrected, and the drift so far."""
    _ask(telescope, None, "", service, token, as_json)


@night_app.command()
def start(
    telescope: Telescope,
    why: Why = "",
    service: Service = AT_HOME,
    token: Token = None,
    as_json: Json = False,
) -> None:
    """Begin now, whatever the Sun says."""
    _ask(telescope, "start", why, service, token, as_json)


@night_app.command()
def stop(
    telescope: Telescope,
    why: Why = "",
    service: Service = AT_HOME,
    token: Token = None,
    as_json: Json = False,
) -> None:
    """End tonight's; the next night begins by itself."""
    _ask(telescope, "stop", why, service, token, as_json)


@night_app.command()
def pause(
    telescope: Telescope,
    why: Why = "",
    service: Service = AT_HOME,
    token: Token = None,
    as_json: Json = False,
) -> None:
    """Correct nothing until `resume`; frames are still measured."""
    _ask(telescope, "pause", why, service, token, as_json)


@night_app.command()
def resume(
    telescope: Telescope,
    why: Why = "",
    service: Service = AT_HOME,
    token: Token = None,
    as_json: Json = False,
) -> None:
    """Go on after `pause`."""
    _ask(telescope, "resume", why, service, token, as_json)


def replay(
    file: Annotated[Path, typer.Argument(help="A recording, as night.record writes them.")],
    speed: Annotated[
        float, typer.Option(min=0, help="Seconds of the night in one of yours; 0: as fast as it goes.")
    ] = 0.0,
    solve: Annotated[
        bool, typer.Option("--solve/--no-solve", help="Identify the frames anew where their files are there.")
    ] = True,
    wire: Annotated[
        bool,
        typer.Option("--wire/--no-wire", help="Let the driver read the recorded wire as well."),
    ] = True,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Other settings: what would have been decided by them?"),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Also show what was decided the same.")] = False,
    as_json: Json = False,
) -> None:
    """Decide a recorded night once more from what each decision hung on, and compare. Touches no mount.

    Exit code 0 if everything was decided as it was then, 1 if not, 2 if the file is no recording.
    """
    from api.replay.replaying import run

    raise typer.Exit(
        run(file, speed=speed, solve=solve, wire=wire, config=config, every=every, as_json=as_json)
    )


def _ask(telescope: str, word: str | None, why: str, service: str, token: str | None, as_json: bool) -> None:
    from api.cli.night import run

    raise typer.Exit(run(telescope, word, why=why, service=service, token=token, as_json=as_json))
