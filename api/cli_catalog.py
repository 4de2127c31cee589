"""`mountnav catalog`: what the embedded catalog holds, stars round a place, the index for blind solving."""

from __future__ import annotations

from typing import Annotated

import typer

from api.cli_options import Json

catalog_app = typer.Typer(help="The embedded star catalog.", no_args_is_help=True)


@catalog_app.command()
def info(as_json: Json = False) -> None:
    """Tell what the embedded catalog holds."""
    from api.catalog_command import show_info

    show_info(as_json)


@catalog_app.command()
def cone(
    ra: Annotated[float, typer.Option(min=0, max=360, help="Degrees (ICRS).")],
    dec: Annotated[float, typer.Option(min=-90, max=90, help="Degrees (ICRS).")],
    radius: Annotated[float, typer.Option(min=0, max=180, help="Degrees.")],
    mag: Annotated[float | None, typer.Option(help="Faintest magnitude.")] = None,
    epoch: Annotated[
        float | None, typer.Option(min=1000, max=3000, help="Julian year; now if not given.")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the stars round a place, brightest first."""
    from api.catalog_command import show_cone

    show_cone(ra, dec, radius, mag, epoch, as_json)


@catalog_app.command()
def index(
    force: Annotated[bool, typer.Option("--force", help="Build it anew if it is there.")] = False,
    as_json: Json = False,
) -> None:
    """Build the index for blind solving, once, into the user's cache; takes half a minute."""
    from api.catalog_index_command import show_index

    show_index(force, as_json)
