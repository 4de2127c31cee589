"""`mountnav first-light`: the first order of a telescope that was set up by eye, to a running service."""

from __future__ import annotations

import json

import typer

from api.cli.cli_night import AT_HOME, Service, Telescope, Token
from api.cli.options import Json

LONGEST_S = 900.0
"""A first light takes some ten looks: one or two minutes, and a blind search more on a slow machine."""


def first_light(
    telescope: Telescope, service: Service = AT_HOME, token: Token = None, as_json: Json = False
) -> None:
    """Tell a telescope that was set up by eye where it points, and learn its camera.

    It looks, moves a little within its limits, and syncs. Exit code 1 when it couldn't; the words say what to
    do then.
    """
    from mountnav.client import Client

    with Client(service, token=token) as client:
        job = client.wait(client.first_light(telescope), timeout_s=LONGEST_S)
    done = job["state"] == "succeeded"
    if as_json:
        typer.echo(json.dumps(job, indent=1))
    elif done and job["result"] is not None:
        result = job["result"]
        off_deg, left = (
            result["first"]["offset"]["total_arcsec"] / 3600.0,
            result["last"]["offset"]["total_arcsec"],
        )
        typer.echo(
            f"{telescope}: it was {off_deg:.2f}° off, and is {left:.0f}″ off after {result['looks']} looks"
        )
        typer.echo(f"camera: {result['learned']}")
    else:
        problem = job["problem"]
        typer.echo(f"{telescope}: {job['state']}: {'' if problem is None else problem}", err=True)
    if not done:
        raise typer.Exit(1)


__all__ = ["first_light"]
