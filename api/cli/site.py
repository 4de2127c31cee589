"""`mountnav site`: many services on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import config_option


def site(
    config: Annotated[Path, config_option("The services of the site (TOML).")],
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Instead of the file's; 0: any that is free.")
    ] = None,
) -> None:
    """Show many services on one page, read only; STOP ALL goes to each of them with its own key."""
    from mountnav.settings.site_file import SiteFile

    settings = SiteFile.load(config)
    if port is not None:
        settings = settings.model_copy(update={"site": settings.site.model_copy(update={"port": port})})
    # only now: a wrong file is refused without it
    from api.site.serving import serve_site

    raise typer.Exit(serve_site(settings))
