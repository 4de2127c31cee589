"""`mountnav check`: what is wrong with the settings before the service runs; on request, with the devices."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json

if TYPE_CHECKING:
    from api.observatory.checking import Finding

_SIGNS = {"right": "ok", "doubtful": "??", "wrong": "!!"}


def check(
    config: Annotated[Path, config_option("The settings (TOML).")] = Path("observatory.toml"),
    connect: Annotated[
        bool,
        typer.Option(
            "--connect",
            help="Also open each mount and camera, and tell what answers. Nothing is moved or set; some "
            "boards restart when their port is opened.",
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Check the settings whole: files, folders, ports, catalogs. Exit code 2 if something is wrong."""
    import asyncio

    from api.observatory.checking import check_devices, check_settings

    settings, findings = check_settings(config)

    async def connected() -> None:
        assert settings is not None
        async for finding in check_devices(settings):
            findings.append(finding)
            if not as_json:
                typer.echo(_words(finding))

    if not as_json:
        for finding in findings:
            typer.echo(_words(finding))
    if connect and settings is not None:
        asyncio.run(connected())
    wrong = sum(finding.state == "wrong" for finding in findings)
    if as_json:
        print_json({"findings": [asdict(finding) for finding in findings], "wrong": wrong}, indent=2)
    elif wrong:
        typer.echo(f"{wrong} of {len(findings)} wrong", err=True)
    raise typer.Exit(2 if wrong else 0)


def _words(finding: Finding) -> str:
    line = f"{_SIGNS[finding.state]}  {finding.about}: {finding.what}"
    return f"{line}\n    {finding.fix}" if finding.fix else line
