"""`mountnav indi-driver`: a stock indiserver runs the service's telescopes as a driver of its own."""

from __future__ import annotations

from typing import Annotated

import typer


def indi_driver(
    host: Annotated[str, typer.Option(help="Where the service's INDI server listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Its port.")] = 7624,
) -> None:
    """Be an INDI driver, for a stock indiserver: a pipe to the INDI server of a running service."""
    from api.indi_server.relay import relay

    raise typer.Exit(relay(host, port))
