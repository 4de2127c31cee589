"""Commands about real mounts and their lines."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer


class _Mounting(StrEnum):
    """What a fake to compare with may be built like."""

    FORK = "fork"
    GERMAN = "german"


_BUILDS: dict[_Mounting, Literal["fork", "german"]] = {_Mounting.FORK: "fork", _Mounting.GERMAN: "german"}


def wire(
    what: Annotated[str, typer.Argument(help="Id of a telescope of a running service, or a mount's URL.")],
    service: Annotated[str, typer.Option(help="Address of the service.")] = "http://127.0.0.1:8000",
    token: Annotated[
        str | None, typer.Option(envvar="MOUNTNAV_TOKEN", help="API token of the service.")
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow/--no-follow", help="Go on until interrupted, or show what there is.")
    ] = True,
    json: Annotated[bool, typer.Option("--json", help="JSON lines, as recorded dialogues are kept.")] = False,
    dump: Annotated[Path | None, typer.Option(help="Write the JSON lines here as well.")] = None,
) -> None:
    """Watch what goes over a mount's line."""
    from api.cli.wire import run

    raise typer.Exit(run(what, service=service, token=token, follow=follow, as_json=json, dump=dump))


def bench(
    url: Annotated[str, typer.Argument(help="The mount, such as lx200+serial:///dev/ttyUSB0.")],
    latitude: Annotated[float, typer.Option(min=-90, max=90, help="Where it stands, degrees.")],
    longitude: Annotated[float, typer.Option(min=-180, max=180, help="Degrees, east positive.")],
    step: Annotated[
        list[str] | None,
        typer.Option(help="Only read, move, stop, sync, track, guide, limit, flip, park; repeatable."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Don't ask before each step. It moves!")] = False,
    compare: Annotated[
        bool, typer.Option("--compare/--no-compare", help="Try the same on a fake of its family.")
    ] = True,
    dialect: Annotated[str | None, typer.Option(help="Of that fake; see `fake-mount --list`.")] = None,
    mounting: Annotated[
        _Mounting | None,
        typer.Option(help="Build of that fake; as the mount shows itself, or its family usually is."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the findings here (JSON).")] = None,
    transcript: Annotated[
        Path | None,
        typer.Option(help="Write what was said here, for `fake-mount --replay`."),
    ] = None,
    watch: Annotated[float, typer.Option(min=1, max=3600, help="Seconds to watch it track.")] = 30.0,
    lowest: Annotated[float, typer.Option(min=0, max=80, help="Lowest altitude to be sent to.")] = 20.0,
) -> None:
    """Try a real mount step by step, each step asked for; a fake in its place tries the steps."""
    from api.cli.bench import BenchRun, run

    raise typer.Exit(
        run(
            BenchRun(
                url=url,
                latitude_deg=latitude,
                longitude_deg=longitude,
                steps=tuple(step or ()),
                yes=yes,
                compare=compare,
                dialect=dialect,
                mounting=None if mounting is None else _BUILDS[mounting],
                report=report,
                transcript=transcript,
                watch_s=watch,
                lowest_altitude_deg=lowest,
            )
        )
    )
