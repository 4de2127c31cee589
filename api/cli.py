"""The commands of `mountnav`. What a command needs is imported when it runs, so that help comes at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.many_values import ManyValues

app = typer.Typer(
    name="mountnav",
    help="Finds out where a telescope really points, and puts it where it should.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
catalog_app = typer.Typer(help="The embedded star catalog.", no_args_is_help=True)
app.add_typer(catalog_app, name="catalog")
calibrate_app = typer.Typer(help="Master bias, dark and flat frames.", no_args_is_help=True)
app.add_typer(calibrate_app, name="calibrate")

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
    hdu: Annotated[str | None, typer.Option(help="FITS extension, by number or name.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Folder of masters to calibrate with.")] = None,
    profile: Annotated[str | None, typer.Option(help="Parameters: measured or paper.")] = None,
    budget: Annotated[
        float | None,
        typer.Option(min=0.01, max=3600, help="Seconds for identifying a file; 30 if not given."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Settings file: its solving table is used.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find out where images lie in the sky. Hints not given are taken from the header.

    Exit code 0 if all were solved, 1 if some were not, 2 on bad usage.
    """
    from api.solve_command import run
    from api.solving import chosen_settings

    settings = chosen_settings(config=config, profile=profile, budget_s=budget, calibration=calibration)
    raise typer.Exit(
        run(
            files,
            ra=ra,
            dec=dec,
            radius=radius,
            scale=scale,
            low=scale_low,
            high=scale_high,
            hdu=hdu,
            settings=settings,
            as_json=as_json,
        )
    )


@app.command()
def accuracy(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Images (FITS, PNG, JPEG).")],
    ra: Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")] = None,
    dec: Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")] = None,
    radius: Annotated[float | None, typer.Option(help="How wrong that may be, degrees.")] = None,
    scale: Annotated[float | None, typer.Option(help="Arcseconds per pixel, good to 5 %.")] = None,
    reject: Annotated[str, typer.Option(metavar="P,P,...", help="Reject the worst P %.")] = "0,5,10",
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs", help="Also pairs that their deviation threw out of the fit.")
    ] = False,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out", help="Each pair against a plate fit without it.")
    ] = False,
    calibration: Annotated[Path | None, typer.Option(help="Folder of masters to calibrate with.")] = None,
    profile: Annotated[str | None, typer.Option(help="Parameters: measured or paper.")] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Settings file: its solving table is used.")
    ] = None,
    as_json: Json = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="A Markdown table.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write histograms and residual maps (PNG) here.")
    ] = None,
) -> None:
    """Tell how accurate the measured places of stars are: mean, spread and extremes against the catalog.

    Exit code 0 if all frames were solved, 1 if some were not (they are listed), 2 on bad usage.
    """
    from api.accuracy_command import run
    from api.solving import chosen_settings

    settings = chosen_settings(config=config, profile=profile, budget_s=None, calibration=calibration)
    raise typer.Exit(
        run(
            frames,
            ra=ra,
            dec=dec,
            radius=radius,
            scale=scale,
            reject=reject,
            every=all_pairs,
            leave_one_out=leave_one_out,
            as_json=as_json,
            as_markdown=as_markdown,
            plot=plot,
            settings=settings,
        )
    )


@app.command()
def series(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Images, in order of time.")],
    ra: Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")] = None,
    dec: Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")] = None,
    radius: Annotated[float | None, typer.Option(help="How wrong that may be, degrees.")] = None,
    scale: Annotated[float | None, typer.Option(help="Arcseconds per pixel, good to 5 %.")] = None,
    audit: Annotated[
        int, typer.Option(metavar="N", help="Check every Nth frame by a full solution; 0: never.")
    ] = 10,
    calibration: Annotated[Path | None, typer.Option(help="Folder of masters to calibrate with.")] = None,
    profile: Annotated[str | None, typer.Option(help="Parameters: measured or paper.")] = None,
    budget: Annotated[
        float | None,
        typer.Option(min=0.01, max=3600, help="Seconds for a full solution; 30 if not given."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Settings file: its solving table is used.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Follow a series of frames: one is solved, the rest placed by their shift; tells the mount's drift.

    Exit code 0 if all frames were placed, 1 if some were not, 2 on bad usage.
    """
    from api.series_command import run
    from api.solving import chosen_section, solve_settings

    section = chosen_section(config, profile, budget)
    raise typer.Exit(
        run(
            frames,
            ra=ra,
            dec=dec,
            radius=radius,
            scale=scale,
            audit=audit,
            preliminary=section.preliminary_settings,
            solving=solve_settings(section, calibration=calibration),
            as_json=as_json,
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


@calibrate_app.command("build", cls=ManyValues)
def calibrate_build(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the masters; made if it isn't there.")],
    bias: Annotated[
        list[str] | None, typer.Option(metavar="F...", help="Bias frames: files, folders, patterns.")
    ] = None,
    dark: Annotated[list[str] | None, typer.Option(metavar="F...", help="Dark frames.")] = None,
    flat: Annotated[
        list[str] | None, typer.Option(metavar="F...", help="Flats, of one or more filters.")
    ] = None,
    flat_from_lights: Annotated[
        list[str] | None,
        typer.Option(
            metavar="F...", help="Frames of several fields, made a flat by the inverse median filter."
        ),
    ] = None,
    zero: Annotated[
        float | None,
        typer.Option(help="ADU of a pixel without light, for --flat-from-lights without a bias."),
    ] = None,
    method: Annotated[str, typer.Option(help="Of what is left after clipping: mean or median.")] = "mean",
    kappa: Annotated[float, typer.Option(help="Clip beyond so many sigma.")] = 5.0,
    as_json: Json = False,
) -> None:
    """Build masters from stacks of frames. All of them or, if a frame doesn't belong there, none."""
    from api.calibrate_command import run_build

    raise typer.Exit(
        run_build(
            out,
            bias=bias or (),
            dark=dark or (),
            flat=flat or (),
            lights=flat_from_lights or (),
            zero_adu=zero,
            method=method,
            kappa_sigma=kappa,
            as_json=as_json,
        )
    )


@calibrate_app.command("info")
def calibrate_info(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of masters.")], as_json: Json = False
) -> None:
    """Tell what masters a folder holds."""
    from api.calibrate_command import run_info

    raise typer.Exit(run_info(folder, as_json=as_json))


@calibrate_app.command("apply")
def calibrate_apply(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of masters.")],
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Raw frames.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the calibrated frames.")],
    other_filter: Annotated[
        bool,
        typer.Option("--other-filter", help="Use a flat of another filter if there is none of the frame's."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Calibrate frames and write them as FITS. Exit code 1 if some could not be."""
    from api.calibrate_command import run_apply

    raise typer.Exit(run_apply(folder, frames, out=out, other_filter=other_filter, as_json=as_json))
