"""The command that serves an observatory: the one of the settings, or a virtual one."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class _Mounting(StrEnum):
    GERMAN = "german"
    FORK = "fork"


def serve(
    config: Annotated[Path | None, typer.Option("--config", "-c", help="The settings (TOML).")] = None,
    demo: Annotated[
        bool, typer.Option("--demo", help="A virtual observatory: a fake mount under the true sky.")
    ] = False,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="UTC|night",
            help="When the virtual time begins: 2026-12-01T22:00:00Z, or night: now if it is dark, else "
            "the beginning of the next night. Now if left out.",
        ),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Virtual seconds in a second, 0.1 to 60.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Another mount, wrong in another way; the same each time.")
    ] = None,
    mounting: Annotated[_Mounting | None, typer.Option(help="Of the virtual mount.")] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Instead of the settings'; 0: any that is free.")
    ] = None,
) -> None:
    """Serve an observatory: the page at /, REST under /v1, its description at /docs, Alpaca under /api/v1."""
    from api.cli.serve import Serve, run

    raise typer.Exit(
        run(
            Serve(
                config=config,
                demo=demo,
                at=at,
                speed=speed,
                seed=seed,
                mounting=None if mounting is None else mounting.value,
                port=port,
            )
        )
    )
