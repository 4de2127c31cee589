"""`mountnav calibrate`: master frames built, told, applied."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Json, ManyValues

calibrate_app = typer.Typer(help="Master bias, dark and flat frames.", no_args_is_help=True)


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
    assume: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="Of frames whose headers don't say it: gain, offset, egain, readout, camera, binning.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Build masters from stacks of frames. All of them or, if a frame doesn't belong there, none."""
    from api.cli.calibrate import run_build

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
            assumed=assume or (),
            as_json=as_json,
        )
    )


@calibrate_app.command("info")
def calibrate_info(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of masters.")], as_json: Json = False
) -> None:
    """Tell what masters a folder holds."""
    from api.cli.calibrate import run_info

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
    from api.cli.calibrate import run_apply

    raise typer.Exit(run_apply(folder, frames, out=out, other_filter=other_filter, as_json=as_json))
