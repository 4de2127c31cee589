"""The commands of `mountnav`. What a command needs is imported when it runs, so that help comes at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli_calibrate import calibrate_app
from api.cli_catalog import catalog_app
from api.cli_frames import accuracy, series, solve

app = typer.Typer(
    name="mountnav",
    help="Finds out where a telescope really points, and puts it where it should.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (solve, series, accuracy):
    app.command()(command)
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(catalog_app, name="catalog")


@app.callback(invoke_without_command=True)
def top(
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
) -> None:
    """Finds out where a telescope really points, and puts it where it should."""
    if version:
        from mountnav import __version__

        typer.echo(f"mountnav {__version__}")
        raise typer.Exit


@app.command()
def serve(
    config: Annotated[Path, typer.Option("--config", "-c", help="The settings (TOML).")],
) -> None:
    """Serve the observatory: REST under /v1, its description at /docs."""
    from api.serving import serve as run
    from mountnav.settings import Settings

    raise typer.Exit(run(Settings.load(config)))


@app.command()
def demo(
    keep: Annotated[bool, typer.Option("--keep", help="Leave the service running afterwards.")] = False,
    host: Annotated[str, typer.Option(help="Where the service listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8000,
    picture: Annotated[Path | None, typer.Option(help="Write a picture of the run (SVG) here.")] = None,
) -> None:
    """Center five targets with an observatory that has no hardware."""
    from api.demo import run

    raise typer.Exit(run(keep=keep, host=host, port=port, picture=picture))


@app.command("fake-mount")
def fake_mount(
    protocol: Annotated[str, typer.Option(help="What it speaks: lx200.")] = "lx200",
    link: Annotated[Path | None, typer.Option(help="Make this a symlink to the pseudo-terminal.")] = None,
    tcp: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Serve on TCP instead.")] = None,
    errors: Annotated[Path | None, typer.Option(help="Pointing errors (TOML).")] = None,
    latitude: Annotated[float, typer.Option(min=-90, max=90, help="Degrees.")] = 47.0,
    longitude: Annotated[float, typer.Option(min=-180, max=180, help="Degrees, east positive.")] = 11.0,
) -> None:
    """Serve a fake mount until interrupted; prints its address when it is ready."""
    from api.fake_mount_command import run

    raise typer.Exit(
        run(protocol, link=link, tcp=tcp, errors=errors, latitude_deg=latitude, longitude_deg=longitude)
    )
