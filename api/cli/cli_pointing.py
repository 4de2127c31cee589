"""The commands that judge a mount by its looks: `mountnav pointing-doctor` and `mountnav drift`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Json

Source = Annotated[
    str | None,
    typer.Argument(
        metavar="[SOURCE]",
        help="Observations (.jsonl), or a journal's file or URL; the service's journal if not given.",
        show_default=False,
    ),
]
Settings = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="Settings file: site, journal and the telescope are taken from it."),
]
Telescope = Annotated[str | None, typer.Option("--telescope", "-t", help="Which one of the journal.")]
Since = Annotated[str | None, typer.Option(help="From then on: 2026-11-21T20:00 (UTC), or 12h ago.")]
Until = Annotated[str | None, typer.Option(help="Up to then.")]
Latitude = Annotated[float | None, typer.Option(help="Of the site, degrees, instead of the settings'.")]
Longitude = Annotated[float | None, typer.Option(help="Of the site, degrees, EAST positive.")]
Model = Annotated[Path | None, typer.Option(help="A pointing model's file: what is known of the mount.")]


def pointing_doctor(
    source: Source = None,
    config: Settings = None,
    telescope: Telescope = None,
    since: Since = None,
    until: Until = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    epoch: Annotated[
        str | None, typer.Option(help="What the mount is believed to speak: apparent (JNow) or icrs (J2000).")
    ] = None,
    mounting: Annotated[str | None, typer.Option(help="german, fork or altaz.")] = None,
    parity: Annotated[
        int | None, typer.Option(help="Of its images: 1 as the sky is seen, -1 mirrored.")
    ] = None,
    rotator: Annotated[bool, typer.Option("--rotator", help="The camera turns by itself.")] = False,
    model: Model = None,
    unsynced: Annotated[
        bool, typer.Option("--unsynced", help="Nothing was synced in these looks (a journal knows that).")
    ] = False,
    points_within: Annotated[
        float | None, typer.Option(help="The mount is known to point within so many arcseconds.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Tell what a night's looks say about the mount. Exit code 1 if something is wrong."""
    from api.pointing.judgements import run_doctor

    raise typer.Exit(
        run_doctor(
            source,
            config=config,
            telescope=telescope,
            since=since,
            until=until,
            latitude=latitude,
            longitude=longitude,
            epoch=epoch,
            mounting=mounting,
            parity=parity,
            rotator=rotator,
            model=model,
            points_within=points_within,
            unsynced=unsynced,
            as_json=as_json,
        )
    )


def drift(
    source: Source = None,
    config: Settings = None,
    telescope: Telescope = None,
    since: Since = None,
    until: Until = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    model: Model = None,
    worm_period: Annotated[float | None, typer.Option(help="Of the worm, seconds, if known.")] = None,
    mount_refracts: Annotated[
        bool, typer.Option("--mount-refracts", help="The mount corrects refraction itself.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Tell how a mount drifts, swings and settles, and how to turn its polar axis."""
    from api.pointing.judgements import run_drift

    raise typer.Exit(
        run_drift(
            source,
            config=config,
            telescope=telescope,
            since=since,
            until=until,
            latitude=latitude,
            longitude=longitude,
            model=model,
            worm_period=worm_period,
            mount_refracts=mount_refracts,
            as_json=as_json,
        )
    )
