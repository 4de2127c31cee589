"""`mountnav report`: what became of a night, for the morning after."""

from __future__ import annotations

import sys
from datetime import timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json
from mountnav.errors import BadRequest


class ReportForm(StrEnum):
    """How a report is written."""

    MARKDOWN = "markdown"
    HTML = "html"
    JSON = "json"


def report(
    night: Annotated[
        str | None,
        typer.Argument(
            metavar="[NIGHT]", help="The date of its evening: 2026-11-25. If not given, the last one."
        ),
    ] = None,
    telescope: Annotated[
        str | None, typer.Option("--telescope", "-t", help="Only this one; else all that did something.")
    ] = None,
    form: Annotated[
        ReportForm | None, typer.Option("--form", help="By the ending of --out, else Markdown.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="A file (.html, .md, .json).")] = None,
    journal: Annotated[
        str | None, typer.Option(help="A journal's file or URL; that of the settings if not given.")
    ] = None,
    config: Annotated[Path, config_option("The settings: site, journal, telescopes.")] = Path(
        "observatory.toml"
    ),
    as_json: Json = False,
) -> None:
    """Tell what became of a night: targets, errors, time, troubles, and what to do. Read from the journal."""
    from mountnav.clock import utc_now
    from mountnav.files import replace_bytes
    from mountnav.journal.reading import JournalReader
    from mountnav.night.morning_report import night_of, report_of
    from mountnav.night.report_pages import as_html, as_markdown
    from mountnav.settings.observatory import Settings

    settings = Settings.load(config)
    site = settings.site.site
    if night is None:
        # in the morning and in the afternoon the one that has ended, in the evening the one that begins
        night = (utc_now() + timedelta(hours=site.longitude_deg / 15.0 - 18.0)).date().isoformat()
    since, until = night_of(night, site)
    ids = [one.id for one in settings.telescope]
    if telescope is not None and telescope not in ids:
        raise BadRequest(f"there is no telescope {telescope}", advice=f"there is: {', '.join(ids)}")
    reader = JournalReader(journal or settings.journal.where)
    reports = [report_of(reader, one, since, until) for one in ([telescope] if telescope else ids)]
    if telescope is None and any(one.first_utc is not None for one in reports):
        reports = [one for one in reports if one.first_utc is not None]
    chosen = ReportForm.JSON if as_json else form or _by_ending(out)
    if chosen is ReportForm.JSON and out is None:
        print_json([one.as_dict() for one in reports], indent=2)
        return
    if chosen is ReportForm.JSON:
        import json

        text = json.dumps([one.as_dict() for one in reports], indent=2, allow_nan=False) + "\n"
    elif chosen is ReportForm.HTML:
        text = "\n".join(as_html(one) for one in reports)
    else:
        text = "\n".join(as_markdown(one) for one in reports)
    if out is None:
        sys.stdout.write(text)
        return
    replace_bytes(out, text.encode())
    typer.echo(f"{out}: {', '.join(one.telescope for one in reports)}, night of {night}")


def _by_ending(out: Path | None) -> ReportForm:
    ending = "" if out is None else out.suffix.lower()
    return {".html": ReportForm.HTML, ".htm": ReportForm.HTML, ".json": ReportForm.JSON}.get(
        ending, ReportForm.MARKDOWN
    )
