"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mountnav.sky.typed import read_dec_deg, read_ra_deg

Json = Annotated[bool, typer.Option("--json", help="JSON, for programs.")]
RA_OPTION = typer.Option(parser=read_ra_deg, metavar="RA", help="Center (ICRS): degrees, or 12h30m45s.")
DEC_OPTION = typer.Option(parser=read_dec_deg, metavar="DEC", help="Center (ICRS): degrees, or +10:20:30.")
Ra = Annotated[float | None, RA_OPTION]
Dec = Annotated[float | None, DEC_OPTION]
Radius = Annotated[float | None, typer.Option(help="How wrong that may be, degrees.")]
Scale = Annotated[float | None, typer.Option(help="Arcseconds per pixel, good to 5 %.")]
Calibration = Annotated[Path | None, typer.Option(help="Folder of masters to calibrate with.")]
Profile = Annotated[str | None, typer.Option(help="Parameters: measured or paper.")]
Budget = Annotated[
    float | None,
    typer.Option(min=0.01, max=3600, help="Seconds for identifying a frame; 30 if not given."),
]
Blind = Annotated[
    bool | None,
    typer.Option(
        "--blind/--no-blind",
        help="Search the whole sky and ask no hint, or never search it; else it is searched after the hint "
        "failed.",
        show_default=False,
    ),
]
Config = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="Settings file: its solving and catalogs tables are used."),
]
Catalog = Annotated[
    str | None,
    typer.Option(
        help="Use this star catalog alone (see `mountnav catalog list`); else the one that suits the frame."
    ),
]
