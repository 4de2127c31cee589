"""`mountnav catalog`: importing star catalogs, looking at those at hand, the index for blind solving."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import DEC_OPTION, RA_OPTION, Json

catalog_app = typer.Typer(
    help="Star catalogs: the embedded one, imported ones, online ones.", no_args_is_help=True
)

Folder = Annotated[
    Path | None,
    typer.Option(help="Folder of imported catalogs; else that of --config, MOUNTNAV_CATALOGS, or your own."),
]
CatalogsConfig = Annotated[
    Path | None, typer.Option("--config", "-c", help="Settings file: its catalogs table is used.")
]
Name = Annotated[str | None, typer.Argument(help="As `list` has it; the embedded one if not given.")]


@catalog_app.command("import")
def import_(
    kind: Annotated[str, typer.Argument(help="One of: ucac4, usno-b1, gaia, astrometry-net, astap, siril.")],
    path: Annotated[Path, typer.Argument(help="A file, or the folder of the files.")],
    name: Annotated[str | None, typer.Option(help="What it will be called; the kind if not given.")] = None,
    folder: Folder = None,
    config: CatalogsConfig = None,
    mag_limit: Annotated[
        float | None, typer.Option(help="Take only stars as bright as this, in the catalog's band.")
    ] = None,
    cone: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="RA DEC RADIUS", help="Take only stars in this cone, degrees (ICRS)."),
    ] = None,
    dec_range: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Take only stars between these declinations, degrees."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Take the place of a catalog of that name.")] = False,
    as_json: Json = False,
) -> None:
    """Import a star catalog. Interrupted, it goes on when the same command is run again."""
    from api.cli.catalog_import import show_import

    raise typer.Exit(
        show_import(
            kind,
            path,
            name=name,
            folder=folder,
            config=config,
            mag_limit=mag_limit,
            cone=cone,
            dec_range=dec_range,
            force=force,
            as_json=as_json,
        )
    )


@catalog_app.command("list")
def list_(folder: Folder = None, config: CatalogsConfig = None, as_json: Json = False) -> None:
    """List the catalogs at hand: embedded, imported, damaged, unfinished; online ones with --config."""
    from api.cli.catalog import show_list

    show_list(folder, config, as_json)


@catalog_app.command()
def info(
    name: Name = None, folder: Folder = None, config: CatalogsConfig = None, as_json: Json = False
) -> None:
    """Tell what a catalog holds: stars, errors today by magnitude, source, terms."""
    from api.cli.catalog import show_info

    show_info(name, folder, config, as_json)


@catalog_app.command()
def verify(
    name: Name = None,
    every: Annotated[bool, typer.Option("--all", help="All that are on this machine.")] = False,
    folder: Folder = None,
    config: CatalogsConfig = None,
    as_json: Json = False,
) -> None:
    """Read every byte of a catalog and compare its checksum; exit code 1 if it is damaged."""
    from api.cli.catalog import show_verify

    raise typer.Exit(show_verify(name, every, folder, config, as_json))


@catalog_app.command()
def remove(
    name: Annotated[str, typer.Argument(help="As `list` has it; an unfinished import too.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Don't ask.")] = False,
    folder: Folder = None,
    config: CatalogsConfig = None,
) -> None:
    """Remove an imported catalog, or what an unfinished import left."""
    from api.cli.catalog import show_remove

    raise typer.Exit(show_remove(name, yes, folder, config))


@catalog_app.command()
def cone(
    ra: Annotated[float, RA_OPTION],
    dec: Annotated[float, DEC_OPTION],
    radius: Annotated[float, typer.Option(min=0, max=180, help="Degrees.")],
    mag: Annotated[float | None, typer.Option(help="Faintest magnitude.")] = None,
    epoch: Annotated[
        float | None, typer.Option(min=1000, max=3000, help="Julian year; now if not given.")
    ] = None,
    catalog: Annotated[
        str | None, typer.Option(help="As `list` has it; the embedded one if not given.")
    ] = None,
    folder: Folder = None,
    config: CatalogsConfig = None,
    as_json: Json = False,
) -> None:
    """List the stars round a place, brightest first."""
    from api.cli.catalog import show_cone

    show_cone(ra, dec, radius, mag, epoch, as_json, catalog=catalog, folder=folder, config=config)


@catalog_app.command()
def fetch(
    name: Annotated[str, typer.Argument(help="Of an online catalog in the settings file.")],
    config: Annotated[
        Path, typer.Option("--config", "-c", help="Settings file: its catalogs table is used.")
    ],
    ra: Annotated[float, RA_OPTION],
    dec: Annotated[float, DEC_OPTION],
    radius: Annotated[float, typer.Option(min=0, max=180, help="Degrees.")],
    mag: Annotated[float | None, typer.Option(help="Faintest magnitude that will be asked for.")] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=1, max=600, help="Seconds for each round of three tiles.", show_default="the settings'"
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Fetch an area of an online catalog into the cache, for a night without network."""
    from api.cli.catalog_import import show_fetch

    raise typer.Exit(
        show_fetch(
            name,
            config,
            ra_deg=ra,
            dec_deg=dec,
            radius_deg=radius,
            mag_limit=mag,
            timeout_s=timeout,
            as_json=as_json,
        )
    )


@catalog_app.command()
def doctor(
    config: Annotated[Path, typer.Option("--config", "-c", help="The settings (TOML).")],
    as_json: Json = False,
) -> None:
    """Tell for each camera whether the catalogs hold stars enough, and which one would help."""
    from api.cli.catalog_doctor import show_doctor

    raise typer.Exit(show_doctor(config, as_json))


@catalog_app.command()
def index(
    force: Annotated[bool, typer.Option("--force", help="Build it anew if it is there.")] = False,
    as_json: Json = False,
) -> None:
    """Build the index for blind solving, once, into the user's cache; takes half a minute."""
    from api.cli.catalog_import import show_index

    show_index(force, as_json)
