"""The commands of `mountnav`. What a command needs is imported when it runs, so that help comes at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    name="mountnav",
    help="Finds out where a telescope really points, and puts it where it should.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
catalog_app = typer.Typer(help="The embedded star catalog.", no_args_is_help=True)
app.add_typer(catalog_app, name="catalog")

Json = Annotated[bool, typer.Option("--json", help="JSON, for programs.")]


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


@app.command()
def solve(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Images (FITS, PNG, JPEG).")],
    ra: Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")] = None,
    dec: Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")] = None,
    radius: Annotated[float | None, typer.Option(help="How wrong that may be, degrees.")] = None,
    scale: Annotated[float | None, typer.Option(help="Arcseconds per pixel, good to 5 %.")] = None,
    scale_low: Annotated[float | None, typer.Option(help="Lower bound, arcseconds per pixel.")] = None,
    scale_high: Annotated[float | None, typer.Option(help="Upper bound, arcseconds per pixel.")] = None,
    as_json: Json = False,
) -> None:
    """Find out where images lie in the sky. Hints not given are taken from the header.

    Exit code 0 if all were solved, 1 if some were not, 2 on bad usage.
    """
    from api.solve_command import run

    raise typer.Exit(
        run(
            files, ra=ra, dec=dec, radius=radius, scale=scale, low=scale_low, high=scale_high, as_json=as_json
        )
    )


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
