"""The commands of `mountnav`. What a command needs is imported when it runs, so that help comes at once."""

from __future__ import annotations

from typing import Annotated

import typer

from api.cli.accuracy import accuracy
from api.cli.archive import archive_app
from api.cli.bench import bench
from api.cli.calibrate import calibrate_app
from api.cli.catalog import catalog_app
from api.cli.check import check
from api.cli.demo import demo
from api.cli.docs import docs
from api.cli.drift import drift
from api.cli.ephemeris import ephemeris_app
from api.cli.fake_mount import fake_mount
from api.cli.first_light import first_light
from api.cli.indi_driver import indi_driver
from api.cli.init import init
from api.cli.journal import journal_app
from api.cli.keys import key_app
from api.cli.model import model_app
from api.cli.night import night_app
from api.cli.operate import center, follow, look, park, slew, status, stop, sync, track, unpark, watch
from api.cli.pointing_doctor import pointing_doctor
from api.cli.ports import ports
from api.cli.replay import replay
from api.cli.report import report
from api.cli.series import series
from api.cli.serve import serve
from api.cli.site_time import site_time
from api.cli.solve import solve
from api.cli.solver import solver_app
from api.cli.wire import wire

app = typer.Typer(
    name="mountnav",
    help="Finds out where a telescope really points, and puts it where it should.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
# in the order in which help lists them
app.command("status")(status)
app.command("stop")(stop)
app.command("center")(center)
app.command("slew")(slew)
app.command("follow")(follow)
app.command("look")(look)
app.command("sync")(sync)
app.command("track")(track)
app.command("park")(park)
app.command("unpark")(unpark)
app.command("watch")(watch)
app.command("solve")(solve)
app.command("series")(series)
app.command("accuracy")(accuracy)
app.command("fake-mount")(fake_mount)
app.command("wire")(wire)
app.command("bench")(bench)
app.command("ports")(ports)
app.command("first-light")(first_light)
app.command("site-time")(site_time)
app.command("replay")(replay)
app.command("report")(report)
app.command("drift")(drift)
app.command("pointing-doctor")(pointing_doctor)
app.command("init")(init)
app.command("check")(check)
app.command("serve")(serve)
app.command("indi-driver")(indi_driver)
app.command("demo")(demo)
app.add_typer(archive_app, name="archive")
app.command("docs")(docs)
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(catalog_app, name="catalog")
app.add_typer(ephemeris_app, name="ephemeris")
app.add_typer(journal_app, name="journal")
app.add_typer(model_app, name="model")
app.add_typer(night_app, name="night")
app.add_typer(key_app, name="key")
# the same, for who writes the plural
app.add_typer(key_app, name="keys", hidden=True)
app.add_typer(solver_app, name="solver")


@app.callback(invoke_without_command=True)
def top(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Finds out where a telescope really points, and puts it where it should."""
    if version:
        from mountnav import __version__

        typer.echo(f"mountnav {__version__}")
        raise typer.Exit
