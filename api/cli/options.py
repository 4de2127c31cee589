"""Options that several commands share, and the command class of options with many values."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperCommand

from mountnav.sky.typed_coordinates import read_dec_deg, read_ra_deg

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


class ManyValues(TyperCommand):
    """A command whose options named in `many` may be followed by several values: ``--dark a.fits b.fits``."""

    many: ClassVar[frozenset[str]] = frozenset({"--bias", "--dark", "--flat", "--flat-from-lights"})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option's name before each of its values, then parse as usual."""
        spread: list[str] = []
        name, values = "", 0
        for word in args:
            if word.startswith("-") and len(word) > 1:
                name, values = (word if word in self.many else ""), 0
            elif name:
                if values:
                    spread.append(name)
                values += 1
            spread.append(word)
        return super().parse_args(ctx, spread)
