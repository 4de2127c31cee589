"""`mountnav report`: what became of a night, for the morning after."""

from __future__ import annotations

import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import LOCAL_SERVICE, Json, Token, config_option
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
    bundle: Annotated[
        bool,
        typer.Option(
            "--bundle",
            help="One zip for those who look for a fault: settings without secrets, journal, audit, wire, "
            "recordings, versions, system. `mountnav replay` reads it.",
        ),
    ] = False,
    service: Annotated[
        str, typer.Option(envvar="MOUNTNAV_SERVICE", help="For --bundle: a running service; empty: none.")
    ] = LOCAL_SERVICE,
    token: Token = None,
    as_json: Json = False,
) -> None:
    """Tell what became of a night: targets, errors, time, troubles, and what to do. Read from the journal."""
    if bundle:
        _make_bundle(night, out, journal, config, service, token, as_json)
        return
    from mountnav.clock import utc_now
    from mountnav.files import replace_bytes
    from mountnav.journal.reading import JournalReader
    from mountnav.night.morning_report import night_of, report_of
    from mountnav.night.report_pages import as_html, as_markdown
    from mountnav.settings.observatory import Settings

    settings = Settings.load(config)
    site = settings.site.site
    night = night or _latest_night(utc_now(), site.longitude_deg)
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


def _latest_night(utc: datetime, longitude_deg: float) -> str:
    """In the morning and in the afternoon the one that has ended, in the evening the one that begins."""
    return (utc + timedelta(hours=longitude_deg / 15.0 - 18.0)).date().isoformat()


def _make_bundle(
    night: str | None,
    out: Path | None,
    journal: str | None,
    config: Path,
    service: str,
    token: str | None,
    as_json: bool,
) -> None:
    """Write a bundle of a night, or of the last two days."""
    from api.bundle.bundle import Asked, make_bundle, summary
    from mountnav.clock import utc_now
    from mountnav.errors import BadSettings
    from mountnav.night.morning_report import night_of
    from mountnav.settings.observatory import Settings
    from mountnav.sky.coordinates import Site

    now = utc_now()
    since, until = now - timedelta(days=2), now + timedelta(minutes=1)
    if night is not None:
        try:
            site = Settings.load(config).site.site
        except BadSettings:
            # a day more on each side, wherever it stands
            since, until = night_of(night, Site(0.0, 0.0))
            since, until = since - timedelta(days=1), until + timedelta(days=1)
        else:
            since, until = night_of(night, site)
    target = out or Path(f"mountnav-bundle-{now:%Y%m%dT%H%M%SZ}.zip")
    if target.is_dir():
        target = target / f"mountnav-bundle-{now:%Y%m%dT%H%M%SZ}.zip"
    if target.exists():
        raise BadRequest(f"{target} is there already", advice="name another file with --out")
    ask = _asker(service, token) if service else None
    found = make_bundle(Asked(since, until, config, journal, ask), target, now)
    if as_json:
        print_json({"bundle": str(target), **summary(found)}, indent=1)
        return
    typer.echo(f"{target}: {target.stat().st_size / 1e6:.1f} MB, {len(found.files)} files, secrets masked")
    for name, why in found.missing.items():
        typer.echo(f"  without {name}: {why}")


def _asker(service: str, token: str | None) -> Callable[[str], str]:
    """Asks a running service, with little patience: it may be what is broken."""

    def ask(path: str) -> str:
        import httpx

        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        answer = httpx.get(service.rstrip("/") + path, headers=headers, timeout=10.0)
        answer.raise_for_status()
        return answer.text

    return ask


def _by_ending(out: Path | None) -> ReportForm:
    ending = "" if out is None else out.suffix.lower()
    return {".html": ReportForm.HTML, ".htm": ReportForm.HTML, ".json": ReportForm.JSON}.get(
        ending, ReportForm.MARKDOWN
    )
