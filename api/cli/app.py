"""The commands of `mountnav`. What a command needs is imported when it runs, so that help comes at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.cli_calibrate import calibrate_app
from api.cli.cli_catalog import catalog_app
from api.cli.cli_fake import fake_mount
from api.cli.cli_frames import accuracy, series, solve
from api.cli.cli_journal import journal_app
from api.cli.cli_keys import key_app
from api.cli.cli_model import model_app
from api.cli.cli_mounts import bench, wire
from api.cli.cli_night import night_app, replay
from api.cli.cli_pointing import drift, pointing_doctor
from api.cli.cli_ports import ports
from api.cli.cli_serve import serve
from api.cli.first_light import first_light
from api.cli.indi_driver import indi_driver
from api.cli.site_time import site_time

app = typer.Typer(
    name="mountnav",
    help="Finds out where a telescope really points, and puts it where it should.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (solve, series, accuracy):
    app.command()(command)
app.command("fake-mount")(fake_mount)
app.command()(wire)
app.command()(bench)
app.command()(ports)
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(catalog_app, name="catalog")
app.add_typer(journal_app, name="journal")
app.add_typer(model_app, name="model")
app.add_typer(night_app, name="night")
app.add_typer(key_app, name="key")
app.command("first-light")(first_light)
app.command("site-time")(site_time)
app.command()(replay)
app.command()(drift)
app.command("pointing-doctor")(pointing_doctor)
app.command()(serve)
app.command()(indi_driver)


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
def demo(
    keep: Annotated[bool, typer.Option("--keep", help="Leave the service running afterwards.")] = False,
    host: Annotated[str, typer.Option(help="Where the service listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8000,
    picture: Annotated[Path | None, typer.Option(help="Write a picture of the run (SVG) here.")] = None,
) -> None:
    """Center five targets with an observatory that has no hardware."""
    from api.cli.demo import run

    raise typer.Exit(run(keep=keep, host=host, port=port, picture=picture))
