"""`mountnav first-light`: the first order of a telescope that was set up by eye, to a running service."""

from __future__ import annotations

import typer

from api.cli.options import TelescopeOptions, takes_options
from api.cli.output import answering, print_json

LONGEST_S = 900.0
"""For a first light: it takes some ten looks, one or two minutes, and a blind search more on a slow machine.
Given up earlier, it goes on in the service, and its words are lost here."""


@takes_options(TelescopeOptions)
def first_light(options: TelescopeOptions) -> int:
    """Tell a telescope that was set up by eye where it points, and learn its camera.

    It looks, moves a little within its limits, and syncs. Exit code 1 when it couldn't; the words say what to
    do then.
    """
    from mountnav.client import Client

    telescope = options.telescope
    with answering(options.service), Client(options.service, token=options.token) as client:
        job = client.wait(client.first_light(telescope), timeout_s=LONGEST_S)
    done = job["state"] == "succeeded"
    result = job["result"]
    if options.as_json:
        print_json(job, indent=1)
    elif done and result is not None:
        before_deg = result["first"]["offset"]["total_arcsec"] / 3600.0
        after_arcsec = result["last"]["offset"]["total_arcsec"]
        typer.echo(
            f"{telescope}: it was {before_deg:.2f}° off, and is {after_arcsec:.0f}″ off after "
            f"{result['looks']} looks"
        )
        typer.echo(f"camera: {result['learned']}")
    else:
        problem = job["problem"]
        typer.echo(f"{telescope}: {job['state']}: {'' if problem is None else problem}", err=True)
    return 0 if done else 1
