"""The command that serves a fake mount."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def fake_mount(
    protocol: Annotated[
        str, typer.Option(help="What it speaks: lx200, nexstar, synscan, ioptron, skywatcher.")
    ] = "lx200",
    dialect: Annotated[str | None, typer.Option(help="How it speaks it; --list tells what there is.")] = None,
    list_all: Annotated[bool, typer.Option("--list", help="List protocols and dialects, and leave.")] = False,
    link: Annotated[Path | None, typer.Option(help="Make this a symlink to the pseudo-terminal.")] = None,
    tcp: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Serve on TCP instead.")] = None,
    udp: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Serve on UDP instead.")] = None,
    baud: Annotated[
        int | None, typer.Option(min=50, help="Let bytes take their time, as on a line of this speed.")
    ] = None,
    mechanics: Annotated[Path | None, typer.Option(help="How the mount is built (TOML).")] = None,
    errors: Annotated[Path | None, typer.Option(help="Pointing errors (TOML).")] = None,
    faults: Annotated[Path | None, typer.Option(help="What goes wrong, and when (TOML).")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the random faults, instead of the file's.")
    ] = None,
    struck: Annotated[
        Path | None, typer.Option(help="At the end write here what struck, as a faults file that repeats it.")
    ] = None,
    speed: Annotated[float | None, typer.Option(min=0.01, max=1000, help="How fast its time runs.")] = None,
    record: Annotated[Path | None, typer.Option(help="Write the dialogue here (JSON lines).")] = None,
    replay: Annotated[
        Path | None, typer.Option(help="Take its identity from this recording of a real mount.")
    ] = None,
    latitude: Annotated[float, typer.Option(min=-90, max=90, help="Degrees.")] = 47.0,
    longitude: Annotated[float, typer.Option(min=-180, max=180, help="Degrees, east positive.")] = 11.0,
) -> None:
    """Serve a fake mount until interrupted; prints its address when it is ready."""
    from api.cli.fake_mount import FakeMount, list_fakes, run

    if list_all:
        raise typer.Exit(list_fakes())
    raise typer.Exit(
        run(
            FakeMount(
                protocol=protocol,
                dialect=dialect,
                link=link,
                tcp=tcp,
                udp=udp,
                baud=baud,
                mechanics=mechanics,
                errors=errors,
                faults=faults,
                seed=seed,
                struck=struck,
                speed=speed,
                record=record,
                replay=replay,
                latitude_deg=latitude,
                longitude_deg=longitude,
            )
        )
    )
