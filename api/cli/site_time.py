"""`mountnav site-time`: ways out when a mount's site or clock contradicts a running service's settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from api.cli.options import TelescopeOptions, takes_options
from api.cli.output import answering, print_json
from mountnav.errors import BadSettings

LONGEST_S = 60.0
"""For setting a mount's site and clock: some ten exchanges, each of which may take a second or two. With half
of it a slow handset is given up before it is done; the service would go on all the same."""


@dataclass(frozen=True, kw_only=True)
class SiteTimeOptions(TelescopeOptions):
    """Options of `site-time`."""

    set_mount: Annotated[
        bool, typer.Option("--set", help="Set the mount's site and clock to those of the service.")
    ] = False
    accept: Annotated[
        bool,
        typer.Option("--accept", help="The difference is intended: slew anyway. Needs the role configure."),
    ] = False


@takes_options(SiteTimeOptions)
def site_time(options: SiteTimeOptions) -> int:
    """Tell whether a mount's site and clock agree with the settings; set them, or accept the difference.

    Nothing is slewed while they contradict each other. Exit code 1 while they do.
    """
    from mountnav.client import Client
    from mountnav.client.orders import accept_site_time, set_site_time

    telescope, set_mount, accept = options.telescope, options.set_mount, options.accept
    if set_mount and accept:
        raise BadSettings("--set and --accept were both given", advice="give one of them")
    with answering(options.service), Client(options.service, token=options.token) as client:
        if set_mount or accept:
            order = set_site_time() if set_mount else accept_site_time()
            job = client.wait(client.order(telescope, order), timeout_s=LONGEST_S)
            if job["state"] != "succeeded":
                problem = job["problem"]
                why = job["state"] if problem is None else problem["detail"] or problem["title"]
                typer.echo(f"{telescope}: {why}", err=True)
                return 1
        state = client.telescope(telescope)
    contradiction = state["contradiction"]
    if options.as_json:
        print_json(
            {"telescope": telescope, "connected": state["connected"], "contradiction": contradiction},
            indent=1,
        )
    elif not state["connected"]:
        typer.echo(f"{telescope}: not connected, so not known", err=True)
    elif contradiction is None:
        typer.echo(f"{telescope}: mount and settings agree{', as you confirmed' if accept else ''}")
    else:
        typer.echo(f"{telescope}: mount and settings contradict each other: {contradiction}")
        typer.echo("ways out: --set (the mount is wrong), the settings or this machine's clock, --accept")
    return 1 if contradiction is not None or not state["connected"] else 0
