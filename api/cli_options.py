"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="JSON, for programs.")]
Ra = Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")]
Dec = Annotated[float | None, typer.Option(help="Believed center, degrees (ICRS).")]
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
