"""The commands that take frames: solve, accuracy, series."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Blind, Budget, Calibration, Catalog, Config, Dec, Json, Profile, Ra, Radius, Scale


def solve(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Images (FITS, PNG, JPEG).")],
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    scale_low: Annotated[float | None, typer.Option(help="Lower bound, arcseconds per pixel.")] = None,
    scale_high: Annotated[float | None, typer.Option(help="Upper bound, arcseconds per pixel.")] = None,
    hdu: Annotated[str | None, typer.Option(help="FITS extension, by number or name.")] = None,
    blind: Blind = None,
    calibration: Calibration = None,
    profile: Profile = None,
    budget: Budget = None,
    config: Config = None,
    catalog: Catalog = None,
    as_json: Json = False,
) -> None:
    """Find out where images lie in the sky. Hints not given are taken from the header.

    A frame that no hint helps with is searched for in the whole sky. The index for that is built once, on
    first need (`mountnav catalog index` builds it beforehand).

    Exit code 0 if all were solved, 1 if some were not, 2 on bad usage.
    """
    from api.cli.chosen_catalogs import chosen_shelf
    from api.cli.solve import run
    from api.solver.solve_settings import chosen_settings

    settings = chosen_settings(
        config=config,
        profile=profile,
        budget_s=budget,
        calibration=calibration,
        blind=None if blind is None else "only" if blind else "never",
    )
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
            catalog=chosen_shelf(config, catalog),
            as_json=as_json,
        )
    )


def accuracy(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Images (FITS, PNG, JPEG).")],
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    reject: Annotated[str, typer.Option(metavar="P,P,...", help="Reject the worst P %.")] = "0,5,10",
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs", help="Also pairs that their deviation threw out of the fit.")
    ] = False,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out", help="Each pair against a plate fit without it.")
    ] = False,
    calibration: Calibration = None,
    profile: Profile = None,
    config: Config = None,
    catalog: Catalog = None,
    as_json: Json = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="A Markdown table.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write histograms and residual maps (PNG) here.")
    ] = None,
) -> None:
    """Tell how accurate the measured places of stars are: mean, spread and extremes against the catalog.

    Exit code 0 if all frames were solved, 1 if some were not (they are listed), 2 on bad usage.
    """
    from api.cli.accuracy import run
    from api.cli.chosen_catalogs import chosen_shelf
    from api.solver.solve_settings import chosen_settings

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
            catalog=chosen_shelf(config, catalog),
        )
    )


def series(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Images, in order of time.")],
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    audit: Annotated[
        int, typer.Option(metavar="N", help="Check every Nth frame by a full solution; 0: never.")
    ] = 10,
    calibration: Calibration = None,
    profile: Profile = None,
    budget: Budget = None,
    config: Config = None,
    catalog: Catalog = None,
    as_json: Json = False,
) -> None:
    """Follow a series of frames: one is solved, the rest placed by their shift; tells the mount's drift.

    Exit code 0 if all frames were placed, 1 if some were not, 2 on bad usage.
    """
    from api.cli.chosen_catalogs import chosen_shelf
    from api.cli.series import run
    from api.solver.solve_settings import chosen_section, solve_settings

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
            catalog=chosen_shelf(config, catalog),
            as_json=as_json,
        )
    )
