"""The command that lists serial ports."""

from __future__ import annotations

from typing import Annotated

import typer


def ports(
    probe: Annotated[
        bool,
        typer.Option(
            "--probe",
            help="Ask on each what is there: nothing that moves. Some boards start anew when opened.",
        ),
    ] = False,
    port: Annotated[
        list[str] | None,
        typer.Option(help="Only this one: a device path or socket://host:port; repeatable."),
    ] = None,
    alpaca: Annotated[
        bool,
        typer.Option("--alpaca", help="Instead: Alpaca servers that answer on the networks of this machine."),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """List serial ports by their stable names, who holds them and, on request, what answers there."""
    from api.cli.ports import run, run_alpaca

    if alpaca:
        raise typer.Exit(run_alpaca(as_json=json))
    raise typer.Exit(run(asks=probe, ports=tuple(port or ()), as_json=json))
