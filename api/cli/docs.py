"""`mountnav docs`: finds and opens a page of the documentation, offline."""

from __future__ import annotations

from typing import Annotated

import typer

from api.cli.options import Json
from api.cli.output import print_json


def docs(
    topic: Annotated[
        list[str] | None,
        typer.Argument(
            help="A page's name (how-to/night, lx200) or words to look for. Without it, the front page."
        ),
    ] = None,
    open_it: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    every: Annotated[
        bool, typer.Option("--list", help="List all pages that have the words; without words, all.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Tell where a page of the documentation is, or open it. Needs no network.

    A running service has the same pages at /help.
    """
    from api.help.site import FOLDER, find_page, pages

    asked = " ".join(topic or ())
    if every:
        found = find_page(asked) if asked else list(pages())
    elif asked:
        found = find_page(asked)
    else:
        found = [one for one in pages() if one.path == "index.html"]
    chosen = found if every else found[:1]
    if as_json:
        print_json(
            [{"name": one.name, "title": one.title, "file": str(FOLDER / one.path)} for one in chosen],
            indent=2,
        )
    elif every:
        width = max(len(one.name) for one in chosen)
        for one in chosen:
            typer.echo(f"{one.name:<{width}}  {one.title}")
    else:
        typer.echo((FOLDER / chosen[0].path).as_uri())
        others = ", ".join(one.name for one in found[1:6])
        if others:
            typer.echo(f"see also: {others}", err=True)
    if open_it and not every:
        import webbrowser

        webbrowser.open((FOLDER / chosen[0].path).as_uri())
