"""`mountnav site-time`: ways out when a mount's site or clock contradicts a running service's settings."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from api.cli.cli_night import AT_HOME, Service, Telescope, Token
from api.cli.options import Json

LONGEST_S = 60.0
"""A mount is told its site and clock in some ten exchanges, each of which may take a second or two."""


def site_time(
    telescope: Telescope,
    set_mount: Annotated[
        bool, typer.Option("--set", help="Set the mount's site and clock to those of the service.")
    ] = False,
    accept: Annotated[
        bool,
        typer.Option(
            "--accept", help="The difference is meant so: slew all the same. Needs the role configure."
        ),
    ] = False,
    service: Service = AT_HOME,
    token: Token = None,
    as_json: Json = False,
) -> None:
    """Tell whether a mount's site and clock agree with the settings; set them, or accept the difference.

    Nothing is slewed while they contradict each other. Exit code 1 while they do.
    """
    from mountnav.client import Client
    from mountnav.client.orders import accept_site_time, set_site_time
    from mountnav.errors import BadSettings

    if set_mount and accept:
        raise BadSettings("--set and --accept were both given", advice="give one of them")
    with Client(service, token=token) as client:
        if set_mount or accept:
            order = set_site_time() if set_mount else accept_site_time()
            job = client.wait(client.order(telescope, order), timeout_s=LONGEST_S)
            if job["state"] != "succeeded":
                problem = job["problem"]
                why = job["state"] if problem is None else problem["detail"] or problem["title"]
                typer.echo(f"{telescope}: {why}", err=True)
                raise typer.Exit(1)
        state = client.telescope(telescope)
    words = state["contradiction"]
    if as_json:
        told = {"telescope": telescope, "connected": state["connected"], "contradiction": words}
        typer.echo(json.dumps(told, indent=1))
    elif not state["connected"]:
        typer.echo(f"{telescope}: not connected: nobody knows", err=True)
    elif words is None:
        typer.echo(f"{telescope}: mount and settings agree{', by your word' if accept else ''}")
    else:
        typer.echo(f"{telescope}: mount and settings contradict each other: {words}")
        typer.echo("ways out: --set (the mount is wrong), the settings or this machine's clock, --accept")
    if words is not None or not state["connected"]:
        raise typer.Exit(1)


__all__ = ["site_time"]
